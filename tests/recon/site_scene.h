/* Rendered sites with their truth: a scene, its rig, and for each pixel of the rectified left image the
 * disparity of the surface that a ray meets there and whether the right camera sees it. */
#ifndef TELEDIMOS_TESTS_RECON_SITE_SCENE_H
#define TELEDIMOS_TESTS_RECON_SITE_SCENE_H

#include "core/scene.h"
#include "recon/depth_points.h"
#include "sim/stereo_view.h"
#include "tests/check.h"

typedef struct site_scene {
    td_scene_file *file;
    td_stereo_view *view;
} site_scene;

/* Rough ground with stones, f 1600 px and baseline 0.4 m, 1.9 m above it, looking down by 40 degrees: the
 * middle of the image is 3 m away. `look` fills the rest: surface and image. Frames: 0 and 1 from one place,
 * then 0.3, 0.6 and 1.3 m from it, the last turned by half a radian. */
static inline td_scene_file *site_rough(const char *look)
{
    char text[2000];
    td_error error;
    td_scene_file *file = NULL;
    const int size =
        snprintf(text, sizeof text,
                 "teledimos: scene 1\nname: rough\nabout: rough ground with stones at 3 m\nrig: rig.yaml\n"
                 "frames: frames.csv\ngrounds:\n  - name: ground\n    generate: {columns: 900, rows: 900, "
                 "cell_m: 0.01, origin_m: [-1, -4.5], seed: 9, roughness_m: 0.05, scale_m: 1.5, rocks: "
                 "{count: 120, size_m: [0.06, 0.25]}}\n"
                 "mount: {pose: {q: [0.304662867182, -0.638106995229, 0.638106995229, -0.304662867182], t_m: "
                 "[0, 0, 1.9]}}\n%s",
                 look);
    static const char frames[] = "frame,time_s,x_m,y_m,z_m,qw,qx,qy,qz\n"
                                 "01,0,0,0,0,1,0,0,0\n02,1,0,0,0,1,0,0,0\n"
                                 "03,2,0.3,0.1,0,0.9996875163,0,0,0.0249973959\n"
                                 "04,3,0.6,-0.2,0,0.9996875163,0,0,0.0249973959\n"
                                 "05,4,1.2,0.5,0,0.9689124217,0,0,-0.2474039593\n";
    check_ok(td_scene_parse(&file, text, (size_t)size, frames, sizeof frames - 1,
                            TD_SOURCE_DIR "/datasets/site-polyhedra", &error),
             error);
    return file;
}

/* Much light and little: noise of 1.0 to 1.6 grey levels on grain of 25 cm and finer, or of 0.5 to 0.8. */
#define SITE_NOISY                                                                                           \
    "surface: {albedo: 0.36, contrast: 0.28, grain_m: 0.25, octaves: 9, seed: 12}\n"                         \
    "light: {azimuth_deg: 140, elevation_deg: 48, ambient: 0.35}\nimage: {gain: 1.5}\n"
#define SITE_CLEAN                                                                                           \
    "surface: {albedo: 0.36, contrast: 0.28, grain_m: 0.1, octaves: 9, seed: 12}\n"                          \
    "light: {azimuth_deg: 140, elevation_deg: 48, ambient: 0.35}\n"                                          \
    "image: {gain: 1.6, read_noise: 0.4, shot_noise: 0.005, blur_px: 0.4}\n"

static inline site_scene site_scene_of(td_scene_file *file)
{
    site_scene s = {.file = file};
    td_error error;
    check_ok(td_stereo_view_new(&s.view, &file->scene, &error), error);
    return s;
}

static inline void site_scene_free(site_scene *s)
{
    td_stereo_view_free(&s->view);
    td_scene_free(&s->file);
}

/* The raw images of a frame; the scenes here stand still. */
static inline td_pose site_render(td_image *image[2], site_scene *s, size_t frame)
{
    const td_view_options o = td_view_options_of_scene(&s->file->image);
    td_pose site_from_rig;
    td_error error;
    td_scene_pose(s->file, frame, &site_from_rig);
    for (int k = 0; k < 2; k++) {
        td_view *view = NULL;
        check_ok(td_stereo_view_render(&view, s->view, s->file->rig, k, &site_from_rig, frame, &o, &error),
                 error);
        image[k] = view->image;
        view->image = NULL;
        td_view_free(&view);
    }
    return site_from_rig;
}

static inline td_disparity *site_match(const td_depth_camera *camera, td_image *const raw[2])
{
    td_image *left, *right;
    td_disparity *d = NULL;
    td_dense_options o = td_dense_options_default();
    td_error error;
    check_ok(td_depth_camera_rectify(&left, &right, camera, raw[0], raw[1], 0, &error), error);
    td_depth_camera_range(&o.lowest, &o.levels, camera);
    check_ok(td_dense_match(&d, left, right, &o, &error), error);
    td_image_free(&left);
    td_image_free(&right);
    return d;
}

/* The true disparity at a rectified left pixel, and where in the site that is; NAN: nothing is seen there, or
 * the right camera does not see it. */
static inline double site_truth(double p[3], const site_scene *s, const td_depth_camera *camera,
                                const td_pose *site_from_rig, int x, int y)
{
    const td_rectification *r = td_depth_camera_rectification(camera);
    const double *k = r->camera.parameter;
    const td_pose rig_from_camera = td_depth_camera_pose(camera);
    const td_pose site_from_camera = td_pose_compose(site_from_rig, &rig_from_camera);
    double ray[3] = {(x - k[2]) / k[0], (y - k[3]) / k[1], 1}, right[3] = {r->baseline_m, 0, 0}, back[3];
    const double length = sqrt(ray[0] * ray[0] + ray[1] * ray[1] + 1);
    for (int i = 0; i < 3; i++) ray[i] /= length;
    td_pose_rotate(ray, &site_from_camera, ray);
    td_pose_transform(right, &site_from_camera, right);
    const double far = td_stereo_view_cast(s->view, site_from_camera.t, ray, NULL);
    if (!isfinite(far)) return NAN;
    const double disparity = k[0] * r->baseline_m * length / far;
    double reach = 0;
    for (int i = 0; i < 3; i++) {
        p[i] = site_from_camera.t[i] + far * ray[i];
        back[i] = p[i] - right[i];
        reach += back[i] * back[i];
    }
    reach = sqrt(reach);
    for (int i = 0; i < 3; i++) back[i] /= reach;
    const bool shown = x - disparity >= 1 && td_stereo_view_cast(s->view, right, back, NULL) > 0.999 * reach;
    return shown ? disparity : (double)NAN;
}

#endif
