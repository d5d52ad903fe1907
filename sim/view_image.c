/* From rays to an image: a ray through each pixel, more where it holds an edge, then lens and sensor. */
#include <math.h>
#include <stdlib.h>
#include <string.h>

#include "core/parallel.h"
#include "sim/stereo_view_internal.h"

enum { MAX_SAMPLES = 8, MAX_BLUR_RADIUS = 40, STRIP = 8 };

/* An edge: inverse depth, which is straight over a plane, bends by more than this share of itself. */
static const float BEND = 0.004f;

td_view_options td_view_options_default(void)
{
    return (td_view_options){
        .samples = 3, .blur_px = 0.6, .vignetting = 0.5, .gain = 1, .read_noise = 1, .shot_noise = 0.02};
}

td_view_options td_view_options_of_scene(const td_scene_image *image)
{
    return (td_view_options){.samples = image->samples,
                             .blur_px = image->blur_px,
                             .vignetting = image->vignetting,
                             .gain = image->gain,
                             .offset = image->offset,
                             .read_noise = image->read_noise,
                             .shot_noise = image->shot_noise};
}

static td_status check_option(const char *field, double value, double low, double high, td_error *error)
{
    if (value >= low && value <= high) return TD_OK;
    return td_fail(error, TD_ERROR_ARGUMENT, "view options: %s must be %g to %g, not %g", field, low, high,
                   value);
}

static td_status check_options(const td_view_options *o, td_error *error)
{
    TD_TRY(check_option("samples", o->samples, 1, MAX_SAMPLES, error));
    TD_TRY(check_option("blur_px", o->blur_px, 0, 10, error));
    TD_TRY(check_option("vignetting", o->vignetting, 0, 1, error));
    TD_TRY(check_option("gain", o->gain, 1e-3, 1e3, error));
    TD_TRY(check_option("offset", o->offset, -255, 255, error));
    TD_TRY(check_option("read_noise", o->read_noise, 0, 255, error));
    return check_option("shot_noise", o->shot_noise, 0, 255, error);
}

typedef struct job {
    const td_stereo_view *view;
    const td_view_rays *rays;
    const td_view_options *options;
    double origin[3], rotation[9], spread; /* site_from_camera; angle of a pixel */
    int width, height;
    float *light, *blurred; /* (height,width) */
    uint32_t *side;         /* (height,width) */
    td_view *out;
    int radius;
    float kernel[MAX_BLUR_RADIUS + 1];
    uint64_t key;
} job;

/* ---- rays ---- */

static void turn(const job *j, const float ray[3], double out[3])
{
    const double *r = j->rotation;
    for (int i = 0; i < 3; i++) out[i] = r[3 * i] * ray[0] + r[3 * i + 1] * ray[1] + r[3 * i + 2] * ray[2];
}

static void cast_strip(size_t strip, void *user)
{
    const job *j = user;
    const size_t first = strip * STRIP * j->width;
    const size_t last = (strip + 1) * STRIP < (size_t)j->height ? first + (size_t)STRIP * j->width
                                                                : (size_t)j->height * j->width;
    td_shaded s;
    for (size_t begin = first; begin < last; begin += TD_SHADE_BLOCK) {
        const int count = last - begin < TD_SHADE_BLOCK ? (int)(last - begin) : TD_SHADE_BLOCK;
        for (int i = 0; i < count; i++) turn(j, j->rays->ray[begin + i], s.ray[i]);
        td_stereo_view_shade(j->view, j->origin, j->spread, count, &s);
        memcpy(j->light + begin, s.light, count * sizeof(float));
        memcpy(j->side + begin, s.side, count * sizeof(uint32_t));
        memcpy(j->out->what + begin, s.what, count);
        for (int i = 0; i < count; i++)
            j->out->depth[begin + i] =
                s.distance[i] < INFINITY ? s.distance[i] * j->rays->ray[begin + i][2] : NAN;
    }
}

/* Is there an edge between the pixel and its neighbours `step` before and behind? */
static bool bends(const job *j, size_t at, size_t step)
{
    const uint32_t side = j->side[at];
    if (j->side[at - step] != side || j->side[at + step] != side) return true;
    const float *z = j->out->depth + at;
    if (!side) return false;
    const float here = 1 / z[0], before = 1 / *(z - step), behind = 1 / z[step];
    return fabsf(before + behind - 2 * here) > BEND * fabsf(here);
}

static bool needs_more(const job *j, int x, int y)
{
    const size_t at = (size_t)y * j->width + x;
    if (j->out->what[at] == TD_SEES_PICTURE) return true;
    if (x == 0 || y == 0 || x == j->width - 1 || y == j->height - 1) return false;
    return bends(j, at, 1) || bends(j, at, (size_t)j->width);
}

