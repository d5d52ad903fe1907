/* Proves: each texel shows what stands there, at the right place to a pixel, grey and in colour; what stands
 * in front paints nothing behind it, and the ground's colour does not climb on it; of two views the one with
 * the smaller pixel stays, whichever came first; ground that the map believes has changed loses its old
 * colour, ground that one frame only contradicts keeps it; texels grow when memory is short and stay at their
 * places; the state is loaded to the last bit and goes on as if never stopped; another state, other options
 * and damaged files are refused. Reference: hills and a block whose colours are functions of the place, rays
 * met with them in fusion_scene.h. Tolerances: colours change by up to 400 of 255 a metre, a pixel is 1 to 5
 * cm within 5 m, no noise: 4 of 255, so that a centimetre aside is seen. Blind to: blending (there is none),
 * real exposures. */
#include "recon/mosaic.h"

#include <unistd.h>

#include "tests/check.h"
#include "tests/recon/fusion_scene.h"
#include "tests/scratch.h"

static const double BLOCK[6] = {3.8, -0.5, -1, 4.6, 0.5, 1.4}; /* x, y, z of two corners */

typedef struct world {
    bool block;
    double lower; /* m, by which the ground within 1.2 m of (4.5, 0) was dug */
} world;

/* The dug ground: level steps down. */
static bool meet(double p[3], const double from[3], const double ray[3], void *user)
{
    const world *w = user;
    double best = INFINITY, q[3];
    if (w->block) { /* slabs */
        double in = 0, out = INFINITY;
        for (int k = 0; k < 3; k++) {
            const double a = (BLOCK[k] - from[k]) / ray[k], b = (BLOCK[3 + k] - from[k]) / ray[k];
            in = fmax(in, fmin(a, b));
            out = fmin(out, fmax(a, b));
        }
        if (in < out) best = in;
    }
    double lowered[3] = {from[0], from[1], from[2] + w->lower};
    if (w->lower > 0 && scene_meet(q, lowered, ray) && hypot(q[0] - 4.5, q[1]) < 1.2)
        q[2] -= w->lower;
    else if (!scene_meet(q, from, ray))
        q[2] = NAN;
    const double s = (q[2] - from[2]) / ray[2];
    if (s < best) best = s;
    for (int k = 0; k < 3; k++) p[k] = from[k] + best * ray[k];
    return isfinite(best);
}

static bool on_block(const double p[3])
{
    double slope[2];
    return p[2] > scene_height(p[0], p[1], slope) + 0.05;
}

/* Red tells x, green y, blue is `mark`; the block is black. */
static void paint(uint8_t rgb[3], const double p[3], uint8_t mark)
{
    const bool block = on_block(p);
    rgb[0] = block ? 0 : (uint8_t)lround(128 + 100 * sin(4 * p[0]));
    rgb[1] = block ? 0 : (uint8_t)lround(128 + 100 * cos(4 * p[1]));
    rgb[2] = block ? 0 : mark;
}

typedef struct site {
    td_rig *rig;
    td_depth_camera *camera;
    td_fusion_options fusion;
    td_mosaic_options mosaic;
} site;

static site site_new(void)
{
    site s = {
        .rig = scene_rig(1), .fusion = td_fusion_options_default(), .mosaic = td_mosaic_options_default()};
    td_error error;
    free(s.rig->covariance);
    s.rig->covariance = NULL;
    check_ok(td_depth_camera_new(&s.camera, s.rig, 0, 1, 1, 12, &error), error);
    s.mosaic.cell_m = s.fusion.cell_m = 0.08;
    return s;
}

static void site_free(site *s)
{
    td_depth_camera_free(&s->camera);
    td_rig_free(&s->rig);
}

