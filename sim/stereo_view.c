#include "sim/stereo_view.h"

#include <math.h>
#include <pthread.h>
#include <stdlib.h>
#include <string.h>

#include "core/parallel.h"
#include "sim/stereo_view_internal.h"

/* What later views need of earlier ones. */
typedef struct td_view_cache {
    pthread_mutex_t lock;
    td_view_rays *first;
    float normal[TD_NORMAL_TABLE_SIZE];
} td_view_cache;

/* Quantiles of the normal distribution, by Newton's method on erfc. */
static void fill_normals(float normal[TD_NORMAL_TABLE_SIZE])
{
    double x = 0;
    for (int i = TD_NORMAL_TABLE_SIZE / 2; i < TD_NORMAL_TABLE_SIZE; i++) {
        const double p = (i + 0.5) / TD_NORMAL_TABLE_SIZE;
        for (int k = 0; k < 20; k++) {
            const double error = 1 - 0.5 * erfc(x / 1.4142135623730951) - p;
            x -= error / (0.3989422804014327 * exp(-0.5 * x * x));
        }
        normal[i] = (float)x;
        normal[TD_NORMAL_TABLE_SIZE - 1 - i] = -(float)x;
    }
}

const float *td_stereo_view_normals(const td_stereo_view *view)
{
    return view->cache->normal;
}

static td_status check_scene(const td_scene *scene, td_error *error)
{
    const double *s = scene->sun;
    if (!(fabs(s[0] * s[0] + s[1] * s[1] + s[2] * s[2] - 1) < 1e-6))
        return td_fail(error, TD_ERROR_ARGUMENT, "the scene's sun: (%g, %g, %g) is no unit vector", s[0],
                       s[1], s[2]);
    if (!(scene->ambient >= 0 && scene->ambient <= 1))
        return td_fail(error, TD_ERROR_ARGUMENT, "the scene's ambient light: must be 0 to 1, not %g",
                       scene->ambient);
    for (size_t i = 0; i < scene->picture_count; i++)
        if (!scene->picture[i].image || scene->picture[i].image->channels != 1)
            return td_fail(error, TD_ERROR_ARGUMENT, "picture '%s': a grey image is needed",
                           scene->picture[i].name);
    return TD_OK;
}

td_status td_stereo_view_move(td_stereo_view *view, td_error *error)
{
    view->moving.count = 0;
    TD_TRY(td_bodies_add_moving(&view->moving, view->scene, error));
    return td_bodies_sort(&view->moving, error);
}

static td_status shrink_pictures(td_stereo_view *view, td_error *error)
{
    const td_scene *scene = view->scene;
    view->sizes = calloc(scene->picture_count + 1, sizeof *view->sizes);
    if (!view->sizes) return td_fail(error, TD_ERROR_MEMORY, "no memory for the pictures");
    for (size_t i = 0; i < scene->picture_count; i++) {
        td_picture_sizes *s = view->sizes + i;
        s->image[s->count++] = scene->picture[i].image;
        while (s->count < TD_PICTURE_SIZES && s->image[s->count - 1]->width > 1 &&
               s->image[s->count - 1]->height > 1) {
            TD_TRY(td_image_shrink(&s->image[s->count], s->image[s->count - 1], 1, error));
            s->count++;
        }
    }
    return TD_OK;
}

static td_status build(td_stereo_view *view, td_error *error)
{
    TD_TRY(shrink_pictures(view, error));
    if (view->scene->ground) {
        TD_TRY(td_ground_rays_new(&view->ground, view->scene->ground, error));
        view->has_ground = true;
    }
    TD_TRY(td_bodies_add_fixed(&view->fixed, view->scene, error));
    TD_TRY(td_bodies_sort(&view->fixed, error));
    return td_stereo_view_move(view, error);
}

td_status td_stereo_view_new(td_stereo_view **view, const td_scene *scene, td_error *error)
{
    *view = NULL;
    TD_TRY(check_scene(scene, error));
    td_stereo_view *made = calloc(1, sizeof *made);
    td_view_cache *cache = calloc(1, sizeof *cache);
    if (!made || !cache) {
        free(made);
        free(cache);
        return td_fail(error, TD_ERROR_MEMORY, "no memory for a view");
    }
    pthread_mutex_init(&cache->lock, NULL);
    fill_normals(cache->normal);
    made->scene = scene;
    made->cache = cache;
    td_status status = build(made, error);
    if (status == TD_OK)
        *view = made;
    else
        td_stereo_view_free(&made);
    return status;
}

