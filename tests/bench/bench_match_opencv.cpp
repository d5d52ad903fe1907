// OpenCV as the peer of automatic matching: corners by goodFeaturesToTrack, the best place by matchTemplate
// in a strip of rows, refined by the correlation's parabola, and accepted when the way back leads home.
#include <algorithm>
#include <cmath>
#include <vector>

#include <opencv2/imgproc.hpp>

#include "tests/bench/bench.h"

namespace {

// Best place of the window around (x, y) of `from` in rows y - 1 … y + 1, columns low … high of `to`.
bool search(double *best, cv::Point2d *place, const cv::Mat &from, const cv::Mat &to, int x, int y, int low,
            int high, int k)
{
    low = std::max(low, k);
    high = std::min(high, to.cols - 1 - k);
    if (x < k || x >= from.cols - k || y < k + 1 || y >= from.rows - k - 1 || high < low) return false;
    const int side = 2 * k + 1;
    cv::Mat score;
    cv::Point peak;
    cv::matchTemplate(to(cv::Rect(low - k, y - k - 1, high - low + side, side + 2)),
                      from(cv::Rect(x - k, y - k, side, side)), score, cv::TM_CCOEFF_NORMED);
    cv::minMaxLoc(score, nullptr, best, nullptr, &peak);
    double offset = 0;
    if (peak.x > 0 && peak.x < score.cols - 1) {
        const double a = double(score.at<float>(peak.y, peak.x - 1)), b = double(score.at<float>(peak));
        const double c = double(score.at<float>(peak.y, peak.x + 1)), bend = a - 2 * b + c;
        if (bend < 0) offset = (a - c) / (2 * bend);
    }
    *place = cv::Point2d(low + peak.x + offset, y - 1 + peak.y);
    return true;
}

} // namespace

extern "C" void bench_opencv_match(void *pair)
{
    auto *p = static_cast<bench_match_pair *>(pair);
    cv::setNumThreads(1);
    const cv::Mat left(p->height, p->width, CV_8UC1, const_cast<unsigned char *>(p->left));
    const cv::Mat right(p->height, p->width, CV_8UC1, const_cast<unsigned char *>(p->right));
    std::vector<cv::Point2f> corners;
    cv::goodFeaturesToTrack(left, corners, p->points, 1e-3, 5);
    p->found = int(corners.size());
    p->matched = 0;
    for (const cv::Point2f &corner : corners) {
        const int x = int(std::lround(corner.x)), y = int(std::lround(corner.y));
        cv::Point2d there, home;
        double best = 0, back = 0;
        if (!search(&best, &there, left, right, x, y, x - p->most_disparity, x, p->half_window) ||
            best < p->least_zncc)
            continue;
        const int rx = int(std::lround(there.x)), ry = int(std::lround(there.y));
        if (!search(&back, &home, right, left, rx, ry, rx, rx + p->most_disparity, p->half_window) ||
            std::abs(home.x - x) > 2)
            continue;
        double *m = p->match + 4 * p->matched++;
        m[0] = x;
        m[1] = y;
        m[2] = there.x;
        m[3] = there.y;
    }
}
