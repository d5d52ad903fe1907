// OpenCV's aruco as the peer: tag36h11, its usual settings, corners refined as asked.
#include <vector>

#include <opencv2/aruco.hpp>

#include "tests/bench/bench.h"

extern "C" void bench_opencv_tags(bench_tags_view *v)
{
    cv::setNumThreads(1);
    cv::Mat image(v->height, v->width, CV_8UC1, const_cast<unsigned char *>(v->image));
    auto dictionary = cv::aruco::getPredefinedDictionary(cv::aruco::DICT_APRILTAG_36h11);
    auto parameters = cv::aruco::DetectorParameters::create();
    parameters->markerBorderBits = v->border;
    parameters->cornerRefinementMethod =
        v->refinement ? cv::aruco::CORNER_REFINE_APRILTAG : cv::aruco::CORNER_REFINE_SUBPIX;
    std::vector<std::vector<cv::Point2f>> corners;
    std::vector<int> ids;
    cv::aruco::detectMarkers(image, dictionary, corners, ids, parameters);
    v->count = 0;
    for (size_t i = 0; i < ids.size() && v->count < v->capacity; i++, v->count++) {
        v->id[v->count] = ids[i];
        for (size_t k = 0; k < 4; k++) {
            v->corner[8 * v->count + 2 * k] = double(corners[i][k].x);
            v->corner[8 * v->count + 2 * k + 1] = double(corners[i][k].y);
        }
    }
}
