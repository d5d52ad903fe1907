// The wall around ViSP: pose and camera by virtual visual servoing.
#include <exception>
#include <vector>

#include <visp3/core/vpCameraParameters.h>
#include <visp3/core/vpHomogeneousMatrix.h>
#include <visp3/core/vpImagePoint.h>
#include <visp3/core/vpPixelMeterConversion.h>
#include <visp3/vision/vpCalibration.h>
#include <visp3/vision/vpPose.h>

#include "calib/visp_quiet_internal.h"

extern "C" {
#include "calib/first_estimate_internal.h"
TD_API td_visp_estimate_function td_visp_estimate;
}

namespace {

vpHomogeneousMatrix pose_of(const vpCameraParameters &camera, const double *start, const double *point,
                            const double *pixel, size_t n)
{
    vpPose pose;
    for (size_t i = 0; i < n; i++) {
        vpPoint p(point[3 * i], point[3 * i + 1], point[3 * i + 2]);
        double x = 0, y = 0;
        vpPixelMeterConversion::convertPoint(camera, pixel[2 * i], pixel[2 * i + 1], x, y);
        p.set_x(x);
        p.set_y(y);
        pose.addPoint(p);
    }
    vpHomogeneousMatrix found;
    for (unsigned i = 0; i < 16; i++) found[i / 4][i % 4] = start[i];
    pose.computePose(vpPose::VIRTUAL_VS, found);
    return found;
}

void estimate(double intrinsics[4], double *matrix, const double *point, const double *pixel,
              const size_t *first, const size_t *count, size_t views, bool keep_camera)
{
    vpCameraParameters camera(intrinsics[0], intrinsics[1], intrinsics[2], intrinsics[3]);
    std::vector<vpCalibration> table(views);
    for (size_t v = 0; v < views; v++) {
        size_t n = count[v];
        const double *p = point + 3 * first[v], *u = pixel + 2 * first[v];
        // The calibration begins with poses of its own.
        if (keep_camera) table[v].cMo = pose_of(camera, matrix + 16 * v, p, u, n);
        for (size_t i = 0; i < n; i++) {
            vpImagePoint ip(u[2 * i + 1], u[2 * i]);
            table[v].addPoint(p[3 * i], p[3 * i + 1], p[3 * i + 2], ip);
        }
    }
    if (!keep_camera) {
        double error = 0;
        vpCalibration::computeCalibrationMulti(vpCalibration::CALIB_VIRTUAL_VS, table, camera, error, false);
        intrinsics[0] = camera.get_px(), intrinsics[1] = camera.get_py();
        intrinsics[2] = camera.get_u0(), intrinsics[3] = camera.get_v0();
    }
    for (size_t v = 0; v < views; v++)
        for (unsigned i = 0; i < 16; i++) matrix[16 * v + i] = table[v].cMo[i / 4][i % 4];
}

} // namespace

extern "C" td_status td_visp_estimate(double intrinsics[4], double *matrix, const double *point,
                                      const double *pixel, const size_t *first, const size_t *count,
                                      size_t views, int keep_camera, td_error *error)
try {
    VispQuiet quiet;
    estimate(intrinsics, matrix, point, pixel, first, count, views, keep_camera != 0);
    return TD_OK;
} catch (const std::exception &e) {
    return td_fail(error, TD_ERROR_EXTERNAL, "ViSP: %s", e.what());
} catch (...) {
    return td_fail(error, TD_ERROR_EXTERNAL, "ViSP: unknown exception");
}
