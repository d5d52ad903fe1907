// The wall around OpenCV's detector of ArUco markers. It may be called from several threads at a time, as the
// chessboard's.
#include "calib/charuco_internal.h"

#include <algorithm>
#include <cstdlib>
#include <exception>
#include <new>
#include <vector>

#include <opencv2/aruco.hpp>

namespace {

constexpr double least_perimeter = 36; // px, of a marker

void find(std::vector<int> &id, std::vector<std::vector<cv::Point2f>> &corner, const td_image *image,
          int number, int border)
{
    cv::Mat grey(image->height, image->width, CV_8UC1, image->data);
    cv::Ptr<cv::aruco::DetectorParameters> parameters = cv::aruco::DetectorParameters::create();
    parameters->markerBorderBits = border;
    parameters->minMarkerPerimeterRate = least_perimeter / std::max(image->width, image->height);
    parameters->maxMarkerPerimeterRate = 16;
    parameters->minDistanceToBorder = 1;
    parameters->errorCorrectionRate = 1; // what is wrong does not fit the board
    cv::aruco::detectMarkers(grey, cv::aruco::getPredefinedDictionary(number), corner, id, parameters);
}

} // namespace

td_status td_markers_by_opencv(td_marker **marker, size_t *count, const td_image *image, int number,
                               int border, td_error *error)
{
    *marker = nullptr;
    *count = 0;
    try {
        std::vector<int> id;
        std::vector<std::vector<cv::Point2f>> corner;
        find(id, corner, image, number, border);
        *marker = static_cast<td_marker *>(calloc(id.size() + 1, sizeof **marker));
        if (!*marker) return td_fail(error, TD_ERROR_MEMORY, "no memory for %zu markers", id.size());
        for (size_t i = 0; i < id.size(); i++) {
            (*marker)[i].id = id[i];
            for (size_t k = 0; k < 4; k++) {
                (*marker)[i].corner[2 * k] = static_cast<double>(corner[i][k].x);
                (*marker)[i].corner[2 * k + 1] = static_cast<double>(corner[i][k].y);
            }
        }
        *count = id.size();
        return TD_OK;
    } catch (const std::bad_alloc &) {
        return td_fail(error, TD_ERROR_MEMORY, "no memory to find markers");
    } catch (const std::exception &e) {
        return td_fail(error, TD_ERROR_EXTERNAL, "OpenCV cannot look for markers: %.400s", e.what());
    }
}
