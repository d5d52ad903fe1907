/* A URDF. Its tree is read by libxml2 as the file streams past, bounded and judged before urdfdom, which
 * would leak a loop and run down any depth, sees it; then urdfdom reads the numbers, and what it lets pass is
 * judged here: limits the wrong way round, axes of no length, values out of bounds. */
#include <float.h>
#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include <libxml/xmlreader.h>

#include "core/robot_internal.h"
#include "core/text_internal.h"

/* Far beyond every machine. */
static const double LARGEST = 1e9;

typedef struct scan {
    const char *name; /* of the file */
    td_urdf *urdf;
    bool in_joint;
    td_error *error;
} scan;

/* ---- the first look ---- */

static td_status too_many(const scan *s, const char *what, int limit)
{
    return td_fail(s->error, TD_ERROR_FORMAT, "%s: there are more %ss than %d, the most a robot may have",
                   s->name, what, limit);
}

/* The name of a link or joint as written. */
static td_status take_name(const scan *s, xmlTextReaderPtr reader, const char *what, char name[TD_URDF_NAME])
{
    char shown[TD_SHOWN_SIZE];
    xmlChar *text = xmlTextReaderGetAttribute(reader, (const xmlChar *)"name");
    const char *given = text ? (const char *)text : "";
    td_status status = TD_OK;
    if (!*given)
        status = td_fail(s->error, TD_ERROR_FORMAT, "%s:%d: a %s has no name", s->name,
                         xmlTextReaderGetParserLineNumber(reader), what);
    else if (strlen(given) >= TD_NAME_SIZE)
        status = td_fail(s->error, TD_ERROR_FORMAT, "%s: the name of %s '%s' is longer than %d bytes",
                         s->name, what, td_text_shown(shown, given), TD_NAME_SIZE - 1);
    else
        snprintf(name, TD_URDF_NAME, "%s", given);
    xmlFree(text);
    return status;
}

static td_status take_link(const scan *s, xmlTextReaderPtr reader)
{
    td_urdf *urdf = s->urdf;
    char shown[TD_SHOWN_SIZE];
    if (urdf->link_count == TD_ROBOT_MAX_LINKS) return too_many(s, "link", TD_ROBOT_MAX_LINKS);
    td_urdf_link *link = urdf->link + urdf->link_count;
    TD_TRY(take_name(s, reader, "link", link->name));
    for (int i = 0; i < urdf->link_count; i++)
        if (strcmp(urdf->link[i].name, link->name) == 0)
            return td_fail(s->error, TD_ERROR_FORMAT, "%s: the link '%s' is given twice", s->name,
                           td_text_shown(shown, link->name));
    urdf->link_count++;
    return TD_OK;
}

static td_status take_joint(const scan *s, xmlTextReaderPtr reader)
{
    static const char *const kinds[] = {"fixed", "revolute", "continuous", "prismatic"};
    td_urdf *urdf = s->urdf;
    char shown[TD_SHOWN_SIZE], shown_type[TD_SHOWN_SIZE];
    if (urdf->joint_count == TD_ROBOT_MAX_LINKS) return too_many(s, "joint", TD_ROBOT_MAX_LINKS);
    td_urdf_joint *joint = urdf->joint + urdf->joint_count;
    TD_TRY(take_name(s, reader, "joint", joint->name));
    for (int k = 0; k < urdf->joint_count; k++)
        if (strcmp(urdf->joint[k].name, joint->name) == 0)
            return td_fail(s->error, TD_ERROR_FORMAT, "%s: the joint '%s' is given twice", s->name,
                           td_text_shown(shown, joint->name));
    urdf->joint_count++;
    xmlChar *type = xmlTextReaderGetAttribute(reader, (const xmlChar *)"type");
    bool known = false;
    for (int i = 0; i < 4; i++) known |= type && strcmp((const char *)type, kinds[i]) == 0;
    td_text_shown(shown_type, type ? (const char *)type : "");
    xmlFree(type);
    if (known) return TD_OK;
    return td_fail(s->error, TD_ERROR_UNSUPPORTED,
                   "%s: joint '%s' is of the type '%s'; revolute, continuous, prismatic and fixed ones are "
                   "supported",
                   s->name, td_text_shown(shown, joint->name), shown_type);
}

