// The wall around OpenCV's chessboard detectors. Both may be called from several threads at a time: they
// share nothing but OpenCV's pool of threads, which serves one caller and lets the others work alone.
#include "calib/chessboard_internal.h"

#include <exception>
#include <new>
#include <vector>

#include <opencv2/calib3d.hpp>
#include <opencv2/imgproc.hpp>

namespace {

cv::Mat view(const td_image *image)
{
    return {image->height, image->width, CV_8UC1, image->data};
}

void copy(double *corner, const std::vector<cv::Point2f> &point)
{
    for (size_t i = 0; i < point.size(); i++) {
        corner[2 * i] = static_cast<double>(point[i].x);
        corner[2 * i + 1] = static_cast<double>(point[i].y);
    }
}

// The sector detector searches randomised trees by the thread's own generator: the same start gives the same
// board.
class SameRandomNumbers {
  public:
    SameRandomNumbers() : kept_(cv::theRNG().state) { cv::theRNG().state = 0x12345678; }
    ~SameRandomNumbers() { cv::theRNG().state = kept_; }
    SameRandomNumbers(const SameRandomNumbers &) = delete;
    SameRandomNumbers &operator=(const SameRandomNumbers &) = delete;

  private:
    uint64 kept_;
};

void by_quadrangles(double *corner, bool *found, const td_image *image, cv::Size size,
                    const td_chessboard_threshold *threshold)
{
    cv::Mat smooth = view(image), binary;
    if (threshold->smooth)
        cv::GaussianBlur(view(image), smooth = cv::Mat(), cv::Size(threshold->smooth, threshold->smooth), 0);
    cv::adaptiveThreshold(smooth, binary, 255, cv::ADAPTIVE_THRESH_MEAN_C, cv::THRESH_BINARY,
                          threshold->block, threshold->offset);
    std::vector<cv::Point2f> point;
    *found =
        cv::findChessboardCorners(binary, size, point, 0) && point.size() == static_cast<size_t>(size.area());
    if (*found) copy(corner, point);
}

void by_sectors(double *corner, size_t capacity, bool *found, int *columns, int *rows, bool larger,
                const td_image *image)
{
    SameRandomNumbers same;
    std::vector<cv::Point2f> point;
    cv::Mat meta;
    int flags = cv::CALIB_CB_NORMALIZE_IMAGE | (larger ? cv::CALIB_CB_LARGER : 0);
    *found = cv::findChessboardCornersSB(view(image), cv::Size(*columns, *rows), point, flags, meta) &&
             point.size() == meta.total() && point.size() <= capacity;
    if (!*found) return;
    *columns = meta.cols, *rows = meta.rows;
    copy(corner, point);
}

// Runs `work` and turns what it throws into a status.
template <class Work> td_status guarded(td_error *error, Work work)
{
    try {
        work();
        return TD_OK;
    } catch (const std::bad_alloc &) {
        return td_fail(error, TD_ERROR_MEMORY, "no memory to look for a chessboard");
    } catch (const std::exception &e) {
        return td_fail(error, TD_ERROR_EXTERNAL, "OpenCV failed to look for a chessboard: %s", e.what());
    } catch (...) {
        return td_fail(error, TD_ERROR_EXTERNAL, "OpenCV failed to look for a chessboard");
    }
}

} // namespace

td_status td_chessboard_by_quadrangles(double *corner, bool *found, const td_image *image, int columns,
                                       int rows, const td_chessboard_threshold *threshold, td_error *error)
{
    *found = false;
    return guarded(error, [&] { by_quadrangles(corner, found, image, cv::Size(columns, rows), threshold); });
}

td_status td_chessboard_by_sectors(double *corner, size_t capacity, bool *found, int *columns, int *rows,
                                   bool larger, const td_image *image, td_error *error)
{
    *found = false;
    return guarded(error, [&] { by_sectors(corner, capacity, found, columns, rows, larger, image); });
}
