// OpenCV's goodFeaturesToTrack and cornerHarris, as tests/recon/interest_opencv.h asks them.
#include "tests/recon/interest_opencv.h"

#include <vector>

#include <opencv2/imgproc.hpp>

extern "C" size_t opencv_find_corners(double *xy, size_t most, const unsigned char *image, int width,
                                      int height, const opencv_corners *how)
{
    cv::setNumThreads(1);
    cv::Mat grey(height, width, CV_8UC1, const_cast<unsigned char *>(image));
    std::vector<cv::Point2f> corner;
    cv::goodFeaturesToTrack(grey, corner, int(most), how->quality, how->distance_px, cv::noArray(),
                            how->block, how->harris != 0, 0.04);
    if (how->sub_pixel && !corner.empty())
        cv::cornerSubPix(grey, corner, cv::Size(3, 3), cv::Size(-1, -1),
                         cv::TermCriteria(cv::TermCriteria::COUNT + cv::TermCriteria::EPS, 20, 0.03));
    for (size_t i = 0; i < corner.size(); i++) {
        xy[2 * i] = double(corner[i].x);
        xy[2 * i + 1] = double(corner[i].y);
    }
    return corner.size();
}