/* The first <parent link> and <child link> of a joint, as urdfdom takes them. */
static void take_ends(td_urdf_joint *joint, xmlTextReaderPtr reader, const char *element)
{
    if (strcmp(element, "mimic") == 0) joint->has_mimic = true;
    char *end = strcmp(element, "parent") == 0  ? joint->parent
                : strcmp(element, "child") == 0 ? joint->child
                                                : NULL;
    if (!end || *end) return;
    xmlChar *text = xmlTextReaderGetAttribute(reader, (const xmlChar *)"link");
    snprintf(end, TD_URDF_NAME, "%s", text ? (const char *)text : "");
    xmlFree(text);
}

/* Elements of the root (depth 1) and of a joint (depth 2). */
static td_status take_element(scan *s, xmlTextReaderPtr reader, int depth)
{
    const char *element = (const char *)xmlTextReaderConstName(reader);
    char shown[TD_SHOWN_SIZE];
    if (depth == 0 && strcmp(element, "robot") != 0)
        return td_fail(s->error, TD_ERROR_FORMAT, "%s: is no URDF: its root is <%s> instead of <robot>",
                       s->name, td_text_shown(shown, element));
    if (depth == 1) {
        s->in_joint = strcmp(element, "joint") == 0;
        if (s->in_joint) return take_joint(s, reader);
        if (strcmp(element, "link") == 0) return take_link(s, reader);
    }
    if (depth == 2 && s->in_joint) take_ends(s->urdf->joint + s->urdf->joint_count - 1, reader, element);
    return TD_OK;
}

static td_status take_node(scan *s, xmlTextReaderPtr reader)
{
    const int type = xmlTextReaderNodeType(reader), depth = xmlTextReaderDepth(reader);
    if (type == XML_READER_TYPE_DOCUMENT_TYPE)
        return td_fail(s->error, TD_ERROR_FORMAT, "%s: a document type is not accepted; take it out",
                       s->name);
    if (depth > TD_URDF_DEPTH)
        return td_fail(s->error, TD_ERROR_FORMAT, "%s:%d: elements are nested more than %d deep", s->name,
                       xmlTextReaderGetParserLineNumber(reader), TD_URDF_DEPTH);
    return type == XML_READER_TYPE_ELEMENT ? take_element(s, reader, depth) : TD_OK;
}

static void keep_first_error(void *user, const char *message, xmlParserSeverities severity,
                             xmlTextReaderLocatorPtr where)
{
    char *why = user;
    (void)severity;
    if (*why || !message) return;
    snprintf(why, TD_SHOWN_SIZE, "line %d: ", xmlTextReaderLocatorLineNumber(where));
    const size_t used = strlen(why);
    snprintf(why + used, TD_SHOWN_SIZE - used, "%.*s", (int)strcspn(message, "\n"), message);
}

/* Names, order and number of links and joints. */
static td_status look(scan *s, const char *text, size_t size)
{
    if (size > TD_URDF_SIZE)
        return td_fail(s->error, TD_ERROR_FORMAT, "%s: is larger than %d MiB, the most a URDF may be",
                       s->name, TD_URDF_SIZE >> 20);
    if (size == 0) return td_fail(s->error, TD_ERROR_FORMAT, "%s: is empty", s->name);
    if (td_utf8_check(text, size) != size)
        return td_fail(s->error, TD_ERROR_FORMAT, "%s: byte %zu is not UTF-8", s->name,
                       td_utf8_check(text, size));
    xmlTextReaderPtr reader =
        xmlReaderForMemory(text, (int)size, NULL, "UTF-8", XML_PARSE_NONET | XML_PARSE_NOERROR);
    if (!reader) return td_fail(s->error, TD_ERROR_MEMORY, "%s: no memory to read it", s->name);
    char why[TD_SHOWN_SIZE] = "";
    xmlTextReaderSetErrorHandler(reader, keep_first_error, why);
    td_status status = TD_OK;
    int more = 0;
    while (status == TD_OK && (more = xmlTextReaderRead(reader)) == 1) status = take_node(s, reader);
    xmlFreeTextReader(reader);
    if (status != TD_OK || more == 0) return status;
    char shown[TD_SHOWN_SIZE];
    return td_fail(s->error, TD_ERROR_FORMAT, "%s: is no XML: %s", s->name, td_text_shown(shown, why));
}

