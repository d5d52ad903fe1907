/* What the cab's camera shows: the scene with its tags rendered, the tags found, the poses that they give. */
#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "apps/servo_internal.h"
#include "calib/tag_dictionary.h"
#include "calib/tags.h"
#include "core/linalg.h"

enum { CELL_PX = 16, MOST_STEPS = 20 };
static const double GROSS = 3; /* sigmas of the residuals, root mean square */

struct servo_view {
    const servo_scenario *s;
    td_scene_file *file;
    td_stereo_view *view;
    td_view_options options;
    td_image *image;
};

/* ---- the scene ---- */

/* Of a tag with a light rim of a cell around its black square. */
static td_status draw_tag(td_image **image, int *side, const char *dictionary, int id, td_error *error)
{
    uint8_t cell[TD_TAG_MAX_CELLS * TD_TAG_MAX_CELLS];
    TD_TRY(td_tag_cells(cell, side, dictionary, 1, id, error));
    const int n = *side + 2, size = n * CELL_PX;
    TD_TRY(td_image_new(image, size, size, 1, error));
    for (int y = 0; y < size; y++)
        for (int x = 0; x < size; x++) {
            const int c = x / CELL_PX - 1, r = y / CELL_PX - 1;
            const bool rim = c < 0 || r < 0 || c >= *side || r >= *side;
            (*image)->data[y * size + x] = rim || cell[r * *side + c] ? 230 : 20;
        }
    return TD_OK;
}

static td_status add_tags(td_scene *scene, const servo_target *target, const char *dictionary,
                          td_error *error)
{
    td_scene_picture *all =
        realloc(scene->picture, (scene->picture_count + (size_t)target->count) * sizeof *all);
    if (!all) return td_fail(error, TD_ERROR_MEMORY, "no memory for the tags");
    scene->picture = all;
    for (int i = 0; i < target->count; i++) {
        const servo_tag *tag = target->tag + i;
        td_scene_picture p = {.link = target->link};
        int side = 0;
        TD_TRY(draw_tag(&p.image, &side, dictionary, tag->id, error));
        p.width_m = p.height_m = tag->size_m * (side + 2) / side;
        const td_pose corner = {.q = {1, 0, 0, 0}, .t = {-p.width_m / 2, -p.width_m / 2, 0}};
        const td_pose at = td_pose_compose(&target->link_from_target, &tag->target_from_tag);
        snprintf(p.name, sizeof p.name, "tag-%d", tag->id);
        p.site_from_picture = td_pose_compose(&at, &corner);
        scene->picture[scene->picture_count++] = p;
    }
    return TD_OK;
}

static td_status make(servo_view *v, uint64_t seed, int threads, td_error *error)
{
    TD_TRY(td_scene_read(&v->file, v->s->scene_path, error));
    TD_TRY(add_tags(&v->file->scene, &v->s->bucket, v->s->dictionary, error));
    TD_TRY(add_tags(&v->file->scene, &v->s->board, v->s->dictionary, error));
    v->options = td_view_options_of_scene(&v->file->image);
    v->options.seed = seed;
    v->options.threads = threads;
    return td_stereo_view_new(&v->view, &v->file->scene, error);
}

td_status servo_view_new(servo_view **out, const servo_scenario *s, uint64_t seed, int threads,
                         td_error *error)
{
    servo_view *v = *out = calloc(1, sizeof *v);
    if (!v) return td_fail(error, TD_ERROR_MEMORY, "no memory for a view");
    v->s = s;
    const td_status status = make(v, seed, threads, error);
    if (status != TD_OK) servo_view_free(out);
    return status;
}

void servo_view_free(servo_view **view)
{
    if (!view || !*view) return;
    td_stereo_view_free(&(*view)->view);
    td_scene_free(&(*view)->file);
    td_image_free(&(*view)->image);
    free(*view);
    *view = NULL;
}

const td_scene *servo_view_scene(const servo_view *view)
{
    return &view->file->scene;
}

const td_image *servo_view_image(const servo_view *view)
{
    return view->image;
}

const td_camera *servo_view_camera(const servo_view *view)
{
    return &view->s->scene->rig->camera[view->s->camera].camera;
}

static td_pose rig_at(const servo_scenario *s, const double *q)
{
    td_pose at[TD_ROBOT_MAX_LINKS];
    const int link = s->scene->mount_link;
    if (link < 0) return s->scene->mount_from_rig;
    td_robot_forward(at, s->scene->scene.robot, q);
    return td_pose_compose(at + link, &s->scene->mount_from_rig);
}

