// The second peer of the dynamics: the URDF through urdfdom into a skeleton of DART, by nothing of ours.
#include <dart/dynamics/BodyNode.hpp>
#include <dart/dynamics/FreeJoint.hpp>
#include <dart/dynamics/RevoluteJoint.hpp>
#include <dart/dynamics/Skeleton.hpp>
#include <urdf_parser/urdf_parser.h>

#include "tests/bench/dynamics_dart.h"

namespace dd = dart::dynamics;

struct dart_dynamics {
    dd::SkeletonPtr skeleton;
};

namespace {

Eigen::Isometry3d frame_of(const urdf::Pose &pose)
{
    Eigen::Isometry3d t = Eigen::Isometry3d::Identity();
    t.linear() =
        Eigen::Quaterniond(pose.rotation.w, pose.rotation.x, pose.rotation.y, pose.rotation.z).matrix();
    t.translation() << pose.position.x, pose.position.y, pose.position.z;
    return t;
}

void set_inertia(dd::BodyNode *body, const urdf::Link &link)
{
    if (!link.inertial) return;
    const urdf::Inertial &i = *link.inertial;
    const Eigen::Isometry3d frame = frame_of(i.origin);
    Eigen::Matrix3d own;
    own << i.ixx, i.ixy, i.ixz, i.ixy, i.iyy, i.iyz, i.ixz, i.iyz, i.izz;
    body->setInertia(
        dd::Inertia(i.mass, frame.translation(), frame.linear() * own * frame.linear().transpose()));
}

const urdf::Link *moving_child(const urdf::Link &link)
{
    for (const auto &child : link.child_links)
        if (child->parent_joint->type != urdf::Joint::FIXED) return child.get();
    return nullptr;
}

dd::SkeletonPtr skeleton_of(const urdf::ModelInterface &model)
{
    auto skeleton = dd::Skeleton::create();
    const urdf::Link *link = model.getRoot().get();
    using named = dd::BodyNode::AspectProperties;
    dd::BodyNode *body = skeleton
                             ->createJointAndBodyNodePair<dd::FreeJoint>(nullptr, dd::FreeJoint::Properties(),
                                                                         named(link->name))
                             .second;
    set_inertia(body, *link);
    while ((link = moving_child(*link))) {
        const urdf::Joint &joint = *link->parent_joint;
        dd::RevoluteJoint::Properties properties;
        properties.mName = joint.name;
        properties.mAxis = Eigen::Vector3d(joint.axis.x, joint.axis.y, joint.axis.z);
        properties.mT_ParentBodyToJoint = frame_of(joint.parent_to_joint_origin_transform);
        body = skeleton->createJointAndBodyNodePair<dd::RevoluteJoint>(body, properties, named(link->name))
                   .second;
        set_inertia(body, *link);
    }
    skeleton->setGravity(Eigen::Vector3d(0, 0, -9.81));
    return skeleton;
}

using vector = Eigen::Map<const Eigen::VectorXd>;

void pose(dart_dynamics *d, const double *rotation, const double *q, const double *nu)
{
    Eigen::Isometry3d base = Eigen::Isometry3d::Identity();
    base.linear() = Eigen::Map<const Eigen::Matrix<double, 3, 3, Eigen::RowMajor>>(rotation);
    const auto n = static_cast<Eigen::Index>(d->skeleton->getNumDofs());
    Eigen::VectorXd positions(n);
    positions.head<6>() = dd::FreeJoint::convertToPositions(base);
    positions.tail(n - 6) = vector(q, n - 6);
    d->skeleton->setPositions(positions);
    d->skeleton->setVelocities(vector(nu, n));
}

} // namespace

extern "C" dart_dynamics *dart_dynamics_read(const char *urdf)
{
    const auto model = urdf::parseURDFFile(urdf);
    return model ? new dart_dynamics{skeleton_of(*model)} : nullptr;
}

extern "C" void dart_dynamics_free(dart_dynamics *d)
{
    delete d;
}

extern "C" void dart_dynamics_inverse(double *force, dart_dynamics *d, const double *rotation,
                                      const double *q, const double *nu, const double *acceleration)
{
    const auto n = static_cast<Eigen::Index>(d->skeleton->getNumDofs());
    pose(d, rotation, q, nu);
    d->skeleton->setAccelerations(vector(acceleration, n));
    d->skeleton->computeInverseDynamics();
    Eigen::Map<Eigen::VectorXd>(force, n) = d->skeleton->getForces();
}

extern "C" void dart_dynamics_forward(double *acceleration, dart_dynamics *d, const double *rotation,
                                      const double *q, const double *nu, const double *force)
{
    const auto n = static_cast<Eigen::Index>(d->skeleton->getNumDofs());
    pose(d, rotation, q, nu);
    d->skeleton->setForces(vector(force, n));
    d->skeleton->computeForwardDynamics();
    Eigen::Map<Eigen::VectorXd>(acceleration, n) = d->skeleton->getAccelerations();
}