/* ---- judging ---- */

static bool are_finite(const double *value, int count)
{
    for (int i = 0; i < count; i++)
        if (!(fabs(value[i]) <= LARGEST)) return false;
    return true;
}

static bool pose_is_sound(const td_pose *pose)
{
    double square = 0;
    for (int i = 0; i < 4; i++) square += pose->q[i] * pose->q[i];
    return are_finite(pose->t, 3) && fabs(square - 1) < 1e-9;
}

static int find_link(const td_urdf *urdf, const char *name)
{
    for (int i = 0; i < urdf->link_count; i++)
        if (strcmp(urdf->link[i].name, name) == 0) return i;
    return -1;
}

/* Limits and axis; what URDF leaves open is infinite. */
static td_status take_motion(td_robot_joint *to, const td_urdf_joint *from, const char *name, td_error *error)
{
    char shown[TD_SHOWN_SIZE];
    td_text_shown(shown, from->name);
    const double length =
        sqrt(from->axis[0] * from->axis[0] + from->axis[1] * from->axis[1] + from->axis[2] * from->axis[2]);
    if (!(length > 1e-9 && length < LARGEST))
        return td_fail(error, TD_ERROR_FORMAT, "%s: the axis of joint '%s' has no direction", name, shown);
    for (int i = 0; i < 3; i++) to->axis[i] = from->axis[i] / length;
    strcpy(to->name, from->name);
    to->kind = from->kind;
    to->acceleration = INFINITY;
    const bool bounded = from->has_limit && from->kind != TD_JOINT_CONTINUOUS;
    to->lower = bounded ? from->lower : -INFINITY;
    to->upper = bounded ? from->upper : INFINITY;
    to->speed = from->has_limit ? from->speed : INFINITY;
    to->effort = from->has_limit ? from->effort : INFINITY;
    if (bounded && !(to->lower < to->upper))
        return td_fail(error, TD_ERROR_FORMAT,
                       "%s: the limits of joint '%s' are the wrong way round: lower %g, upper %g", name,
                       shown, to->lower, to->upper);
    if (to->speed < 0 || to->effort < 0 || isnan(to->speed) || isnan(to->effort))
        return td_fail(error, TD_ERROR_FORMAT,
                       "%s: the limits of joint '%s' must not be negative: velocity %g, effort %g", name,
                       shown, to->speed, to->effort);
    return TD_OK;
}

/* I_link = R I R^T: the moments in the inertial frame turned into the link's. */
static td_status take_inertia(td_robot_link *to, const td_urdf_link *from, const char *name, td_error *error)
{
    if (!from->has_inertial) return TD_OK;
    char shown[TD_SHOWN_SIZE];
    td_text_shown(shown, from->name);
    const double *m = from->inertia;
    if (!pose_is_sound(&from->link_from_inertial) || !are_finite(m, 6) || !are_finite(&from->mass_kg, 1))
        return td_fail(error, TD_ERROR_FORMAT, "%s: the inertial of link '%s' holds a number out of bounds",
                       name, shown);
    if (from->mass_kg < 0 || m[0] < 0 || m[3] < 0 || m[5] < 0)
        return td_fail(error, TD_ERROR_FORMAT, "%s: link '%s' has a negative mass or moment of inertia", name,
                       shown);
    const double inertia[9] = {m[0], m[1], m[2], m[1], m[3], m[4], m[2], m[4], m[5]};
    double r[9];
    td_pose_rotation(r, &from->link_from_inertial);
    for (int i = 0; i < 3; i++)
        for (int j = 0; j < 3; j++) {
            double sum = 0;
            for (int k = 0; k < 9; k++) sum += r[3 * i + k / 3] * inertia[k] * r[3 * j + k % 3];
            to->inertia[3 * i + j] = sum;
        }
    to->mass_kg = from->mass_kg;
    memcpy(to->com_m, from->link_from_inertial.t, sizeof to->com_m);
    return TD_OK;
}

