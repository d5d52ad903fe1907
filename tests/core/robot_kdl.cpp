// The peer of the robot's test: the same URDF through urdfdom into a tree of KDL, by nothing of ours.
#include <memory>
#include <string>
#include <vector>

#include <kdl/treefksolverpos_recursive.hpp>
#include <kdl/treejnttojacsolver.hpp>
#include <urdf_parser/urdf_parser.h>

#include "tests/core/robot_kdl.h"

namespace {

KDL::Frame frame_of(const urdf::Pose &pose)
{
    return {KDL::Rotation::Quaternion(pose.rotation.x, pose.rotation.y, pose.rotation.z, pose.rotation.w),
            KDL::Vector(pose.position.x, pose.position.y, pose.position.z)};
}

KDL::Joint joint_of(const urdf::Joint &joint)
{
    const KDL::Frame f = frame_of(joint.parent_to_joint_origin_transform);
    const KDL::Vector axis(joint.axis.x, joint.axis.y, joint.axis.z);
    switch (joint.type) {
    case urdf::Joint::REVOLUTE:
    case urdf::Joint::CONTINUOUS:
        return KDL::Joint(joint.name, f.p, f.M * axis, KDL::Joint::RotAxis);
    case urdf::Joint::PRISMATIC:
        return KDL::Joint(joint.name, f.p, f.M * axis, KDL::Joint::TransAxis);
    default:
        return KDL::Joint(joint.name, KDL::Joint::Fixed);
    }
}

void add_below(KDL::Tree &tree, const urdf::Link &link)
{
    for (const auto &child : link.child_links) {
        const urdf::Joint &joint = *child->parent_joint;
        tree.addSegment(
            KDL::Segment(child->name, joint_of(joint), frame_of(joint.parent_to_joint_origin_transform)),
            link.name);
        add_below(tree, *child);
    }
}

} // namespace

struct kdl_robot {
    KDL::Tree tree;
    std::string root;
    std::vector<std::string> joint; // by KDL's numbers
};

extern "C" kdl_robot *kdl_robot_read(const char *path)
{
    const auto model = urdf::parseURDFFile(path);
    if (!model) return nullptr;
    auto made = std::make_unique<kdl_robot>();
    made->root = model->getRoot()->name;
    made->tree = KDL::Tree(made->root);
    add_below(made->tree, *model->getRoot());
    made->joint.resize(made->tree.getNrOfJoints());
    for (const auto &entry : made->tree.getSegments()) {
        const KDL::Segment &segment = entry.second.segment;
        if (segment.getJoint().getType() != KDL::Joint::None)
            made->joint[entry.second.q_nr] = segment.getJoint().getName();
    }
    return made.release();
}

extern "C" void kdl_robot_free(kdl_robot *robot)
{
    delete robot;
}

extern "C" int kdl_robot_joint_count(const kdl_robot *robot)
{
    return static_cast<int>(robot->joint.size());
}

extern "C" const char *kdl_robot_joint_name(const kdl_robot *robot, int index)
{
    return robot->joint[static_cast<size_t>(index)].c_str();
}

extern "C" int kdl_robot_solve(double rotation[9], double t[3], double *jacobian, const kdl_robot *robot,
                               const double *q, const char *link)
{
    const unsigned n = robot->tree.getNrOfJoints();
    KDL::JntArray positions(n);
    for (unsigned k = 0; k < n; k++) positions(k) = q[k];
    KDL::Frame frame;
    if (link != robot->root) {
        KDL::TreeFkSolverPos_recursive forward(robot->tree);
        if (forward.JntToCart(positions, frame, link) < 0) return 0;
    }
    for (int i = 0; i < 3; i++) {
        t[i] = frame.p(i);
        for (int j = 0; j < 3; j++) rotation[3 * i + j] = frame.M(i, j);
    }
    KDL::Jacobian found(n);
    if (link != robot->root && n > 0) {
        KDL::TreeJntToJacSolver solver(robot->tree);
        if (solver.JntToJac(positions, found, link) < 0) return 0;
    }
    for (unsigned i = 0; i < 6; i++)
        for (unsigned k = 0; k < n; k++) jacobian[i * n + k] = link == robot->root ? 0 : found(i, k);
    return 1;
}