td_pose servo_camera_at(const servo_scenario *s, const double *q)
{
    const td_pose rig = rig_at(s, q),
                  rig_from_camera = td_pose_inverse(&s->scene->rig->camera[s->camera].camera_from_rig);
    return td_pose_compose(&rig, &rig_from_camera);
}

/* ---- points ---- */

int servo_corners(double (*at)[3], const servo_target *target)
{
    static const double corner[4][2] = {{-0.5, -0.5}, {0.5, -0.5}, {0.5, 0.5}, {-0.5, 0.5}};
    for (int i = 0; i < 4 * target->count; i++) {
        const servo_tag *tag = target->tag + i / 4;
        const double p[3] = {corner[i % 4][0] * tag->size_m, corner[i % 4][1] * tag->size_m, 0};
        td_pose_transform(at[i], &tag->target_from_tag, p);
    }
    return 4 * target->count;
}

/* Of Gauss and Newton's step from a pose: the cost there, and the normal equations. INFINITY: a point has no
 * image. */
static double normal_equations(double a[36], double b[6], const servo_points *points, const td_pose *pose,
                               const td_camera *camera)
{
    double cost = 0;
    memset(a, 0, 36 * sizeof *a);
    memset(b, 0, 6 * sizeof *b);
    for (int i = 0; i < points->count; i++) {
        double at[3], by_pose[18], pixel[2], by_point[6];
        if (!points->seen[i]) continue;
        td_pose_transform(at, pose, points->at[i]);
        if (!td_camera_project(pixel, by_point, NULL, camera, at)) return INFINITY;
        td_pose_transform_jacobian(by_pose, at);
        for (int row = 0; row < 2; row++) {
            double j[6] = {0};
            for (int c = 0; c < 6; c++)
                for (int k = 0; k < 3; k++)
                    j[c] += by_point[3 * row + k] * by_pose[6 * k + c] / points->sigma_px[i];
            const double r = (points->pixel[i][row] - pixel[row]) / points->sigma_px[i];
            cost += r * r;
            for (int m = 0; m < 6; m++) {
                b[m] += j[m] * r;
                for (int n = 0; n < 6; n++) a[6 * m + n] += j[m] * j[n];
            }
        }
    }
    return cost;
}

/* Levenberg's damping, so that a start from one small tag cannot throw it. */
static double refine(td_pose *pose, double covariance[36], const servo_points *points,
                     const td_camera *camera)
{
    double a[36], b[6], damping = 1e-6, cost = normal_equations(a, b, points, pose, camera);
    for (int i = 0; i < MOST_STEPS && isfinite(cost); i++) {
        double damped[36], step[6], next_a[36], next_b[6];
        memcpy(damped, a, sizeof damped);
        for (int k = 0; k < 6; k++) damped[7 * k] *= 1 + damping;
        if (td_invert_spd(damped, damped, 6, NULL) != TD_OK) return INFINITY;
        td_multiply(step, damped, b, 6, 6, 1);
        const td_pose next = td_pose_perturb(pose, step);
        const double then = normal_equations(next_a, next_b, points, &next, camera);
        if (!(then < cost)) {
            damping = fmax(10 * damping, 1e-4);
            continue;
        }
        const bool done = cost - then < 1e-9 * (1 + cost);
        *pose = next, cost = then, damping /= 10;
        memcpy(a, next_a, sizeof a);
        memcpy(b, next_b, sizeof b);
        if (done) break;
    }
    return td_invert_spd(covariance, a, 6, NULL) == TD_OK ? cost : INFINITY;
}

/* What is left at each corner; returns the tag of which most is. */
static int measure_residuals(servo_points *points, const td_camera *camera)
{
    double square = 0, most = 0;
    int n = 0, worst = 0;
    points->variance_px2 = 0;
    for (int i = 0; i < points->count; i++) {
        double at[3], pixel[2];
        if (!points->seen[i]) continue;
        td_pose_transform(at, &points->camera_from_target, points->at[i]);
        if (!td_camera_project(pixel, NULL, NULL, camera, at)) continue;
        const double here = pow(points->pixel[i][0] - pixel[0], 2) + pow(points->pixel[i][1] - pixel[1], 2);
        if (here > most) most = here, worst = i / 4;
        square += here;
        points->variance_px2 += points->sigma_px[i] * points->sigma_px[i];
        n++;
    }
    points->freedoms = 2 * n - 6;
    points->variance_px2 /= n;
    points->residual_px2 = square / points->freedoms;
    return worst;
}