static td_status take_shapes(td_robot_link *to, const td_urdf_link *from, const char *name, td_error *error)
{
    static const int sizes[] = {
        [TD_PRIMITIVE_BOX] = 3, [TD_PRIMITIVE_CAPSULE] = 2, [TD_PRIMITIVE_SPHERE] = 1};
    char shown[TD_SHOWN_SIZE];
    td_text_shown(shown, from->name);
    if (from->shape_count > TD_ROBOT_MAX_SHAPES)
        return td_fail(error, TD_ERROR_FORMAT, "%s: link '%s' has %d collision shapes, more than %d", name,
                       shown, from->shape_count, TD_ROBOT_MAX_SHAPES);
    for (int i = 0; i < from->shape_count; i++) {
        const td_primitive *shape = from->shape + i;
        bool sound = pose_is_sound(&shape->link_from_shape);
        for (int k = 0; k < sizes[shape->kind]; k++) sound &= shape->size[k] > 0 && shape->size[k] <= LARGEST;
        if (!sound)
            return td_fail(error, TD_ERROR_FORMAT,
                           "%s: collision shape %d of link '%s' has no size, or stands nowhere", name, i + 1,
                           shown);
        to->shape[i] = *shape;
    }
    to->shape_count = from->shape_count;
    to->mesh_count = from->mesh_count;
    return TD_OK;
}

/* ---- the tree ---- */

typedef struct tree {
    const td_urdf *urdf;
    const char *name;
    int joint_of[TD_ROBOT_MAX_LINKS];     /* the joint that holds a link; -1: none */
    int count, order[TD_ROBOT_MAX_LINKS]; /* parents before children */
    td_error *error;
} tree;

static td_status hang_links(tree *t)
{
    const td_urdf *urdf = t->urdf;
    char shown[TD_SHOWN_SIZE], joint[TD_SHOWN_SIZE];
    for (int i = 0; i < urdf->link_count; i++) t->joint_of[i] = -1;
    for (int k = 0; k < urdf->joint_count; k++) {
        const td_urdf_joint *j = urdf->joint + k;
        const int child = find_link(urdf, j->child);
        td_text_shown(joint, j->name);
        if (j->has_mimic)
            return td_fail(t->error, TD_ERROR_UNSUPPORTED,
                           "%s: joint '%s' mimics another; that is not supported", t->name, joint);
        if (!*j->parent || !*j->child)
            return td_fail(t->error, TD_ERROR_FORMAT, "%s: joint '%s' lacks its <%s link=...>", t->name,
                           joint, *j->parent ? "child" : "parent");
        if (child < 0 || find_link(urdf, j->parent) < 0)
            return td_fail(t->error, TD_ERROR_FORMAT, "%s: joint '%s' joins a link '%s' that is not there",
                           t->name, joint, td_text_shown(shown, child < 0 ? j->child : j->parent));
        if (t->joint_of[child] >= 0)
            return td_fail(t->error, TD_ERROR_FORMAT, "%s: the link '%s' hangs on two joints: a loop",
                           t->name, td_text_shown(shown, j->child));
        t->joint_of[child] = k;
    }
    return TD_OK;
}

static td_status find_root(const tree *t, int *root)
{
    char a[TD_SHOWN_SIZE], b[TD_SHOWN_SIZE];
    *root = -1;
    for (int i = 0; i < t->urdf->link_count; i++) {
        if (t->joint_of[i] >= 0) continue;
        if (*root >= 0)
            return td_fail(t->error, TD_ERROR_FORMAT,
                           "%s: there are two roots, '%s' and '%s'; join one to the other", t->name,
                           td_text_shown(a, t->urdf->link[*root].name),
                           td_text_shown(b, t->urdf->link[i].name));
        *root = i;
    }
    if (*root >= 0) return TD_OK;
    return td_fail(t->error, TD_ERROR_FORMAT, "%s: no link is the root: the joints close a loop", t->name);
}

