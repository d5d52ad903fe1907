#include <opencv2/calib3d.hpp>
#include <opencv2/core.hpp>

#include "tests/recon/triangulation_opencv.h"

namespace {

cv::Mat pixels(const double *p, size_t n)
{
    return cv::Mat(1, static_cast<int>(n), CV_64FC2, const_cast<double *>(p));
}

} // namespace

extern "C" void opencv_correct_matches(double *left_corrected, double *right_corrected, const double f[9],
                                       const double *left, const double *right, size_t n)
{
    cv::Mat l, r;
    cv::correctMatches(cv::Mat(3, 3, CV_64F, const_cast<double *>(f)), pixels(left, n), pixels(right, n), l,
                       r);
    std::copy_n(l.ptr<double>(), 2 * n, left_corrected);
    std::copy_n(r.ptr<double>(), 2 * n, right_corrected);
}

extern "C" void opencv_triangulate(double *xyz, const double p_left[12], const double p_right[12],
                                   const double *left, const double *right, size_t n)
{
    cv::Mat points;
    cv::triangulatePoints(cv::Mat(3, 4, CV_64F, const_cast<double *>(p_left)),
                          cv::Mat(3, 4, CV_64F, const_cast<double *>(p_right)), pixels(left, n),
                          pixels(right, n), points);
    for (int i = 0; i < static_cast<int>(n); i++)
        for (int k = 0; k < 3; k++) xyz[3 * i + k] = points.at<double>(k, i) / points.at<double>(3, i);
}
