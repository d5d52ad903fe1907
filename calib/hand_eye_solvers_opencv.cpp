// The wall around OpenCV's closed forms of hand-eye calibration.
#include "calib/hand_eye_solvers_internal.h"

#include <exception>
#include <vector>

#include <opencv2/calib3d.hpp>

namespace {

struct Motions {
    std::vector<cv::Mat> rotation, translation;

    Motions(const double *matrix, size_t count)
    {
        for (size_t i = 0; i < count; i++) {
            cv::Mat m(4, 4, CV_64F, const_cast<double *>(matrix + 16 * i));
            rotation.push_back(m(cv::Rect(0, 0, 3, 3)).clone());
            translation.push_back(m(cv::Rect(3, 0, 1, 3)).clone());
        }
    }
};

void give(double out[16], const cv::Mat &rotation, const cv::Mat &translation)
{
    cv::Mat r, t;
    rotation.convertTo(r, CV_64F);
    translation.convertTo(t, CV_64F);
    for (int i = 0; i < 3; i++) {
        for (int j = 0; j < 3; j++) out[4 * i + j] = r.at<double>(i, j);
        out[4 * i + 3] = t.at<double>(i);
        out[12 + i] = 0;
    }
    out[15] = 1;
}

cv::HandEyeCalibrationMethod method_of(td_hand_eye_solver solver)
{
    switch (solver) {
    case TD_SOLVER_PARK:
        return cv::CALIB_HAND_EYE_PARK;
    case TD_SOLVER_HORAUD:
        return cv::CALIB_HAND_EYE_HORAUD;
    case TD_SOLVER_ANDREFF:
        return cv::CALIB_HAND_EYE_ANDREFF;
    case TD_SOLVER_DANIILIDIS:
        return cv::CALIB_HAND_EYE_DANIILIDIS;
    default:
        return cv::CALIB_HAND_EYE_TSAI;
    }
}

} // namespace

td_status td_opencv_hand_eye(double x[16], td_hand_eye_solver solver, const double *a, const double *b,
                             size_t count, td_error *error)
try {
    Motions gripper(a, count), target(b, count);
    cv::Mat r, t;
    cv::calibrateHandEye(gripper.rotation, gripper.translation, target.rotation, target.translation, r, t,
                         method_of(solver));
    give(x, r, t);
    return TD_OK;
} catch (const std::exception &e) {
    return td_fail(error, TD_ERROR_EXTERNAL, "OpenCV: %s", e.what());
} catch (...) {
    return td_fail(error, TD_ERROR_EXTERNAL, "OpenCV: unknown exception");
}

td_status td_opencv_robot_world(double world_from_base[16], double camera_from_gripper[16],
                                td_hand_eye_solver solver, const double *camera_from_world,
                                const double *gripper_from_base, size_t count, td_error *error)
try {
    Motions world(camera_from_world, count), base(gripper_from_base, count);
    cv::Mat rx, tx, rz, tz;
    cv::calibrateRobotWorldHandEye(
        world.rotation, world.translation, base.rotation, base.translation, rx, tx, rz, tz,
        solver == TD_SOLVER_LI ? cv::CALIB_ROBOT_WORLD_HAND_EYE_LI : cv::CALIB_ROBOT_WORLD_HAND_EYE_SHAH);
    give(world_from_base, rx, tx);
    give(camera_from_gripper, rz, tz);
    return TD_OK;
} catch (const std::exception &e) {
    return td_fail(error, TD_ERROR_EXTERNAL, "OpenCV: %s", e.what());
} catch (...) {
    return td_fail(error, TD_ERROR_EXTERNAL, "OpenCV: unknown exception");
}