/* The rectified left image: the colour of each pixel's own point, by td_depth_camera_point. */
static td_image *image_of(const site *s, const td_disparity *d, const td_pose *pose, uint8_t mark,
                          int channels)
{
    td_image *image = NULL;
    td_error error;
    check_ok(td_image_new(&image, d->width, d->height, channels, &error), error);
    for (int y = 0; y < d->height; y++)
        for (int x = 0; x < d->width; x++) {
            const size_t i = (size_t)y * (size_t)d->width + (size_t)x;
            td_depth_point point;
            uint8_t rgb[3] = {255, 0, 255};
            if (td_depth_camera_point(&point, s->camera, x, y, d->value[i], d->sigma[i])) {
                double p[3] = {(double)point.p[0], (double)point.p[1], (double)point.p[2]};
                td_pose_transform(p, pose, p);
                paint(rgb, p, mark);
            }
            memcpy(image->data + i * (size_t)channels, rgb, (size_t)channels);
        }
    return image;
}

static void add(td_mosaic *mosaic, td_fusion *fusion, const site *s, const td_pose *pose, const world *w,
                uint8_t mark, int channels)
{
    td_error error;
    td_disparity *d = scene_disparity(s->camera, s->rig, s->rig, pose, 0.05f, meet, (void *)(uintptr_t)w);
    td_image *left = image_of(s, d, pose, mark, channels);
    const td_fusion_frame frame = {s->camera, d, *pose, NULL, 1};
    check_ok(td_fusion_add(fusion, &frame, NULL, &error), error);
    check_ok(td_mosaic_add(mosaic, fusion, &frame, left, &error), error);
    td_image_free(&left);
    scene_disparity_free(&d);
}

static td_orthophoto *photo_of(const td_mosaic *mosaic, const td_fusion *fusion)
{
    td_error error;
    td_elevation *map = NULL;
    td_orthophoto *photo = NULL;
    check_ok(td_fusion_map(&map, NULL, fusion, &error), error);
    check_ok(td_mosaic_photo(&photo, mosaic, map, &error), error);
    assert_non_null(photo);
    td_elevation_free(&map);
    return photo;
}

static const uint8_t *texel_at(const td_orthophoto *p, double x, double y)
{
    const long column = lround((x - p->origin[0]) / p->texel_m),
               row = lround((y - p->origin[1]) / p->texel_m);
    if (column < 0 || row < 0 || column >= p->columns || row >= p->rows) return NULL;
    return p->rgba + 4 * (row * p->columns + column);
}

static bool beside_block(double x, double y, double margin)
{
    return x > BLOCK[0] - margin && x < BLOCK[3] + margin && y > BLOCK[1] - margin && y < BLOCK[4] + margin;
}

/* Colours against the place's own; returns the texels seen. */
static size_t check_colours(const td_orthophoto *p, const td_pose *pose, int channels, bool block)
{
    size_t seen = 0, wrong = 0;
    for (int r = 0; r < p->rows; r++)
        for (int c = 0; c < p->columns; c++) {
            const uint8_t *t = p->rgba + 4 * (r * p->columns + c);
            const double x = p->origin[0] + c * p->texel_m, y = p->origin[1] + r * p->texel_m;
            if (!t[3]) continue;
            seen++;
            if (block && beside_block(x, y, 0.1)) continue; /* looked at apart */
            if (hypot(x - pose->t[0], y - pose->t[1]) > 5) continue;
            uint8_t rgb[3];
            double slope[2];
            const double at[3] = {x, y, scene_height(x, y, slope)};
            paint(rgb, at, 200);
            wrong += abs(t[0] - rgb[0]) > 4 ||
                     (channels == 3 ? abs(t[1] - rgb[1]) > 4 || t[2] != 200 : t[1] != t[0] || t[2] != t[0]);
        }
    print_message("%zu texels of %g m, %zu wrong\n", seen, p->texel_m, wrong);
    assert_int_equal(wrong, 0);
    return seen;
}

static void begin(td_mosaic **mosaic, td_fusion **fusion, const site *s)
{
    td_error error;
    check_ok(td_fusion_new(fusion, &s->fusion, &error), error);
    check_ok(td_mosaic_new(mosaic, &s->mosaic, &error), error);
}

