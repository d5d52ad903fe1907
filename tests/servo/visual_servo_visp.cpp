#include "tests/servo/visual_servo_visp.h"

#include <memory>
#include <vector>

#include <visp3/core/vpMath.h>
#include <visp3/core/vpPoint.h>
#include <visp3/robot/vpSimulatorCamera.h>
#include <visp3/visual_features/vpFeatureBuilder.h>
#include <visp3/visual_features/vpFeaturePoint.h>
#include <visp3/visual_features/vpFeatureThetaU.h>
#include <visp3/visual_features/vpFeatureTranslation.h>
#include <visp3/vs/vpAdaptiveGain.h>
#include <visp3/vs/vpServo.h>

namespace {

vpHomogeneousMatrix pose(const double m[16])
{
    vpHomogeneousMatrix p;
    for (unsigned i = 0; i < 16; i++) p[i / 4][i % 4] = m[i];
    return p;
}

vpMatrix jacobian(const double *j, int joints)
{
    vpMatrix m(6, unsigned(joints));
    for (int i = 0; i < 6 * joints; i++) m[unsigned(i / joints)][unsigned(i % joints)] = j[i];
    return m;
}

vpColVector vector(const double *x, int n)
{
    vpColVector v(static_cast<unsigned>(n));
    for (unsigned i = 0; i < unsigned(n); i++) v[i] = x[i];
    return v;
}

} // namespace

struct visp_servo {
    vpServo task;
    std::vector<vpFeaturePoint> now, goal;
    vpFeatureThetaU turn{vpFeatureThetaU::cdRc};
    vpFeatureTranslation shift{vpFeatureTranslation::cdMc};

    explicit visp_servo(const visp_task &t) : now(size_t(t.points)), goal(size_t(t.points))
    {
        static const vpServo::vpServoType types[] = {
            vpServo::EYEINHAND_CAMERA, vpServo::EYEINHAND_L_cVe_eJe, vpServo::EYETOHAND_L_cVe_eJe,
            vpServo::EYETOHAND_L_cVf_fVe_eJe, vpServo::EYETOHAND_L_cVf_fJe};
        static const vpServo::vpServoIteractionMatrixType kinds[] = {vpServo::CURRENT, vpServo::DESIRED,
                                                                     vpServo::MEAN};
        task.setServo(types[t.mode]);
        task.setInteractionMatrixType(kinds[t.interaction], vpServo::PSEUDO_INVERSE);
        task.setLambda(vpAdaptiveGain(t.gain[0], t.gain[1], t.gain[2]));
        set(t);
        if (t.pose) {
            task.addFeature(turn);
            task.addFeature(shift);
        }
        for (size_t i = 0; i < now.size() && !t.pose; i++) {
            goal[i].buildFrom(t.goal[i][0], t.goal[i][1], t.goal[i][2]);
            task.addFeature(now[i], goal[i]);
        }
        if (t.mode == VISP_FIXED_cVf_fJe || t.mode == VISP_FIXED_cVf_fVe_eJe)
            task.set_cVf(vpVelocityTwistMatrix(pose(t.camera_from_root)));
        if (t.mode == VISP_HAND_cVe_eJe || t.mode == VISP_FIXED_cVe_eJe)
            task.set_cVe(vpVelocityTwistMatrix(pose(t.camera_from_hand)));
    }

    void set(const visp_task &t)
    {
        for (size_t i = 0; i < now.size(); i++) now[i].buildFrom(t.now[i][0], t.now[i][1], t.now[i][2]);
        if (t.pose) {
            turn.buildFrom(pose(t.goal_from_camera));
            shift.buildFrom(pose(t.goal_from_camera));
        }
    }

    vpColVector law(const visp_task &t)
    {
        set(t);
        if (t.mode == VISP_FIXED_cVe_eJe) task.set_cVe(vpVelocityTwistMatrix(pose(t.camera_from_hand)));
        if (t.mode == VISP_FIXED_cVf_fVe_eJe) task.set_fVe(vpVelocityTwistMatrix(pose(t.root_from_hand)));
        if (t.mode == VISP_FIXED_cVf_fJe)
            task.set_fJe(jacobian(t.root_jacobian, t.joints));
        else if (t.mode != VISP_CAMERA)
            task.set_eJe(jacobian(t.hand_jacobian, t.joints));
        return task.computeControlLaw();
    }
};

visp_servo *visp_servo_new(const visp_task *task)
{
    return new visp_servo(*task);
}

void visp_servo_move(visp_servo *servo, double *rate, const visp_task *task)
{
    const vpColVector v = servo->law(*task);
    for (unsigned i = 0; i < v.getRows(); i++) rate[i] = v[i];
}

void visp_servo_free(visp_servo *servo)
{
    delete servo;
}

void visp_law(double *rate, double *extra, const visp_task *t)
{
    visp_servo servo(*t);
    const vpColVector v = servo.law(*t);
    for (unsigned i = 0; i < v.getRows(); i++) rate[i] = v[i];
    if (!t->avoid) return;
    const vpColVector more = servo.task.secondaryTaskJointLimitAvoidance(
        vector(t->q, t->joints), v, vector(t->lower, t->joints), vector(t->upper, t->joints));
    for (unsigned i = 0; i < more.getRows(); i++) extra[i] = more[i];
}

int visp_tutorial(const double gain[3], double tolerance)
{
    const vpHomogeneousMatrix there(0, 0, 0.75, 0, 0, 0);
    vpHomogeneousMatrix here(0.15, -0.1, 1., vpMath::rad(10), vpMath::rad(-10), vpMath::rad(50));
    const double corner[4][2] = {{-0.1, -0.1}, {0.1, -0.1}, {0.1, 0.1}, {-0.1, 0.1}};
    vpPoint point[4];
    vpFeaturePoint now[4], goal[4];
    vpServo task;
    task.setServo(vpServo::EYEINHAND_CAMERA);
    task.setInteractionMatrixType(vpServo::CURRENT);
    task.setLambda(vpAdaptiveGain(gain[0], gain[1], gain[2]));
    for (int i = 0; i < 4; i++) {
        point[i].setWorldCoordinates(corner[i][0], corner[i][1], 0);
        point[i].track(there);
        vpFeatureBuilder::create(goal[i], point[i]);
        task.addFeature(now[i], goal[i]);
    }
    vpSimulatorCamera camera;
    camera.setSamplingTime(0.040);
    vpHomogeneousMatrix at;
    camera.getPosition(at);
    const vpHomogeneousMatrix target = at * here;
    for (int i = 0; i < 10000; i++) {
        camera.getPosition(at);
        here = at.inverse() * target;
        for (int k = 0; k < 4; k++) {
            point[k].track(here);
            vpFeatureBuilder::create(now[k], point[k]);
        }
        const vpColVector v = task.computeControlLaw();
        if (task.getError().frobeniusNorm() < tolerance) return i;
        camera.setVelocity(vpRobot::CAMERA_FRAME, v);
    }
    return -1;
}