/* n x n rays through a pixel, their directions from those of its neighbours: to second order of the angle of
 * a pixel, 1e-4 px. */
static float sample_pixel(const job *j, int x, int y)
{
    const int n = j->options->samples, before = x > 0, above = y > 0;
    const int behind = x < j->width - 1, below = y < j->height - 1;
    const float(*ray)[3] = (const float(*)[3])j->rays->ray + (size_t)y * j->width + x;
    float right[3], down[3];
    for (int i = 0; i < 3; i++) {
        right[i] = before + behind ? (ray[behind][i] - (*(ray - before))[i]) / (float)(before + behind) : 0;
        down[i] = above + below
                      ? (ray[below * j->width][i] - (*(ray - above * j->width))[i]) / (float)(above + below)
                      : 0;
    }
    td_shaded s;
    for (int k = 0; k < n * n; k++) {
        const float dx = ((float)(k % n) + 0.5f) / (float)n - 0.5f,
                    dy = ((float)(k / n) + 0.5f) / (float)n - 0.5f;
        float to[3], length = 0;
        for (int i = 0; i < 3; i++) {
            to[i] = (*ray)[i] + dx * right[i] + dy * down[i];
            length += to[i] * to[i];
        }
        length = 1 / sqrtf(length);
        for (int i = 0; i < 3; i++) to[i] *= length;
        turn(j, to, s.ray[k]);
    }
    td_stereo_view_shade(j->view, j->origin, j->spread / n, n * n, &s);
    float sum = 0;
    for (int k = 0; k < n * n; k++) sum += s.light[k];
    return sum / (float)(n * n);
}

static void refine_strip(size_t strip, void *user)
{
    job *j = user;
    for (int y = (int)strip * STRIP; y < (int)(strip + 1) * STRIP && y < j->height; y++)
        for (int x = 0; x < j->width; x++)
            if (needs_more(j, x, y)) j->light[(size_t)y * j->width + x] = sample_pixel(j, x, y);
}

/* ---- lens and sensor ---- */

static void make_kernel(job *j)
{
    const double sigma = j->options->blur_px;
    double sum = 0;
    j->radius = sigma > 0 ? (int)ceil(4 * sigma) : 0;
    for (int i = -j->radius; i <= j->radius; i++) sum += sigma > 0 ? exp(-0.5 * i * i / (sigma * sigma)) : 1;
    for (int i = 0; i <= j->radius; i++)
        j->kernel[i] = (float)((sigma > 0 ? exp(-0.5 * i * i / (sigma * sigma)) : 1) / sum);
}

static int inside(int i, int size)
{
    return i < 0 ? 0 : i >= size ? size - 1 : i;
}

static void blur_row(const job *j, const float *from, float *to)
{
    const int r = j->radius, width = j->width;
    for (int x = 0; x < width; x++) to[x] = j->kernel[0] * from[x];
    for (int k = 1; k <= r; k++) {
        const float weight = j->kernel[k];
        const int begin = k < width ? k : width, end = width - k > begin ? width - k : begin;
        for (int x = 0; x < begin; x++)
            to[x] += weight * (from[inside(x - k, width)] + from[inside(x + k, width)]);
        for (int x = begin; x < end; x++) to[x] += weight * (from[x - k] + from[x + k]);
        for (int x = end; x < width; x++)
            to[x] += weight * (from[inside(x - k, width)] + from[inside(x + k, width)]);
    }
}

static void blur_rows(size_t strip, void *user)
{
    job *j = user;
    for (int y = (int)strip * STRIP; y < (int)(strip + 1) * STRIP && y < j->height; y++)
        blur_row(j, j->light + (size_t)y * j->width, j->blurred + (size_t)y * j->width);
}

static void blur_columns(const job *j, int y, float *to)
{
    for (int x = 0; x < j->width; x++) to[x] = j->kernel[0] * j->blurred[(size_t)y * j->width + x];
    for (int k = 1; k <= j->radius; k++) {
        const float *above = j->blurred + (size_t)inside(y - k, j->height) * j->width;
        const float *below = j->blurred + (size_t)inside(y + k, j->height) * j->width;
        for (int x = 0; x < j->width; x++) to[x] += j->kernel[k] * (above[x] + below[x]);
    }
}

/* The finaliser of SplitMix64 (Steele, Lea and Flood 2014). */
static inline uint64_t mixed(uint64_t h)
{
    h = (h ^ (h >> 30)) * 0xBF58476D1CE4E5B9u;
    h = (h ^ (h >> 27)) * 0x94D049BB133111EBu;
    return h ^ (h >> 31);
}