static bool solve(servo_points *points, const servo_target *target, const td_camera *camera)
{
    double best = INFINITY;
    for (int t = 0; t < target->count; t++) {
        td_tag tag = {.id = target->tag[t].id};
        td_pose camera_from_tag, back = td_pose_inverse(&target->tag[t].target_from_tag);
        double covariance[36];
        if (!points->seen[4 * t]) continue;
        for (int i = 0; i < 4; i++) {
            memcpy(tag.corner + 2 * i, points->pixel[4 * t + i], 2 * sizeof(double));
            tag.sigma[i] = points->sigma_px[4 * t + i];
        }
        if (!td_tag_pose(&camera_from_tag, NULL, NULL, &tag, target->tag[t].size_m, camera)) continue;
        td_pose pose = td_pose_compose(&camera_from_tag, &back);
        const double cost = refine(&pose, covariance, points, camera);
        if (!(cost < best)) continue;
        best = cost;
        points->camera_from_target = pose;
        memcpy(points->covariance, covariance, sizeof covariance);
    }
    points->has_pose = isfinite(best);
    return points->has_pose;
}

/* Where the residuals are far beyond the corners' sigma something stands before a tag's rim: of three tags
 * and more, the one that fits worst is left out. */
bool servo_pose(servo_points *points, const servo_target *target, const td_camera *camera)
{
    int tags = 0;
    for (int t = 0; t < target->count; t++) tags += points->seen[4 * t];
    for (; solve(points, target, camera); tags--) {
        const int worst = measure_residuals(points, camera);
        if (tags < 3 || points->residual_px2 < GROSS * GROSS * points->variance_px2) return true;
        memset(points->seen + 4 * worst, 0, 4 * sizeof *points->seen);
    }
    return false;
}

static void take(servo_points *points, const servo_target *target, const td_tag *tag, size_t count)
{
    *points = (servo_points){0};
    points->count = servo_corners(points->at, target);
    for (int t = 0; t < target->count; t++)
        for (size_t k = 0; k < count; k++) {
            bool whole = tag[k].id == target->tag[t].id;
            for (int i = 0; i < 4; i++) whole = whole && tag[k].sigma[i] > 0;
            for (int i = 0; i < 4 && whole; i++) {
                points->seen[4 * t + i] = true;
                memcpy(points->pixel[4 * t + i], tag[k].corner + 2 * i, 2 * sizeof(double));
                points->sigma_px[4 * t + i] = tag[k].sigma[i];
            }
        }
}

/* ---- a look ---- */

static td_status render(servo_view *v, const td_plant_state *state, uint64_t frame, bool hidden,
                        td_error *error)
{
    td_scene *scene = &v->file->scene;
    td_view *seen = NULL;
    scene->site_from_vehicle = state->site_from_vehicle;
    memcpy(scene->q, state->q, sizeof scene->q);
    TD_TRY(td_stereo_view_move(v->view, error));
    const td_pose rig = rig_at(v->s, state->q),
                  site_from_rig = td_pose_compose(&state->site_from_vehicle, &rig);
    if (hidden && v->image) {
        memset(v->image->data, 0, (size_t)v->image->width * (size_t)v->image->height);
        return TD_OK;
    }
    TD_TRY(td_stereo_view_render(&seen, v->view, v->s->scene->rig, v->s->camera, &site_from_rig, frame,
                                 &v->options, error));
    td_image_free(&v->image);
    v->image = seen->image;
    seen->image = NULL;
    td_view_free(&seen);
    if (hidden) memset(v->image->data, 0, (size_t)v->image->width * (size_t)v->image->height);
    return TD_OK;
}

td_status servo_view_look(servo_look *look, servo_view *view, const td_plant_state *state, uint64_t frame,
                          bool hidden, td_error *error)
{
    td_tag *tag = NULL;
    const size_t known = (size_t)(view->s->bucket.count + view->s->board.count);
    size_t count = 0;
    TD_TRY(render(view, state, frame, hidden, error));
    const double began = terminal_now_s();
    TD_TRY(td_tags_find(&tag, &count, view->image, view->s->dictionary, 1, known, error));
    take(&look->bucket, &view->s->bucket, tag, count);
    take(&look->board, &view->s->board, tag, count);
    free(tag);
    servo_pose(&look->bucket, &view->s->bucket, servo_view_camera(view));
    servo_pose(&look->board, &view->s->board, servo_view_camera(view));
    look->seconds = terminal_now_s() - began;
    return TD_OK;
}