/* Depth first from the root, brothers in the order of their joints in the file. */
static td_status put_in_order(tree *t, int root)
{
    const td_urdf *urdf = t->urdf;
    int waiting[TD_ROBOT_MAX_LINKS], count = 0;
    bool reached[TD_ROBOT_MAX_LINKS] = {false};
    waiting[count++] = root;
    while (count > 0) {
        const int from = waiting[--count];
        reached[from] = true;
        t->order[t->count++] = from;
        for (int k = urdf->joint_count - 1; k >= 0; k--)
            if (strcmp(urdf->joint[k].parent, urdf->link[from].name) == 0)
                waiting[count++] = find_link(urdf, urdf->joint[k].child);
    }
    for (int i = 0; i < urdf->link_count; i++)
        if (!reached[i]) {
            char shown[TD_SHOWN_SIZE];
            return td_fail(t->error, TD_ERROR_FORMAT,
                           "%s: the link '%s' does not hang on the root: its joints close a loop", t->name,
                           td_text_shown(shown, urdf->link[i].name));
        }
    return TD_OK;
}

static td_status add_joint(td_robot *robot, const tree *t, const td_urdf_joint *joint)
{
    td_robot_link *link = robot->link + robot->link_count;
    char shown[TD_SHOWN_SIZE];
    if (!pose_is_sound(&joint->parent_from_child))
        return td_fail(t->error, TD_ERROR_FORMAT, "%s: the origin of joint '%s' is out of bounds", t->name,
                       td_text_shown(shown, joint->name));
    link->parent = td_robot_find_link(robot, joint->parent);
    link->parent_from_link = joint->parent_from_child;
    if (joint->kind == TD_JOINT_FIXED) return TD_OK;
    if (robot->joint_count == TD_ROBOT_MAX_JOINTS)
        return td_fail(t->error, TD_ERROR_FORMAT, "%s: there are more moving joints than %d", t->name,
                       TD_ROBOT_MAX_JOINTS);
    TD_TRY(take_motion(robot->joint + robot->joint_count, joint, t->name, t->error));
    robot->joint[robot->joint_count].link = robot->link_count;
    link->joint = robot->joint_count++;
    return TD_OK;
}

static td_status add_link(td_robot *robot, const tree *t, int from)
{
    td_robot_link *link = robot->link + robot->link_count;
    const td_urdf_link *record = t->urdf->link + from;
    *link = (td_robot_link){.parent = -1, .joint = -1, .parent_from_link = td_pose_identity()};
    strcpy(link->name, record->name);
    TD_TRY(take_inertia(link, record, t->name, t->error));
    TD_TRY(take_shapes(link, record, t->name, t->error));
    if (t->joint_of[from] >= 0) TD_TRY(add_joint(robot, t, t->urdf->joint + t->joint_of[from]));
    robot->link_count++;
    return TD_OK;
}

static td_status parse(td_robot *robot, td_urdf *urdf, const char *text, size_t size, const char *name,
                       td_error *error)
{
    scan s = {.name = name, .urdf = urdf, .error = error};
    TD_TRY(look(&s, text, size));
    if (urdf->link_count == 0) return td_fail(error, TD_ERROR_FORMAT, "%s: the robot has no link", name);
    tree t = {.urdf = urdf, .name = name, .error = error};
    int root = -1;
    TD_TRY(hang_links(&t));
    TD_TRY(find_root(&t, &root));
    TD_TRY(put_in_order(&t, root));
    td_urdf_why why = {0};
    char what[TD_SHOWN_SIZE], where[TD_SHOWN_SIZE];
    if (!td_urdfdom_parse(urdf, text, size, &why))
        return td_fail(error, TD_ERROR_FORMAT, "%s: is no sound URDF: %s%s%s", name,
                       td_text_shown(what, why.what), *why.where ? ": " : "",
                       td_text_shown(where, why.where));
    snprintf(robot->name, sizeof robot->name, "%s", urdf->name);
    for (int i = 0; i < t.count; i++) TD_TRY(add_link(robot, &t, t.order[i]));
    return TD_OK;
}

td_status td_urdf_parse(td_robot *robot, const char *text, size_t size, const char *name, td_error *error)
{
    td_urdf *urdf = calloc(1, sizeof *urdf);
    if (!urdf) return td_fail(error, TD_ERROR_MEMORY, "%s: no memory for a robot", name);
    td_status status = parse(robot, urdf, text, size, name, error);
    free(urdf);
    return status;
}
