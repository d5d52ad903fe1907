#include "calib/placement_internal.h"

#include <math.h>
#include <stdio.h>

#define QUARTER 1.5707963267948966
#define DEGREE 0.017453292519943295

/* Share of the points that a target needs in the image when it may be seen in part. */
#define SHARE_NEEDED 0.6
/* A board is pushed to this part of the way on which it is still seen; nearer to the middle than the least
 * share of the half image, it is not there. */
#define PUSHED 0.95
#define LEAST_PUSH 0.08
enum { TRIED_POINTS = 24, PUSH_STEPS = 6 };

td_board_shape td_board_shape_of(const td_target *target)
{
    td_board_shape s = {.target = target, .points = td_target_point_count(target)};
    double spacing = target->plane[0].spacing_m;
    for (int i = 0; i < 3; i++) {
        s.lower[i] = INFINITY;
        s.upper[i] = -INFINITY;
    }
    for (size_t p = 0; p < s.points; p++) {
        double x[3];
        td_target_point(x, target, p);
        for (int i = 0; i < 3; i++) {
            s.lower[i] = fmin(s.lower[i], x[i]);
            s.upper[i] = fmax(s.upper[i], x[i]);
        }
    }
    s.whole = target->kind == TD_TARGET_CHESSBOARD;
    if (s.whole || target->kind == TD_TARGET_CHARUCO) s.edge_m = spacing;
    if (target->kind == TD_TARGET_MARKS) s.edge_m = spacing / 2;
    s.step = (s.points + TRIED_POINTS - 1) / TRIED_POINTS;
    return s;
}

/* Whether a point of the board is seen: before the camera, in its image, and not beyond the fold of a
 * distorted model, where points come back into the image mirrored: du x dv then points towards the camera. */
static bool in_image(const td_rig_camera *camera, const td_pose *rig_from_target, const double point[3])
{
    double x[3], pixel[2], d[6];
    td_pose_transform(x, rig_from_target, point);
    td_pose_transform(x, &camera->camera_from_rig, x);
    if (!td_camera_project(pixel, d, NULL, &camera->camera, x)) return false;
    double side = (d[1] * d[5] - d[2] * d[4]) * x[0] + (d[2] * d[3] - d[0] * d[5]) * x[1] +
                  (d[0] * d[4] - d[1] * d[3]) * x[2];
    return side > 0 && pixel[0] >= 0 && pixel[1] >= 0 && pixel[0] <= camera->camera.width - 1 &&
           pixel[1] <= camera->camera.height - 1;
}

/* Outer corner 0 to 3, clockwise from the first point, `border` beyond the points. */
static void corner_of(double p[3], const td_board_shape *s, int corner, double border)
{
    p[0] = corner == 1 || corner == 2 ? s->upper[0] + border : s->lower[0] - border;
    p[1] = corner >= 2 ? s->upper[1] + border : s->lower[1] - border;
    p[2] = (s->lower[2] + s->upper[2]) / 2;
}

static bool frame_in_image(const td_board_shape *s, const td_rig_camera *camera,
                           const td_pose *rig_from_target)
{
    double corner[4][3];
    for (int i = 0; i < 4; i++) corner_of(corner[i], s, i, s->edge_m / 2);
    for (int i = 0; i < 4; i++) {
        double middle[3];
        for (int k = 0; k < 3; k++) middle[k] = (corner[i][k] + corner[(i + 1) % 4][k]) / 2;
        if (!in_image(camera, rig_from_target, middle) || !in_image(camera, rig_from_target, corner[i]))
            return false;
    }
    return true;
}

bool td_board_is_seen(const td_board_shape *s, const td_rig_camera *camera, const td_pose *rig_from_target)
{
    if (s->whole) return frame_in_image(s, camera, rig_from_target);
    size_t seen = 0, tried = 0;
    for (size_t p = 0; p < s->points; p += s->step, tried++) {
        double point[3];
        td_target_point(point, s->target, p);
        seen += in_image(camera, rig_from_target, point);
    }
    return (double)seen >= SHARE_NEEDED * (double)tried;
}