/* Row of eight bits from the blurred light. */
static void expose_row(const job *j, int y, const float *light)
{
    const td_view_options *o = j->options;
    const float *normal = td_stereo_view_normals(j->view);
    const float gain = (float)(255 * o->gain), offset = (float)o->offset, share = (float)o->vignetting;
    const float read = (float)(o->read_noise * o->read_noise), shot = (float)o->shot_noise;
    const size_t first = (size_t)y * j->width;
    uint8_t *grey = j->out->image->data + first;
    for (int x = 0; x < j->width; x++) {
        const float z = j->rays->ray[first + x][2], z2 = z == z ? z * z : 1;
        const float value = gain * light[x] * (1 - share * (1 - z2 * z2)) + offset;
        const float deviation = sqrtf(read + shot * (value > 0 ? value : 0));
        const float seen =
            value + deviation * normal[mixed(j->key + (first + x) * 0x9E3779B97F4A7C15u) >> 52] + 0.5f;
        grey[x] = (uint8_t)(seen < 0 ? 0 : seen > 255 ? 255 : seen);
    }
}

/* The row of lights of a strip is kept in `light`, which is no longer needed. */
static void expose_strip(size_t strip, void *user)
{
    job *j = user;
    for (int y = (int)strip * STRIP; y < (int)(strip + 1) * STRIP && y < j->height; y++) {
        float *row = j->light + (size_t)y * j->width;
        blur_columns(j, y, row);
        expose_row(j, y, row);
    }
}

/* ---- all ---- */

static void run(job *j)
{
    const td_parallel_function stages[] = {cast_strip, refine_strip, blur_rows, expose_strip};
    const size_t strips = ((size_t)j->height + STRIP - 1) / STRIP;
    for (size_t k = 0; k < sizeof stages / sizeof *stages; k++)
        if (k != 1 || j->options->samples > 1)
            td_parallel_for(strips, j->options->threads, stages[k], j, NULL, NULL);
}

static td_status prepare(job *j, const td_rig_camera *camera, const td_pose *site_from_rig, td_error *error)
{
    const size_t pixels = (size_t)j->width * j->height;
    const td_pose rig_from_camera = td_pose_inverse(&camera->camera_from_rig);
    const td_pose site_from_camera = td_pose_compose(site_from_rig, &rig_from_camera);
    td_pose_rotation(j->rotation, &site_from_camera);
    memcpy(j->origin, site_from_camera.t, sizeof j->origin);
    j->spread = 1 / fmin(camera->camera.parameter[0], camera->camera.parameter[1]);
    make_kernel(j);
    TD_TRY(td_stereo_view_rays(&j->rays, j->view, &camera->camera, j->options->threads, error));
    TD_TRY(td_image_new(&j->out->image, j->width, j->height, 1, error));
    j->out->depth = malloc(pixels * sizeof *j->out->depth);
    j->out->what = malloc(pixels);
    j->light = malloc(pixels * sizeof *j->light);
    j->blurred = malloc(pixels * sizeof *j->blurred);
    j->side = malloc(pixels * sizeof *j->side);
    if (j->out->depth && j->out->what && j->light && j->blurred && j->side) return TD_OK;
    return td_fail(error, TD_ERROR_MEMORY, "no memory for a view of %d x %d pixels", j->width, j->height);
}

td_status td_stereo_view_render(td_view **out, const td_stereo_view *view, const td_rig *rig, int camera,
                                const td_pose *site_from_rig, uint64_t frame, const td_view_options *options,
                                td_error *error)
{
    const td_view_options defaults = td_view_options_default();
    if (!options) options = &defaults;
    *out = NULL;
    if (camera < 0 || camera >= rig->count)
        return td_fail(error, TD_ERROR_ARGUMENT, "camera %d: the rig has %d", camera, rig->count);
    const td_rig_camera *c = rig->camera + camera;
    TD_TRY(check_options(options, error));
    TD_TRY(td_camera_check(&c->camera, error));
    job j = {.view = view, .options = options, .width = c->camera.width, .height = c->camera.height};
    j.key = mixed(mixed(options->seed) + mixed(frame * TD_RIG_MAX_CAMERAS + (uint64_t)camera + 1));
    j.out = calloc(1, sizeof *j.out);
    td_status status = j.out ? prepare(&j, c, site_from_rig, error)
                             : td_fail(error, TD_ERROR_MEMORY, "no memory for a view");
    if (status == TD_OK) {
        run(&j);
        *out = j.out;
    } else {
        td_view_free(&j.out);
    }
    free(j.light);
    free(j.blurred);
    free(j.side);
    return status;
}

void td_view_free(td_view **view)
{
    if (!view || !*view) return;
    td_image_free(&(*view)->image);
    free((*view)->depth);
    free((*view)->what);
    free(*view);
    *view = NULL;
}
