// OpenCV as the peer of the benchmarks: the usual calls with the usual settings, on one thread as ours.
#include <vector>

#include <opencv2/calib3d.hpp>
#include <opencv2/imgproc.hpp>

#include "tests/bench/bench.h"

extern "C" void bench_opencv_stereo(void *user)
{
    auto *s = static_cast<bench_stereo *>(user);
    cv::setNumThreads(1);
    size_t points = static_cast<size_t>(s->columns) * s->rows;
    std::vector<std::vector<cv::Point3f>> object(s->views);
    std::vector<std::vector<cv::Point2f>> left(s->views), right(s->views);
    for (size_t v = 0; v < s->views; v++)
        for (size_t i = 0; i < points; i++) {
            object[v].emplace_back(float(i % s->columns * s->spacing), float(i / s->columns * s->spacing),
                                   0.f);
            const double *a = s->left + 2 * (v * points + i), *b = s->right + 2 * (v * points + i);
            left[v].emplace_back(float(a[0]), float(a[1]));
            right[v].emplace_back(float(b[0]), float(b[1]));
        }
    cv::Size size(s->width, s->height);
    cv::Mat k1, d1, k2, d2, r, t, e, f;
    std::vector<cv::Mat> rvecs, tvecs;
    cv::calibrateCamera(object, left, size, k1, d1, rvecs, tvecs);
    cv::calibrateCamera(object, right, size, k2, d2, rvecs, tvecs);
    s->rms_px = cv::stereoCalibrate(
        object, left, right, k1, d1, k2, d2, size, r, t, e, f, cv::CALIB_USE_INTRINSIC_GUESS,
        cv::TermCriteria(cv::TermCriteria::COUNT + cv::TermCriteria::EPS, 100, 1e-8));
    s->baseline_m = cv::norm(t);
}

extern "C" void bench_opencv_corners(void *user)
{
    auto *c = static_cast<bench_corners *>(user);
    cv::setNumThreads(1);
    c->found = 0;
    for (size_t i = 0; i < c->images; i++) {
        cv::Mat image(c->height, c->width, CV_8UC1, const_cast<unsigned char *>(c->image[i]));
        std::vector<cv::Point2f> corners;
        if (!cv::findChessboardCorners(image, cv::Size(c->columns, c->rows), corners)) continue;
        cv::cornerSubPix(image, corners, cv::Size(5, 5), cv::Size(-1, -1),
                         cv::TermCriteria(cv::TermCriteria::COUNT + cv::TermCriteria::EPS, 50, 1e-3));
        c->found++;
    }
}