static void end(td_mosaic **mosaic, td_fusion **fusion)
{
    td_mosaic_free(mosaic);
    td_mosaic_free(mosaic);
    td_fusion_free(fusion);
}

static void test_places(void **state)
{
    (void)state;
    site s = site_new();
    td_mosaic *mosaic;
    td_fusion *fusion;
    const world w = {0};
    /* Where negative cells are too; 4 and 1 texels along a cell. */
    const td_pose pose = scene_pose(0.3, 0.2, 2.2, 0.1, 0.6);
    for (int channels = 1; channels <= 3; channels += 2) {
        s.mosaic.texels = channels == 1 ? 1 : 4;
        begin(&mosaic, &fusion, &s);
        add(mosaic, fusion, &s, &pose, &w, 200, channels);
        td_orthophoto *photo = photo_of(mosaic, fusion);
        check_near(photo->texel_m, 0.08 / s.mosaic.texels, 1e-12);
        const size_t seen = check_colours(photo, &pose, channels, false);
        assert_true(seen > 0.9 * 8 / photo->texel_m / photo->texel_m);
        td_orthophoto_free(&photo);
        end(&mosaic, &fusion);
    }
    site_free(&s);
}

static void test_occlusion(void **state)
{
    (void)state;
    site s = site_new();
    td_mosaic *mosaic;
    td_fusion *fusion;
    const world w = {.block = true};
    const td_pose pose = scene_pose(1, 0, 2.4, 0, 0.55);
    begin(&mosaic, &fusion, &s);
    add(mosaic, fusion, &s, &pose, &w, 200, 3);
    td_orthophoto *photo = photo_of(mosaic, fusion);
    check_colours(photo, &pose, 3, true); /* nothing of the block outside it */
    size_t top = 0, behind = 0, hidden = 0;
    for (double x = BLOCK[0] + 0.1; x < BLOCK[3] - 0.1; x += 0.02)
        for (double y = BLOCK[1] + 0.1; y < BLOCK[4] - 0.1; y += 0.02) {
            const uint8_t *t = texel_at(photo, x, y);
            assert_true(!t || !t[3] || (t[0] < 4 && t[1] < 4 && t[2] < 4));
            top += t && t[3];
        }
    /* The block's back edge hides the ground until the ray over it comes down: (2.4 - 1.4) for 3.6 m. */
    for (double x = BLOCK[3] + 0.1; x < 7; x += 0.02)
        for (double y = -0.4; y < 0.4; y += 0.02) {
            const uint8_t *t = texel_at(photo, x, y);
            hidden++;
            behind += t && t[3];
        }
    print_message("%zu texels on the block; %zu of %zu behind it\n", top, behind, hidden);
    assert_true(top > 300);
    assert_int_equal(behind, 0);
    td_orthophoto_free(&photo);
    end(&mosaic, &fusion);
    site_free(&s);
}

static void test_best_view(void **state)
{
    (void)state;
    site s = site_new();
    const world w = {0};
    const td_pose pose[2] = {scene_pose(0, 0, 2.2, 0, 0.6), scene_pose(2, 0.1, 2.2, 0, 0.6)};
    for (int first = 0; first < 2; first++) {
        td_mosaic *mosaic;
        td_fusion *fusion;
        begin(&mosaic, &fusion, &s);
        for (int k = 0; k < 2; k++) {
            const int i = k ? 1 - first : first;
            add(mosaic, fusion, &s, &pose[i], &w, i ? 180 : 20, 3);
        }
        td_orthophoto *photo = photo_of(mosaic, fusion);
        size_t far_view = 0, all = 0;
        /* The nearer one sees from x = 3.6 on; before, only the other does. */
        for (double x = 4; x < 6; x += 0.02)
            for (double y = -0.6; y < 0.6; y += 0.02) {
                const uint8_t *t = texel_at(photo, x, y);
                if (!t || !t[3]) continue;
                all++;
                far_view += t[2] == 20;
            }
        const uint8_t *only = texel_at(photo, 2.6, 0);
        print_message("%zu of %zu texels by the farther view\n", far_view, all);
        assert_true(all > 5000 && far_view < all / 200);
        assert_true(only && only[3] && only[2] == 20);
        td_orthophoto_free(&photo);
        end(&mosaic, &fusion);
    }
    site_free(&s);
}

