// The wall around urdfdom: a URDF's text to flat records. Judging them is left to C.
#include <cstdio>
#include <cstring>
#include <exception>
#include <mutex>
#include <string>
#include <vector>

#include <console_bridge/console.h>
#include <urdf_parser/urdf_parser.h>

#include "core/robot_internal.h"

namespace {

// Keeps what urdfdom would print: the first complaint says what is wrong, the next where.
class Listener : public console_bridge::OutputHandler {
  public:
    Listener() { console_bridge::useOutputHandler(this); }
    ~Listener() override { console_bridge::restorePreviousOutputHandler(); }
    Listener(const Listener &) = delete;
    Listener &operator=(const Listener &) = delete;
    void log(const std::string &text, console_bridge::LogLevel level, const char *, int) override
    {
        if (level >= console_bridge::CONSOLE_BRIDGE_LOG_ERROR) said.push_back(text);
    }
    std::vector<std::string> said;
};

// The handler is the process's: one reader at a time may have it.
std::mutex &turn()
{
    static std::mutex one;
    return one;
}

template <size_t n> void copy_text(char (&to)[n], const std::string &from)
{
    std::snprintf(to, n, "%s", from.c_str());
}

td_pose pose_of(const urdf::Pose &from)
{
    return {{from.rotation.w, from.rotation.x, from.rotation.y, from.rotation.z},
            {from.position.x, from.position.y, from.position.z}};
}

void copy_shape(td_urdf_link *to, const urdf::Collision &from)
{
    if (!from.geometry) return;
    if (from.geometry->type == urdf::Geometry::MESH) {
        to->mesh_count++;
        return;
    }
    if (to->shape_count++ >= TD_ROBOT_MAX_SHAPES) return;
    td_primitive &shape = to->shape[to->shape_count - 1];
    shape.link_from_shape = pose_of(from.origin);
    if (const auto *box = dynamic_cast<const urdf::Box *>(from.geometry.get())) {
        shape.kind = TD_PRIMITIVE_BOX;
        shape.size[0] = box->dim.x;
        shape.size[1] = box->dim.y;
        shape.size[2] = box->dim.z;
    } else if (const auto *cylinder = dynamic_cast<const urdf::Cylinder *>(from.geometry.get())) {
        shape.kind = TD_PRIMITIVE_CAPSULE;
        shape.size[0] = cylinder->radius;
        shape.size[1] = cylinder->length;
    } else if (const auto *sphere = dynamic_cast<const urdf::Sphere *>(from.geometry.get())) {
        shape.kind = TD_PRIMITIVE_SPHERE;
        shape.size[0] = sphere->radius;
    }
}

void copy_link(td_urdf_link *to, const urdf::Link &from)
{
    if (from.inertial) {
        const urdf::Inertial &inertial = *from.inertial;
        const double moments[6] = {inertial.ixx, inertial.ixy, inertial.ixz,
                                   inertial.iyy, inertial.iyz, inertial.izz};
        to->has_inertial = true;
        to->link_from_inertial = pose_of(inertial.origin);
        to->mass_kg = inertial.mass;
        std::memcpy(to->inertia, moments, sizeof moments);
    }
    for (const auto &collision : from.collision_array)
        if (collision) copy_shape(to, *collision);
}

void copy_joint(td_urdf_joint *to, const urdf::Joint &from)
{
    to->kind = from.type == urdf::Joint::REVOLUTE     ? TD_JOINT_REVOLUTE
               : from.type == urdf::Joint::CONTINUOUS ? TD_JOINT_CONTINUOUS
               : from.type == urdf::Joint::PRISMATIC  ? TD_JOINT_PRISMATIC
                                                      : TD_JOINT_FIXED;
    to->parent_from_child = pose_of(from.parent_to_joint_origin_transform);
    to->axis[0] = from.axis.x;
    to->axis[1] = from.axis.y;
    to->axis[2] = from.axis.z;
    if (!from.limits) return;
    to->has_limit = true;
    to->lower = from.limits->lower;
    to->upper = from.limits->upper;
    to->effort = from.limits->effort;
    to->speed = from.limits->velocity;
}

bool copy_model(td_urdf *to, const urdf::ModelInterface &model, td_urdf_why *why)
{
    copy_text(to->name, model.getName());
    for (int i = 0; i < to->link_count; i++) {
        const auto link = model.getLink(to->link[i].name);
        if (!link) {
            copy_text(why->what, "link '" + std::string(to->link[i].name) + "' was not understood");
            return false;
        }
        copy_link(to->link + i, *link);
    }
    for (int k = 0; k < to->joint_count; k++) {
        const auto joint = model.getJoint(to->joint[k].name);
        if (!joint || joint->parent_link_name != to->joint[k].parent ||
            joint->child_link_name != to->joint[k].child) {
            copy_text(why->what, "joint '" + std::string(to->joint[k].name) + "' was not understood");
            return false;
        }
        copy_joint(to->joint + k, *joint);
    }
    return true;
}

} // namespace

extern "C" bool td_urdfdom_parse(td_urdf *urdf, const char *text, size_t size, td_urdf_why *why)
try {
    const std::lock_guard<std::mutex> mine(turn());
    Listener listener;
    const auto model = urdf::parseURDF(std::string(text, size));
    // It complains of a bad mass or shape, and goes on without it: that is no robot to rely on.
    if (model && listener.said.empty()) return copy_model(urdf, *model, why);
    copy_text(why->what, listener.said.empty() ? "urdfdom does not say why" : listener.said[0]);
    if (listener.said.size() > 1) copy_text(why->where, listener.said[1]);
    return false;
} catch (const std::exception &e) {
    copy_text(why->what, e.what());
    return false;
} catch (...) {
    copy_text(why->what, "an unknown failure");
    return false;
}
