// OpenCV's SGBM in 3WAY mode as the peer, on one thread, its images widened to the left as ours are inside.
#include <opencv2/calib3d.hpp>
#include <opencv2/core.hpp>

#include "tests/bench/bench.h"

extern "C" void bench_opencv_dense(void *input)
{
    auto in = static_cast<bench_dense_pair *>(input);
    cv::setNumThreads(1);
    cv::Mat image[2], found;
    for (int k = 0; k < 2; k++)
        cv::copyMakeBorder(cv::Mat(in->height, in->width, CV_8UC1, const_cast<unsigned char *>(in->image[k])),
                           image[k], 0, 0, in->levels, 0, cv::BORDER_REPLICATE);
    int area = in->block * in->block;
    cv::StereoSGBM::create(0, in->levels, in->block, 8 * area, 32 * area, 1, 0, 0, 0, 0,
                           cv::StereoSGBM::MODE_SGBM_3WAY)
        ->compute(image[0], image[1], found);
    for (int y = 0; y < in->height; y++)
        for (int x = 0; x < in->width; x++)
            in->disparity[y * in->width + x] = found.at<short>(y, in->levels + x);
}