/* Marks over the middle of the dug place: old, new, none. */
static void marks(size_t count[3], const td_orthophoto *photo)
{
    memset(count, 0, 3 * sizeof *count);
    for (double x = 4.3; x < 4.9; x += 0.02)
        for (double y = -0.3; y < 0.3; y += 0.02) {
            const uint8_t *t = texel_at(photo, x, y);
            count[!t || !t[3] ? 2 : t[2] == 200 ? 0 : 1]++;
        }
}

/* Whether the later views are farther away, so that only the change makes room for them, or nearer, so that
 * only the map's doubt keeps them out. */
static void change(const site *s, bool farther)
{
    td_mosaic *mosaic;
    td_fusion *fusion;
    const world before = {0}, after = {.lower = 0.4};
    const td_pose near_pose = scene_pose(1.5, 0, 2.2, 0, 0.6), far_pose = scene_pose(1, 0, 2.4, 0, 0.55);
    size_t count[3];
    begin(&mosaic, &fusion, s);
    add(mosaic, fusion, s, farther ? &near_pose : &far_pose, &before, 200, 3);
    for (int frame = 0; frame < 3; frame++) {
        add(mosaic, fusion, s, farther ? &far_pose : &near_pose, &after, 40, 3);
        td_orthophoto *photo = photo_of(mosaic, fusion);
        marks(count, photo);
        print_message("dug, frame %d: %zu old, %zu new, %zu unseen\n", frame + 1, count[0], count[1],
                      count[2]);
        assert_true(frame < 2 ? count[0] > 850 && count[1] == 0 : count[0] == 0 && count[1] > 850);
        td_orthophoto_free(&photo);
    }
    end(&mosaic, &fusion);
}

/* The map has changed, and no picture of it was given since: the old one is not shown. */
static void test_stale(void **state)
{
    (void)state;
    site s = site_new();
    td_error error;
    td_mosaic *mosaic;
    td_fusion *fusion;
    world before = {0}, after = {.lower = 0.4};
    const td_pose pose = scene_pose(1.5, 0, 2.2, 0, 0.6);
    size_t count[3];
    begin(&mosaic, &fusion, &s);
    add(mosaic, fusion, &s, &pose, &before, 200, 3);
    td_disparity *d = scene_disparity(s.camera, s.rig, s.rig, &pose, 0.05f, meet, &after);
    const td_fusion_frame frame = {s.camera, d, pose, NULL, 1};
    for (int i = 0; i < 3; i++) check_ok(td_fusion_add(fusion, &frame, NULL, &error), error);
    td_orthophoto *photo = photo_of(mosaic, fusion);
    marks(count, photo);
    assert_int_equal(count[0] + count[1], 0);
    td_orthophoto_free(&photo);
    scene_disparity_free(&d);
    end(&mosaic, &fusion);
    site_free(&s);
}

static void test_change(void **state)
{
    (void)state;
    site s = site_new();
    change(&s, true);
    change(&s, false);
    site_free(&s);
}

static void test_memory(void **state)
{
    (void)state;
    site s = site_new();
    td_mosaic *mosaic;
    td_fusion *fusion;
    const world w = {0};
    const td_pose pose = scene_pose(-1.3, -2.2, 2.2, 0.4, 0.6);
    s.mosaic.texels = 8;
    s.mosaic.memory_bytes = 6 * 128 * 128 * 12;
    begin(&mosaic, &fusion, &s);
    add(mosaic, fusion, &s, &pose, &w, 200, 3);
    td_orthophoto *photo = photo_of(mosaic, fusion);
    assert_true(photo->texel_m > 0.015);
    assert_true(check_colours(photo, &pose, 3, false) > 500);
    td_orthophoto_free(&photo);
    end(&mosaic, &fusion);
    site_free(&s);
}

