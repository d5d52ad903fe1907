// OpenCV's semi-global block matching as a second opinion.
#include <new>

#include <opencv2/calib3d.hpp>
#include <opencv2/core.hpp>

#include "recon/dense_internal.h"

namespace {

enum { FAIR_COST = 25, FAIR_CURVATURE = 40, UNIT = 16 };

// Without columns before the image its matching begins only where all disparities fit.
cv::Mat padded(const td_image *image, int columns)
{
    cv::Mat whole(image->height, image->width, CV_8UC1, image->data), wide;
    cv::copyMakeBorder(whole, wide, 0, 0, columns, 0, cv::BORDER_REPLICATE);
    return wide;
}

void match(dense_map *map, const td_image *left, const td_image *right, int block,
           const td_dense_options *options)
{
    int levels = (options->levels + UNIT - 1) / UNIT * UNIT;
    int columns = std::max(options->lowest + levels, 0), area = block * block;
    auto matcher =
        cv::StereoSGBM::create(options->lowest, levels, block, 8 * area, 32 * area,
                               options->left_check ? 1 : -1, 0, 0, 0, 0, cv::StereoSGBM::MODE_SGBM_3WAY);
    cv::Mat found;
    matcher->compute(padded(left, columns), padded(right, columns), found);
    for (int y = 0; y < map->height; y++)
        for (int x = 0; x < map->width; x++) {
            int value = found.at<short>(y, columns + x) - UNIT * options->lowest;
            size_t at = size_t(y) * size_t(map->width) + size_t(x);
            map->disparity[at] = int16_t(value < 0 ? DENSE_NONE : value * (DENSE_ONE / UNIT));
            map->least[at] = FAIR_COST;
            map->curvature[at] = FAIR_CURVATURE;
        }
}

} // namespace

extern "C" td_status dense_opencv(dense_map *map, const td_image *left, const td_image *right, int block,
                                  const td_dense_options *options)
{
    try {
        match(map, left, right, block, options);
        return TD_OK;
    } catch (const std::bad_alloc &) {
        return TD_ERROR_MEMORY;
    } catch (...) {
        return TD_ERROR_EXTERNAL;
    }
}
