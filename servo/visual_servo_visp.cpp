// The wall around ViSP's vpServo. Its twists are [v; omega], ours [omega; v].
#include <exception>
#include <vector>

#include <visp3/core/vpHomogeneousMatrix.h>
#include <visp3/visual_features/vpFeaturePoint.h>
#include <visp3/visual_features/vpFeatureThetaU.h>
#include <visp3/visual_features/vpFeatureTranslation.h>
#include <visp3/vs/vpAdaptiveGain.h>
#include <visp3/vs/vpServo.h>

extern "C" {
#include "servo/visual_servo_internal.h"
TD_API td_visp_servo_function td_visp_servo;
}

namespace {

vpMatrix twists(const double *jacobian, int joints)
{
    vpMatrix m(6, unsigned(joints));
    for (int i = 0; i < 6; i++)
        for (int k = 0; k < joints; k++) m[unsigned(i)][unsigned(k)] = jacobian[((i + 3) % 6) * joints + k];
    return m;
}

vpHomogeneousMatrix matrix(const td_pose &pose)
{
    double value[16];
    td_pose_matrix(value, &pose);
    vpHomogeneousMatrix m;
    for (unsigned i = 0; i < 16; i++) m[i / 4][i % 4] = value[i];
    return m;
}

void choose(vpServo &task, td_interaction interaction)
{
    task.setServo(vpServo::EYEINHAND_L_cVe_eJe);
    task.setInteractionMatrixType(interaction == TD_INTERACTION_CURRENT   ? vpServo::CURRENT
                                  : interaction == TD_INTERACTION_DESIRED ? vpServo::DESIRED
                                                                          : vpServo::MEAN,
                                  vpServo::PSEUDO_INVERSE);
}

void finish(double *rate, double *gain, vpServo &task, const double *jacobian, int joints)
{
    task.set_cVe(vpVelocityTwistMatrix());
    task.set_eJe(twists(jacobian, joints));
    const vpColVector v = task.computeControlLaw();
    for (int k = 0; k < joints; k++) rate[k] = v[unsigned(k)];
    *gain = task.lambda.getLastValue();
}

void points(double *rate, double *gain, const td_servo_features &f, const double *jacobian, int joints,
            const vpAdaptiveGain &lambda)
{
    vpServo task;
    std::vector<vpFeaturePoint> now(size_t(f.count)), goal(size_t(f.count));
    choose(task, f.interaction);
    task.setLambda(lambda);
    for (size_t i = 0; i < now.size(); i++) {
        now[i].buildFrom(f.now[i][0], f.now[i][1], f.now[i][2]);
        goal[i].buildFrom(f.goal[i][0], f.goal[i][1], f.goal[i][2]);
        task.addFeature(now[i], goal[i]);
    }
    finish(rate, gain, task, jacobian, joints);
}

void pose(double *rate, double *gain, const td_servo_features &f, const double *jacobian, int joints,
          const vpAdaptiveGain &lambda)
{
    vpServo task;
    const vpHomogeneousMatrix there = matrix(f.goal_from_camera);
    vpFeatureThetaU turn(vpFeatureThetaU::cdRc);
    vpFeatureTranslation shift(vpFeatureTranslation::cdMc);
    turn.buildFrom(there);
    shift.buildFrom(there);
    choose(task, f.interaction);
    task.setLambda(lambda);
    task.addFeature(turn);
    task.addFeature(shift);
    finish(rate, gain, task, jacobian, joints);
}

} // namespace

extern "C" td_status td_visp_servo(double *rate, double *gain, const td_servo_features *features,
                                   const double *jacobian, int joints, const double settings[3],
                                   td_error *error)
try {
    const vpAdaptiveGain lambda(settings[0], settings[1], settings[2]);
    (features->kind == TD_SERVO_POSE ? pose : points)(rate, gain, *features, jacobian, joints, lambda);
    return TD_OK;
} catch (const std::exception &e) {
    return td_fail(error, TD_ERROR_EXTERNAL, "ViSP: %s", e.what());
} catch (...) {
    return td_fail(error, TD_ERROR_EXTERNAL, "ViSP: unknown exception");
}