static void test_state(void **state)
{
    site s = site_new();
    td_mosaic *mosaic, *back = NULL;
    td_fusion *fusion;
    td_error error = {0};
    const world w = {0};
    const td_pose pose[2] = {scene_pose(0, 0, 2.2, 0, 0.6), scene_pose(1.5, 0.4, 2.2, 0.2, 0.6)};
    char *path = td_path_join(*state, "photo.bin"), *again = td_path_join(*state, "again.bin"), *bytes,
         *other;
    size_t size, other_size;
    begin(&mosaic, &fusion, &s);
    add(mosaic, fusion, &s, &pose[0], &w, 20, 3);
    check_ok(td_mosaic_save(mosaic, 7, path, &error), error);
    check_ok(td_mosaic_load(&back, &s.mosaic, 7, path, &error), error);
    /* Both go on, with one fusion. */
    td_disparity *d = scene_disparity(s.camera, s.rig, s.rig, &pose[1], 0.05f, meet, (void *)(uintptr_t)&w);
    td_image *left = image_of(&s, d, &pose[1], 50, 3);
    const td_fusion_frame frame = {s.camera, d, pose[1], NULL, 1};
    check_ok(td_fusion_add(fusion, &frame, NULL, &error), error);
    check_ok(td_mosaic_add(mosaic, fusion, &frame, left, &error), error);
    check_ok(td_mosaic_add(back, fusion, &frame, left, &error), error);
    check_ok(td_mosaic_save(mosaic, 8, path, &error), error);
    check_ok(td_mosaic_save(back, 8, again, &error), error);
    check_ok(td_file_read(&bytes, &size, path, 1 << 28, &error), error);
    check_ok(td_file_read(&other, &other_size, again, 1 << 28, &error), error);
    assert_true(size == other_size && memcmp(bytes, other, size) == 0);
    td_mosaic_free(&back);
    /* Refused. */
    check_fails(td_mosaic_load(&back, &s.mosaic, 7, path, &error), TD_ERROR_DATA, error, "another state");
    td_mosaic_options coarse = s.mosaic;
    coarse.texels = 2;
    check_fails(td_mosaic_load(&back, &coarse, 8, path, &error), TD_ERROR_DATA, error, "4 texels");
    for (size_t cut = 0; cut < size; cut += cut < 200 ? 1 : size / 50) {
        check_ok(td_file_write(again, bytes, cut, &error), error);
        check_fails(td_mosaic_load(&back, &s.mosaic, 8, again, &error), TD_ERROR_FORMAT, error, "again.bin");
        assert_null(back);
    }
    bytes[72 + 16 + 2048 + 4] = bytes[72 + 16 + 2048 + 5] = bytes[72 + 16 + 2048 + 6] =
        bytes[72 + 16 + 2048 + 7] = (char)0xff; /* the first texel's size: NaN */
    check_ok(td_file_write(again, bytes, size, &error), error);
    check_fails(td_mosaic_load(&back, &s.mosaic, 8, again, &error), TD_ERROR_FORMAT, error, "impossible");
    td_image_free(&left);
    check_ok(td_image_new(&left, 10, 10, 3, &error), error);
    check_fails(td_mosaic_add(mosaic, fusion, &frame, left, &error), TD_ERROR_DATA, error, "10x10");
    coarse.texels = 3;
    check_fails(td_mosaic_new(&back, &coarse, &error), TD_ERROR_ARGUMENT, error, "texels");
    td_image_free(&left);
    scene_disparity_free(&d);
    end(&mosaic, &fusion);
    free(bytes);
    free(other);
    free(path);
    free(again);
    site_free(&s);
}

int main(void)
{
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(test_places),
        cmocka_unit_test(test_occlusion),
        cmocka_unit_test(test_best_view),
        cmocka_unit_test(test_change),
        cmocka_unit_test(test_stale),
        cmocka_unit_test(test_memory),
        cmocka_unit_test_setup_teardown(test_state, scratch_make, scratch_remove),
    };
    return cmocka_run_group_tests(tests, NULL, NULL);
}
