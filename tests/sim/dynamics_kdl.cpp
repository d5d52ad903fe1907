// The peer of the dynamics: the URDF through urdfdom into a chain of KDL, by nothing of ours.
// KDL's library allocates by malloc alone; under AddressSanitizer Eigen's headers would free otherwise.
#define EIGEN_MALLOC_ALREADY_ALIGNED 1
#include <memory>
#include <vector>

#include <kdl/chaindynparam.hpp>
#include <kdl/chainfdsolver_recursive_newton_euler.hpp>
#include <kdl/chainidsolver_recursive_newton_euler.hpp>
#include <urdf_parser/urdf_parser.h>

#include "tests/sim/dynamics_kdl.h"

namespace {

KDL::Frame frame_of(const urdf::Pose &pose)
{
    return {KDL::Rotation::Quaternion(pose.rotation.x, pose.rotation.y, pose.rotation.z, pose.rotation.w),
            KDL::Vector(pose.position.x, pose.position.y, pose.position.z)};
}

KDL::RigidBodyInertia inertia_of(const urdf::Link &link)
{
    if (!link.inertial) return KDL::RigidBodyInertia::Zero();
    const urdf::Inertial &i = *link.inertial;
    const KDL::RotationalInertia own(i.ixx, i.iyy, i.izz, i.ixy, i.ixz, i.iyz);
    return frame_of(i.origin) * KDL::RigidBodyInertia(i.mass, KDL::Vector::Zero(), own);
}

const urdf::Link *moving_child(const urdf::Link &link)
{
    for (const auto &child : link.child_links)
        if (child->parent_joint->type != urdf::Joint::FIXED) return child.get();
    return nullptr;
}

KDL::Chain chain_of(const urdf::ModelInterface &model)
{
    KDL::Chain chain;
    const KDL::Joint::JointType base[6] = {KDL::Joint::TransX, KDL::Joint::TransY, KDL::Joint::TransZ,
                                           KDL::Joint::RotZ,   KDL::Joint::RotY,   KDL::Joint::RotX};
    for (int k = 0; k < 5; k++)
        chain.addSegment(
            KDL::Segment(KDL::Joint(base[k]), KDL::Frame::Identity(), KDL::RigidBodyInertia::Zero()));
    const urdf::Link *link = model.getRoot().get();
    chain.addSegment(KDL::Segment(KDL::Joint(base[5]), KDL::Frame::Identity(), inertia_of(*link)));
    while ((link = moving_child(*link))) {
        const urdf::Joint &joint = *link->parent_joint;
        const KDL::Frame f = frame_of(joint.parent_to_joint_origin_transform);
        const KDL::Vector axis(joint.axis.x, joint.axis.y, joint.axis.z);
        chain.addSegment(
            KDL::Segment(KDL::Joint(joint.name, f.p, f.M * axis, KDL::Joint::RotAxis), f, inertia_of(*link)));
    }
    return chain;
}

} // namespace

struct kdl_dynamics {
    explicit kdl_dynamics(const KDL::Chain &given)
        : chain(given), inverse(chain, KDL::Vector(0, 0, -9.81)), forward(chain, KDL::Vector(0, 0, -9.81)),
          parameters(chain, KDL::Vector(0, 0, -9.81)), none(chain.getNrOfSegments(), KDL::Wrench::Zero()),
          q(chain.getNrOfJoints()), dq(q), ddq(q), force(q), mass(chain.getNrOfJoints())
    {
    }
    KDL::Chain chain;
    KDL::ChainIdSolver_RNE inverse;
    KDL::ChainFdSolver_RNE forward;
    KDL::ChainDynParam parameters;
    KDL::Wrenches none;
    KDL::JntArray q, dq, ddq, force;
    KDL::JntSpaceInertiaMatrix mass;
};

extern "C" kdl_dynamics *kdl_dynamics_read(const char *urdf)
{
    const auto model = urdf::parseURDFFile(urdf);
    return model ? new kdl_dynamics(chain_of(*model)) : nullptr;
}

extern "C" void kdl_dynamics_free(kdl_dynamics *dynamics)
{
    delete dynamics;
}

static void set(KDL::JntArray &to, const double *from)
{
    for (unsigned k = 0; k < to.rows(); k++) to(k) = from[k];
}

static void get(double *to, const KDL::JntArray &from)
{
    for (unsigned k = 0; k < from.rows(); k++) to[k] = from(k);
}

extern "C" int kdl_dynamics_inverse(double *force, kdl_dynamics *d, const double *q, const double *dq,
                                    const double *ddq)
{
    set(d->q, q);
    set(d->dq, dq);
    set(d->ddq, ddq);
    if (d->inverse.CartToJnt(d->q, d->dq, d->ddq, d->none, d->force) < 0) return 0;
    get(force, d->force);
    return 1;
}

extern "C" int kdl_dynamics_forward(double *ddq, kdl_dynamics *d, const double *q, const double *dq,
                                    const double *force)
{
    set(d->q, q);
    set(d->dq, dq);
    set(d->force, force);
    if (d->forward.CartToJnt(d->q, d->dq, d->force, d->none, d->ddq) < 0) return 0;
    get(ddq, d->ddq);
    return 1;
}

extern "C" int kdl_dynamics_mass(double *mass, kdl_dynamics *d, const double *q)
{
    set(d->q, q);
    if (d->parameters.JntToMass(d->q, d->mass) < 0) return 0;
    for (unsigned i = 0; i < d->mass.rows(); i++)
        for (unsigned j = 0; j < d->mass.columns(); j++) mass[i * d->mass.columns() + j] = d->mass(i, j);
    return 1;
}