bool td_placement_at(td_pose *rig_from_target, const td_board_shape *s, const td_rig_camera *camera,
                     const td_placement *placement, const double pixel[2])
{
    double ray[3], angle = placement->tilt_deg * DEGREE;
    if (!td_camera_unproject(ray, NULL, NULL, &camera->camera, pixel) || ray[2] < 0.2) return false;
    double tilt[6] = {0}, turn[6] = {0}, place[6] = {0}, centre[6] = {0};
    /* Away from the camera is +z: the right side by a turn about -y, the upper one by a turn about -x. */
    if (placement->tilt == TD_TILT_RIGHT) tilt[1] = -angle;
    if (placement->tilt == TD_TILT_LEFT) tilt[1] = angle;
    if (placement->tilt == TD_TILT_UP) tilt[0] = -angle;
    if (placement->tilt == TD_TILT_DOWN) tilt[0] = angle;
    if (placement->turned) turn[2] = QUARTER;
    for (int i = 0; i < 3; i++) {
        place[3 + i] = ray[i] / ray[2] * placement->distance_m;
        centre[3 + i] = -(s->lower[i] + s->upper[i]) / 2;
    }
    td_pose chain = td_pose_inverse(&camera->camera_from_rig);
    const double *const step[4] = {place, tilt, turn, centre};
    for (int i = 0; i < 4; i++) {
        td_pose motion = td_pose_exp(step[i]);
        chain = td_pose_compose(&chain, &motion);
    }
    *rig_from_target = chain;
    return true;
}

/* Whether the board is seen with its centre at `offset` (shares of the half image) from the image's centre.
 */
static bool fits_at(td_placement *placement, const td_board_shape *s, const td_rig_camera *camera,
                    const double offset[2])
{
    double w = camera->camera.width - 1, h = camera->camera.height - 1;
    const double pixel[2] = {w / 2 * (1 + offset[0]), h / 2 * (1 + offset[1])};
    return td_placement_at(&placement->rig_from_target, s, camera, placement, pixel) &&
           td_board_is_seen(s, camera, &placement->rig_from_target);
}

bool td_placement_fit(td_placement *placement, const td_board_shape *s, const td_rig_camera *camera)
{
    const int way[2] = {placement->across, placement->down};
    double offset[2] = {0, 0};
    if (!fits_at(placement, s, camera, offset)) return false;
    for (int axis = 0; axis < 2; axis++) {
        double low = 0, high = 1;
        if (!way[axis]) continue;
        for (int i = 0; i < PUSH_STEPS; i++) {
            double middle = (low + high) / 2;
            offset[axis] = way[axis] * middle;
            *(fits_at(placement, s, camera, offset) ? &low : &high) = middle;
        }
        if (low < LEAST_PUSH) return false;
        offset[axis] = way[axis] * PUSHED * low;
    }
    return fits_at(placement, s, camera, offset);
}

double td_filling_distance(const td_board_shape *s, const td_camera *camera, double share)
{
    double across = s->upper[0] - s->lower[0] + 2 * s->edge_m,
           down = s->upper[1] - s->lower[1] + 2 * s->edge_m;
    return fmax(camera->parameter[0] * across / (share * camera->width),
                camera->parameter[1] * down / (share * camera->height));
}

void td_placement_outline(double outline[8], const td_board_shape *s, const td_rig_camera *camera,
                          const td_pose *rig_from_target)
{
    for (int i = 0; i < 4; i++) {
        double p[3];
        corner_of(p, s, i, s->edge_m);
        td_pose_transform(p, rig_from_target, p);
        td_pose_transform(p, &camera->camera_from_rig, p);
        if (!td_camera_project(outline + 2 * i, NULL, NULL, &camera->camera, p))
            outline[2 * i] = outline[2 * i + 1] = NAN;
    }
}

void td_placement_words(char text[TD_TEXT_SIZE], const td_placement *p, const char *camera_name)
{
    static const char *const places[3][3] = {{"at the upper left", "at the top", "at the upper right"},
                                             {"at the left", "in the middle", "at the right"},
                                             {"at the lower left", "at the bottom", "at the lower right"}};
    static const char *const ways[TD_TILT_COUNT] = {"", "to the right", "to the left", "up", "down"};
    static const char *const distances[3] = {"close by", "", "far off"};
    char tilt[64] = "facing the camera", distance[64], seen_by[TD_NAME_SIZE + 24] = "";
    if (p->tilt != TD_TILT_NONE)
        snprintf(tilt, sizeof tilt, "tilted %d degrees %s", p->tilt_deg, ways[p->tilt]);
    if (p->distance == 1)
        snprintf(distance, sizeof distance, "%.2g m away", p->distance_m);
    else
        snprintf(distance, sizeof distance, "%s (%.2g m)", distances[p->distance], p->distance_m);
    if (camera_name) snprintf(seen_by, sizeof seen_by, " of camera %s's image", camera_name);
    snprintf(text, TD_TEXT_SIZE, "hold the board %s%s, %s%s, %s", places[p->down + 1][p->across + 1], seen_by,
             tilt, p->turned ? ", turned by a quarter" : "", distance);
}