void td_stereo_view_update(td_stereo_view *view, int column, int row, int columns, int rows)
{
    if (view->has_ground) td_ground_rays_update(&view->ground, column, row, columns, rows);
}

static void free_rays(td_view_rays *rays)
{
    if (rays) free(rays->ray);
    free(rays);
}

void td_stereo_view_free(td_stereo_view **view)
{
    if (!view || !*view) return;
    td_stereo_view *v = *view;
    if (v->has_ground) td_ground_rays_free(&v->ground);
    td_bodies_free(&v->fixed);
    td_bodies_free(&v->moving);
    for (size_t i = 0; v->sizes && i < v->scene->picture_count; i++)
        for (int k = 1; k < v->sizes[i].count; k++) td_image_free(&v->sizes[i].image[k]);
    free(v->sizes);
    while (v->cache->first) {
        td_view_rays *next = v->cache->first->next;
        free_rays(v->cache->first);
        v->cache->first = next;
    }
    pthread_mutex_destroy(&v->cache->lock);
    free(v->cache);
    free(v);
    *view = NULL;
}

/* ---- directions ---- */

static void fill_row(size_t row, void *user)
{
    td_view_rays *rays = user;
    const int width = rays->camera.width;
    for (int x = 0; x < width; x++) {
        float *to = rays->ray[row * width + x];
        const double pixel[2] = {x, (double)row};
        double ray[3];
        const bool found = td_camera_unproject(ray, NULL, NULL, &rays->camera, pixel);
        for (int i = 0; i < 3; i++) to[i] = found ? (float)ray[i] : NAN;
    }
}

static bool same_camera(const td_camera *a, const td_camera *b)
{
    return a->model == b->model && a->width == b->width && a->height == b->height &&
           memcmp(a->parameter, b->parameter, sizeof a->parameter) == 0;
}

static td_status make_rays(td_view_rays **rays, const td_camera *camera, int threads, td_error *error)
{
    td_view_rays *made = calloc(1, sizeof *made);
    if (made) made->ray = malloc((size_t)camera->width * camera->height * sizeof *made->ray);
    if (!made || !made->ray) {
        free_rays(made);
        return td_fail(error, TD_ERROR_MEMORY, "no memory for the directions of %d x %d pixels",
                       camera->width, camera->height);
    }
    made->camera = *camera;
    td_parallel_for((size_t)camera->height, threads, fill_row, made, NULL, NULL);
    *rays = made;
    return TD_OK;
}

td_status td_stereo_view_rays(const td_view_rays **rays, const td_stereo_view *view, const td_camera *camera,
                              int threads, td_error *error)
{
    td_view_cache *cache = view->cache;
    td_view_rays *found;
    td_status status = TD_OK;
    pthread_mutex_lock(&cache->lock);
    for (found = cache->first; found && !same_camera(&found->camera, camera);) found = found->next;
    if (!found && (status = make_rays(&found, camera, threads, error)) == TD_OK) {
        found->next = cache->first;
        cache->first = found;
    }
    pthread_mutex_unlock(&cache->lock);
    *rays = found;
    return status;
}

/* ---- rays ---- */

td_hit td_stereo_view_trace(const td_stereo_view *view, const td_beam *beam, const double origin[3],
                            const double ray[3], double clear)
{
    td_hit hit = {.distance = INFINITY, .what = TD_SEES_SKY};
    const td_bodies *const lists[] = {&view->fixed, &view->moving};
    for (int k = 0; k < 2; k++) {
        uint32_t index;
        const double distance =
            td_bodies_cast(lists[k], beam ? beam + k : NULL, origin, ray, hit.distance, &index);
        if (!(distance < hit.distance)) continue;
        hit.distance = distance;
        hit.body = lists[k]->body + index;
        hit.what = hit.body->kind == TD_BODY_PICTURE    ? TD_SEES_PICTURE
                   : hit.body->kind == TD_BODY_TRIANGLE ? TD_SEES_SOLID
                                                        : TD_SEES_ROBOT;
    }
    if (!view->has_ground) return hit;
    const double distance = td_ground_rays_cast(&view->ground, origin, ray, clear, hit.distance);
    if (distance < hit.distance) hit = (td_hit){.distance = distance, .what = TD_SEES_GROUND};
    return hit;
}

double td_stereo_view_cast(const td_stereo_view *view, const double origin[3], const double ray[3],
                           td_view_what *what)
{
    const td_hit hit = td_stereo_view_trace(view, NULL, origin, ray, 0);
    if (what) *what = hit.what;
    return hit.distance;
}
