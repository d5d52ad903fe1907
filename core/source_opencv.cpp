// The wall around OpenCV's videoio: video files and cameras.
#include <cstdarg>
#include <cstdio>
#include <exception>
#include <memory>

#include <dlfcn.h>

#include <opencv2/core.hpp>
#include <opencv2/core/utils/logger.hpp>
#include <opencv2/imgproc.hpp>
#include <opencv2/videoio.hpp>

extern "C" {
#include "core/source_internal.h"
TD_API td_video_module_get_function td_video_module_get;
}

namespace {

// OpenCV, and FFmpeg below it, write their troubles to stderr; ours are told by the caller.
void no_message(void *, int, const char *, va_list) {}

void silence_ffmpeg()
{
    using callback = void (*)(void *, int, const char *, va_list);
    using setter = void (*)(callback);
    static const setter set = reinterpret_cast<setter>(dlsym(RTLD_DEFAULT, "av_log_set_callback"));
    if (set) set(no_message);
}

class Quiet {
  public:
    Quiet() : kept_(cv::utils::logging::setLogLevel(cv::utils::logging::LOG_LEVEL_SILENT)) {}
    ~Quiet() { cv::utils::logging::setLogLevel(kept_); }
    Quiet(const Quiet &) = delete;
    Quiet &operator=(const Quiet &) = delete;

  private:
    cv::utils::logging::LogLevel kept_;
};

struct Video {
    cv::VideoCapture capture;
    cv::Mat picture, shown;
};

bool open_video(void **video, double *period_s, const char *path, bool camera, int width, int height,
                char reason[TD_VIDEO_REASON_SIZE])
try {
    Quiet quiet;
    silence_ffmpeg();
    auto made = std::make_unique<Video>();
    // Not CAP_ANY: its backends would look for USB cameras of the file's name.
    if (!made->capture.open(path, camera ? cv::CAP_V4L2 : cv::CAP_FFMPEG) &&
        (camera || !made->capture.open(path, cv::CAP_OPENCV_MJPEG)))
        return false;
    if (camera && width > 0) {
        made->capture.set(cv::CAP_PROP_FRAME_WIDTH, width);
        made->capture.set(cv::CAP_PROP_FRAME_HEIGHT, height);
    }
    // Pixels stay where the sensor has them, as a calibration needs.
    made->capture.set(cv::CAP_PROP_ORIENTATION_AUTO, 0);
    const double rate = made->capture.get(cv::CAP_PROP_FPS);
    *period_s = rate > 0 && rate < 1e5 ? 1 / rate : 0;
    *video = made.release();
    return true;
} catch (const std::exception &e) {
    std::snprintf(reason, TD_VIDEO_REASON_SIZE, "%s", e.what());
    return false;
} catch (...) {
    return false;
}

bool grab(void *video, double *time_s)
try {
    Quiet quiet;
    auto &v = *static_cast<Video *>(video);
    if (!v.capture.grab()) return false;
    *time_s = v.capture.get(cv::CAP_PROP_POS_MSEC) / 1000;
    return true;
} catch (...) {
    return false;
}

bool retrieve(const unsigned char **data, size_t *step, int *width, int *height, void *video, int channels,
              char reason[TD_VIDEO_REASON_SIZE])
try {
    Quiet quiet;
    auto &v = *static_cast<Video *>(video);
    if (!v.capture.retrieve(v.picture) || v.picture.empty() || v.picture.depth() != CV_8U) return false;
    if (v.picture.channels() == channels && channels == 1)
        v.shown = v.picture;
    else if (v.picture.channels() == 1)
        cv::cvtColor(v.picture, v.shown, cv::COLOR_GRAY2RGB);
    else
        cv::cvtColor(v.picture, v.shown, channels == 1 ? cv::COLOR_BGR2GRAY : cv::COLOR_BGR2RGB);
    *data = v.shown.data;
    *step = v.shown.step;
    *width = v.shown.cols;
    *height = v.shown.rows;
    return true;
} catch (const std::exception &e) {
    std::snprintf(reason, TD_VIDEO_REASON_SIZE, "%s", e.what());
    return false;
} catch (...) {
    return false;
}

void close_video(void *video)
try {
    Quiet quiet;
    delete static_cast<Video *>(video);
} catch (...) {
}

const td_video_module module = {open_video, grab, retrieve, close_video};

} // namespace

extern "C" const td_video_module *td_video_module_get(void)
{
    return &module;
}
