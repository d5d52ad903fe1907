// OpenCV 4.6's charuco detector as its tutorial uses it: markers, then corners between them.
#include "tests/bench/bench_charuco.h"

#include <cmath>

#include <opencv2/aruco/charuco.hpp>

void bench_opencv_charuco(void *input)
{
    auto *in = static_cast<bench_charuco_input *>(input);
    auto dictionary = cv::aruco::getPredefinedDictionary(in->dictionary);
    auto board = cv::aruco::CharucoBoard::create(in->columns + 1, in->rows + 1, 1.0F,
                                                 static_cast<float>(in->share), dictionary);
    const int corners = in->columns * in->rows;
    for (int i = 0; i < 2 * in->images * corners; i++) in->point[i] = NAN;
    for (int i = 0; i < in->images; i++) {
        cv::Mat image(in->height, in->width, CV_8UC1, const_cast<unsigned char *>(in->image[i]));
        std::vector<int> id, corner_id;
        std::vector<std::vector<cv::Point2f>> marker;
        std::vector<cv::Point2f> corner;
        cv::aruco::detectMarkers(image, dictionary, marker, id);
        if (id.empty()) continue;
        cv::aruco::interpolateCornersCharuco(marker, id, image, board, corner, corner_id);
        for (size_t k = 0; k < corner_id.size(); k++) {
            double *p = in->point + 2 * (i * corners + corner_id[k]);
            p[0] = static_cast<double>(corner[k].x);
            p[1] = static_cast<double>(corner[k].y);
        }
    }
}
