// OpenCV's detectors of chessboards and of grids of circles, as its samples use them.
#include "tests/bench/bench_boards.h"

#include <cmath>

#include <opencv2/calib3d.hpp>
#include <opencv2/imgproc.hpp>

void bench_opencv_boards(void *input)
{
    auto *in = static_cast<bench_board_input *>(input);
    const cv::Size size(in->columns, in->rows);
    const int points = in->columns * in->rows;
    for (int i = 0; i < in->images; i++) {
        cv::Mat image(in->height, in->width, CV_8UC1, const_cast<unsigned char *>(in->image[i]));
        std::vector<cv::Point2f> found;
        bool all = in->marks
                       ? cv::findCirclesGrid(image, size, found, cv::CALIB_CB_SYMMETRIC_GRID)
                       : cv::findChessboardCorners(
                             image, size, found, cv::CALIB_CB_ADAPTIVE_THRESH | cv::CALIB_CB_NORMALIZE_IMAGE);
        if (all && !in->marks)
            cv::cornerSubPix(image, found, cv::Size(5, 5), cv::Size(-1, -1),
                             cv::TermCriteria(cv::TermCriteria::EPS + cv::TermCriteria::COUNT, 40, 0.001));
        for (int k = 0; k < points; k++) {
            double *p = in->point + 2 * (i * points + k);
            p[0] = all ? static_cast<double>(found[k].x) : NAN;
            p[1] = all ? static_cast<double>(found[k].y) : NAN;
        }
    }
}
