// The wall around ViSP's hand-eye calibration.
#include <exception>
#include <vector>

#include <visp3/core/vpHomogeneousMatrix.h>
#include <visp3/vision/vpHandEyeCalibration.h>

#include "calib/visp_quiet_internal.h"

extern "C" {
#include "calib/hand_eye_solvers_internal.h"
TD_API td_visp_hand_eye_function td_visp_hand_eye;
}

namespace {

std::vector<vpHomogeneousMatrix> matrices(const double *value, size_t count)
{
    std::vector<vpHomogeneousMatrix> list(count);
    for (size_t i = 0; i < 16 * count; i++) list[i / 16][(i % 16) / 4][i % 4] = value[i];
    return list;
}

} // namespace

extern "C" td_status td_visp_hand_eye(double x[16], const double *a, const double *b, size_t count,
                                      td_error *error)
try {
    VispQuiet quiet;
    vpHomogeneousMatrix found;
    if (vpHandEyeCalibration::calibrate(matrices(b, count), matrices(a, count), found) != 0)
        return td_fail(error, TD_ERROR_CONVERGENCE, "ViSP's hand-eye calibration did not converge");
    for (unsigned i = 0; i < 16; i++) x[i] = found[i / 4][i % 4];
    return TD_OK;
} catch (const std::exception &e) {
    return td_fail(error, TD_ERROR_EXTERNAL, "ViSP: %s", e.what());
} catch (...) {
    return td_fail(error, TD_ERROR_EXTERNAL, "ViSP: unknown exception");
}
