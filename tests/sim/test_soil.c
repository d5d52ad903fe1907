/* Soil that is dug, sim/soil.
 *
 * Proves: no milligram is lost or made in random cycles of digging and dumping, counted over every cell after
 * every update; the same bytes on a rerun; no cell outside the disturbed rectangle differs by a bit from the
 * map; heaps of three soils rest at their angle of repose within 1 deg in 24 directions, and are as bulky as
 * mass / (density / swell) to 1e-9; what the blade sweeps is what the bucket gets, against the swept box by
 * hand; the bucket holds at tilts what its law says; the force in motion is that of sim/soil_force (tested
 * apart) at the cut's depth, rake and load, opposed to the motion; unknown ground is neither dug nor filled;
 * a bank of sand falls and one of dirt stands; presets; refusals by their words. Slopes: least squares of the
 * surface along a ray between a fifth and four fifths of the heap's height; the grid's first-order gradient
 * leaves up to 0.6 deg. Blind to: how fast real soil flows, and to soil that a real bucket's sides would hold
 * back. */
#include "sim/soil.h"

#include "core/random.h"
#include "sim/soil_preset.h"
#include "tests/check.h"

static td_error error;
static const double PI = 3.14159265358979323846, G = 9.80665, MG = 1e-6;
static const double DIG = 135, UPRIGHT = 180, OVER = 60; /* deg: pitch of the bucket's link */

static td_soil_preset preset_of(const char *name)
{
    char path[1024];
    td_soil_preset preset;
    snprintf(path, sizeof path, "%s/datasets/soils/%s.yaml", TD_SOURCE_DIR, name);
    check_ok(td_soil_preset_read(&preset, path, &error), error);
    return preset;
}

/* Flat at z = 0, its middle at (0, 0). */
static td_elevation *flat(int size, double cell)
{
    td_elevation *map = NULL;
    const double origin[2] = {-(size - 1) * cell / 2, -(size - 1) * cell / 2};
    check_ok(td_elevation_new(&map, size, size, cell, origin, "site", &error), error);
    for (int i = 0; i < size * size; i++) map->height[i] = 0;
    return map;
}

static td_soil *soil_on(td_elevation *map, const char *name)
{
    td_soil *soil = NULL;
    const td_soil_preset preset = preset_of(name);
    const td_soil_bucket bucket = td_soil_bucket_zx200();
    check_ok(td_soil_new(&soil, map, &preset, &bucket, NULL, &error), error);
    return soil;
}

/* The bucket with the middle of its edge at (x, y, z), its tip `pitch` below forward, forward at `yaw`. */
static td_pose pose_at(double x, double y, double z, double yaw, double pitch_deg)
{
    const double about_z[3] = {0, 0, yaw}, about_y[3] = {0, pitch_deg * PI / 180, 0};
    const td_soil_bucket bucket = td_soil_bucket_zx200();
    td_pose turn = td_pose_identity(), tip = td_pose_identity();
    double edge[3];
    td_rotation_exp(turn.q, about_z);
    td_rotation_exp(tip.q, about_y);
    td_pose pose = td_pose_compose(&turn, &tip);
    td_pose_rotate(edge, &pose, bucket.edge);
    pose.t[0] = x - edge[0], pose.t[1] = y - edge[1], pose.t[2] = z - edge[2];
    return pose;
}

static td_soil_state step_to(td_soil *soil, const td_pose *pose)
{
    td_soil_state s;
    check_ok(td_soil_step(soil, pose, 0.02, &error), error);
    td_soil_get(&s, soil);
    return s;
}

/* In a straight line, `steps` updates. */
static td_soil_state drag(td_soil *soil, const double from[3], const double to[3], double yaw, double pitch0,
                          double pitch1, int steps, int64_t total)
{
    td_soil_state s = {0};
    for (int n = 1; n <= steps; n++) {
        const double u = (double)n / steps;
        const td_pose pose = pose_at(from[0] + u * (to[0] - from[0]), from[1] + u * (to[1] - from[1]),
                                     from[2] + u * (to[2] - from[2]), yaw, pitch0 + u * (pitch1 - pitch0));
        s = step_to(soil, &pose);
        if (total) {
            const td_soil_balance b = td_soil_balance_of(soil);
            if (b.total_mg != total || b.bucket_mg != s.bucket_mg || b.airborne_mg != s.airborne_mg)
                fail_msg("total %lld mg instead of %lld", (long long)b.total_mg, (long long)total);
        }
    }
    return s;
}

/* ---- heaps ---- */

static double slope_along(const td_soil *soil, double azimuth, double top, double cell)
{
    double n = 0, sr = 0, sh = 0, srr = 0, srh = 0;
    for (double r = cell; r < 3; r += cell / 4) {
        const double h = td_soil_height_at(soil, r * cos(azimuth), r * sin(azimuth));
        if (!(h > 0.2 * top && h < 0.8 * top)) continue;
        n++, sr += r, sh += h, srr += r * r, srh += r * h;
    }
    return -atan((n * srh - sr * sh) / (n * srr - sr * sr)) * 180 / PI;
}

static void heap(const char *name)
{
    const int size = 101;
    const double cell = 0.05;
    td_elevation *map = flat(size, cell);
    td_soil *soil = soil_on(map, name);
    const td_soil_preset preset = preset_of(name);
    for (int n = 0; n < 10; n++) {
        check_ok(td_soil_pour(soil, size / 2, size / 2, 120000000, &error), error);
        check_ok(td_soil_settle(soil, &error), error);
    }
    const td_soil_balance b = td_soil_balance_of(soil);
    assert_true(b.loose_mg == 1200000000 && b.airborne_mg == 0);
    double volume = 0, worst = 0, mean = 0, skew = 0;
    for (int r = 0; r < size; r++)
        for (int c = 0; c < size; c++) {
            const double h = td_soil_height(soil, c, r);
            volume += h * cell * cell;
            skew = fmax(skew, fabs(h - td_soil_height(soil, size - 1 - c, r)));
            skew = fmax(skew, fabs(h - td_soil_height(soil, r, c)));
        }
    check_near(volume / (1200 * preset.swell / preset.density_kg_m3), 1, 1e-9);
    const double top = td_soil_height(soil, size / 2, size / 2), repose = preset.repose_rad * 180 / PI;
    for (int k = 0; k < 24; k++) {
        const double slope = slope_along(soil, k * PI / 12, top, cell);
        mean += slope / 24;
        worst = fmax(worst, fabs(slope - repose));
    }
    print_message("%s: %.2f m high, slope %.2f deg (repose %.0f), worst apart %.2f, skew %.1f mm\n", name,
                  top, mean, repose, worst, 1000 * skew);
    check_less(worst, 1);
    check_less(skew, 0.15 * cell);
    td_soil_free(&soil);
    td_elevation_free(&map);
}

static void heaps_rest_at_repose(void **state)
{
    (void)state;
    heap("dirt_1");
    heap("sand");
    heap("clay");
}

/* ---- digging ---- */

/* A drag through level ground: the box it sweeps, in bank density, is what the bucket gets. */
static void cuts_what_it_sweeps(void **state)
{
    (void)state;
    td_elevation *map = flat(81, 0.05);
    td_soil *soil = soil_on(map, "dirt_1");
    const td_pose start = pose_at(1, 0.01, -0.2, 0, DIG);
    const double from[3] = {1, 0.01, -0.2}, to[3] = {0, 0.01, -0.2};
    check_ok(td_soil_place(soil, &start, &error), error);
    const int64_t total = td_soil_balance_of(soil).total_mg;
    const td_soil_state s = drag(soil, from, to, 0, DIG, DIG, 40, total);
    /* Centres of 22 rows within 1.1 m, of 21 columns on 1 m: as a rule, cells whose centre is swept. */
    const double box = 21 * 22 * 0.05 * 0.05 * 0.2 * 1474;
    check_near((double)s.bucket_mg * MG, box, 1e-3);
    assert_true(s.in_soil);
    for (int c = 42; c < 58; c++) check_near(td_soil_height(soil, c, 40), -0.2, 1e-6);
    /* The cohesive bank stands. */
    assert_true(td_soil_height(soil, 50, 40 + 12) == 0);
    td_soil_free(&soil);
    td_elevation_free(&map);
}

/* Deeper and longer than it holds: full to the heap, and the rest lies ahead. */
static void spills_ahead(void **state)
{
    (void)state;
    td_elevation *map = flat(121, 0.05);
    td_soil *soil = soil_on(map, "dirt_1");
    const td_pose start = pose_at(2, 0, -0.4, 0, DIG);
    const double from[3] = {2, 0, -0.4}, to[3] = {0, 0, -0.4};
    check_ok(td_soil_place(soil, &start, &error), error);
    const td_soil_state s = drag(soil, from, to, 0, DIG, DIG, 80, td_soil_balance_of(soil).total_mg);
    check_near((double)s.bucket_mg * MG, 0.8 * 1474 / 1.28, 1e-5);
    assert_true(td_soil_height_at(soil, -0.3, 0) > 0.2);
    assert_true(td_soil_loose_height(soil, 60 - 6, 60) > 0.2);
    td_soil_free(&soil);
    td_elevation_free(&map);
}

static void pushing_back_compacts(void **state)
{
    (void)state;
    td_elevation *map = flat(61, 0.05);
    td_soil *soil = soil_on(map, "dirt_1");
    for (int r = 20; r <= 40; r++)
        for (int c = 20; c <= 40; c++) check_ok(td_soil_pour(soil, c, r, 500000, &error), error);
    check_ok(td_soil_settle(soil, &error), error);
    const td_soil_balance before = td_soil_balance_of(soil);
    const double height = td_soil_height(soil, 30, 30);
    /* The floor level, opening up, pressed straight down. */
    const td_pose high = pose_at(-0.25, 0, height + 0.01, 0, 173.2),
                  low = pose_at(-0.25, 0, height - 0.02, 0, 173.2);
    check_ok(td_soil_place(soil, &high, &error), error);
    const td_soil_state s = step_to(soil, &low);
    const td_soil_balance after = td_soil_balance_of(soil);
    assert_true(after.total_mg == before.total_mg && after.loose_mg < before.loose_mg &&
                after.bucket_mg == 0);
    check_near(td_soil_height(soil, 30, 30), height - 0.02, 2e-3);
    check_less(1e4, s.force[2]); /* the ground bears it */
    td_soil_free(&soil);
    td_elevation_free(&map);
}

static void holds_by_its_tilt(void **state)
{
    (void)state;
    static const struct {
        double pitch, volume; /* of dirt_1, repose 40 deg: 0.8 heaped, 0.58 struck */
    } row[] = {{180, 0.8}, {160, 0.58 + 0.22 * 0.5}, {140, 0.58}, {90, 0.58 * 40 / 90}, {50, 0}};
    td_elevation *map = flat(121, 0.05);
    td_soil *soil = soil_on(map, "dirt_1");
    const td_pose start = pose_at(2, 0, -0.4, 0, DIG);
    const double from[3] = {2, 0, -0.4}, to[3] = {0, 0, -0.4};
    const int64_t total = td_soil_balance_of(soil).total_mg;
    check_ok(td_soil_place(soil, &start, &error), error);
    drag(soil, from, to, 0, DIG, UPRIGHT, 80, total);
    const td_pose up = pose_at(1, 1, 2, 0, UPRIGHT);
    check_ok(td_soil_place(soil, &up, &error), error);
    for (size_t k = 0; k < sizeof row / sizeof *row; k++) {
        const td_pose tilted = pose_at(1, 1, 2, 0, row[k].pitch);
        check_ok(td_soil_place(soil, &tilted, &error), error);
        const td_soil_state s = step_to(soil, &tilted);
        check_near((double)s.bucket_mg * MG * 1.28 / 1474, row[k].volume, 1e-6);
        /* No motion: nothing but the weight. */
        check_near(s.force[2], -(double)s.bucket_mg * MG * G, 1e-6);
        if (k == 4) assert_true(s.airborne_mg > 0);
        assert_true(td_soil_balance_of(soil).total_mg == total);
    }
    /* 2 m: 0.64 s. */
    for (int n = 0; n < 29; n++) check_ok(td_soil_step(soil, NULL, 0.02, &error), error);
    assert_true(td_soil_balance_of(soil).airborne_mg > 0);
    for (int n = 0; n < 5; n++) check_ok(td_soil_step(soil, NULL, 0.02, &error), error);
    assert_true(td_soil_balance_of(soil).airborne_mg == 0 && td_soil_balance_of(soil).bucket_mg == 0);
    check_less(0.2, td_soil_height_at(soil, 1, 1));
    td_soil_free(&soil);
    td_elevation_free(&map);
}

static void bank_of_sand_falls(void **state)
{
    (void)state;
    for (int k = 0; k < 2; k++) {
        td_elevation *map = flat(121, 0.05);
        td_soil *soil = soil_on(map, k ? "dirt_1" : "sand");
        const td_pose start = pose_at(0.5, 0, -0.6, 0, DIG);
        const double from[3] = {0.5, 0, -0.6}, to[3] = {-0.5, 0, -0.6};
        check_ok(td_soil_place(soil, &start, &error), error);
        const int64_t total = td_soil_balance_of(soil).total_mg;
        drag(soil, from, to, 0, DIG, DIG, 40, total);
        check_ok(td_soil_settle(soil, &error), error);
        assert_true(td_soil_balance_of(soil).total_mg == total);
        /* 5 cm beside the trench. */
        const double beside = td_soil_height_at(soil, 0.3, 0.62);
        if (k)
            assert_true(beside == 0);
        else
            check_less(beside, -0.1);
        td_soil_free(&soil);
        td_elevation_free(&map);
    }
}

/* ---- forces ---- */

static void force_is_the_wedges(void **state)
{
    (void)state;
    td_elevation *map = flat(121, 0.05);
    td_soil *soil = soil_on(map, "dirt_1");
    const td_soil_preset preset = preset_of("dirt_1");
    const double depth = 0.3, x0 = 2;
    const td_pose start = pose_at(x0, 0, -depth, 0, DIG);
    td_soil_state s = {0};
    check_ok(td_soil_place(soil, &start, &error), error);
    for (int n = 1; n <= 15; n++) {
        const td_pose pose = pose_at(x0 - 0.02 * n, 0, -depth, 0, DIG);
        s = step_to(soil, &pose);
        /* Floor from (1.562, 0) back to (1.05, 0.06): 6.68 deg flatter than the link's axis. */
        const double rake = PI - DIG * PI / 180 - atan2(0.06, 0.512);
        const td_soil_cut cut = {.rake_rad = rake,
                                 .depth_m = depth,
                                 .width_m = 1.1,
                                 .swept_m3 = (double)s.bucket_mg * MG / preset.density_kg_m3};
        double expected = NAN;
        check_ok(td_soil_force_luengo(&expected, &preset, &cut, G, &error), error);
        check_near(s.cutting_n / expected, 1, 1e-9); /* tanh(1 m/s / 0.01 m/s) is 1 */
        const double lean = rake + preset.tool_friction_rad, weight = (double)s.bucket_mg * MG * G;
        const double edge = td_soil_bearing_pa(&preset, depth, 0.03, G) * 1.1 * 0.03;
        /* Forward is -x; the edge's own thickness pushes back along the floor. */
        check_near(s.force[0], expected * sin(lean) + edge * cos(rake), 1e-6 * expected);
        check_near(s.force[2], -expected * cos(lean) - weight + edge * sin(rake), 1e-6 * expected);
        check_near(s.force[1], 0, 1e-6 * expected);
        check_less(0, s.force[0]);
        /* Torque about the origin: of the edge's forces at the edge, of the weight at the load's centre. */
        const double force[3] = {s.force[0], 0, s.force[2] + weight}, centre[3] = {0.75, 0, 0.25};
        double arm[3];
        td_pose_rotate(arm, &pose, centre);
        const double rx = x0 - 0.02 * n - pose.t[0], rz = -depth - pose.t[2];
        check_near(s.torque[1], rz * force[0] - rx * force[2] + arm[0] * weight, 1e-6 * expected);
    }
    /* Lifted: its soil's weight. */
    const td_pose up = pose_at(1.5, 0, 1, 0, UPRIGHT);
    check_ok(td_soil_place(soil, &up, &error), error);
    s = step_to(soil, &up);
    check_near(s.force[2], -(double)s.bucket_mg * MG * G, 1e-6);
    assert_true(s.cutting_n == 0 && !s.in_soil);
    td_soil_free(&soil);
    td_elevation_free(&map);
}

static void runs_at_its_own_rate(void **state)
{
    (void)state;
    td_elevation *map = flat(41, 0.05);
    td_soil *soil = soil_on(map, "dirt_1");
    td_soil_state s;
    for (int n = 1; n <= 1000; n++) {
        const td_pose pose = pose_at(0.5 - 0.0005 * n, 0, -0.1, 0, DIG);
        check_ok(td_soil_step(soil, &pose, 0.001, &error), error);
    }
    td_soil_get(&s, soil);
    assert_int_equal(s.updates, 50);
    check_near(s.time_s, 1, 1e-9);
    td_soil_free(&soil);
    td_elevation_free(&map);
}

/* ---- cycles ---- */

typedef struct cycles {
    td_elevation *map;
    td_soil *soil;
    td_random random;
    int64_t total;
} cycles;

static double between(td_random *random, double low, double high)
{
    return low + (high - low) * td_random_uniform(random);
}

static td_elevation *rough(int size, double cell)
{
    td_elevation *map = flat(size, cell);
    td_random random = td_random_seed(7, 1);
    for (int i = 0; i < size * size; i++) {
        const double x = i % size * cell, y = i / size * cell;
        map->height[i] = (float)(0.3 * sin(0.8 * x) + 0.2 * cos(0.6 * y) + 0.01 * td_random_normal(&random));
    }
    for (int i = 0; i < 12; i++) map->height[td_random_below(&random, (uint32_t)(size * size))] = NAN;
    return map;
}

static void one_cycle(cycles *k)
{
    td_random *random = &k->random;
    const double yaw = between(random, -PI, PI), x = between(random, -2.6, 2.6),
                 y = between(random, -2.6, 2.6);
    const double depth = between(random, 0.05, 0.35), way = between(random, 0.3, 1.2);
    double ground = td_soil_height_at(k->soil, x, y);
    if (isnan(ground)) return;
    const double end[2] = {x - way * cos(yaw), y - way * sin(yaw)};
    const double path[4][3] = {{x, y, ground + 0.05},
                               {x - 0.2 * cos(yaw), y - 0.2 * sin(yaw), ground - depth},
                               {end[0], end[1], ground - depth},
                               {end[0], end[1], ground + 1.2}};
    const td_pose start = pose_at(path[0][0], path[0][1], path[0][2], yaw, DIG);
    check_ok(td_soil_place(k->soil, &start, &error), error);
    drag(k->soil, path[0], path[1], yaw, DIG, DIG, 6, k->total);
    drag(k->soil, path[1], path[2], yaw, DIG, DIG + 15, 15, k->total);
    drag(k->soil, path[2], path[3], yaw, DIG + 15, UPRIGHT, 10, k->total);
    const double to[3] = {between(random, -2.6, 2.6), between(random, -2.6, 2.6), ground + 1.2};
    const td_pose there = pose_at(to[0], to[1], to[2], yaw, UPRIGHT);
    check_ok(td_soil_place(k->soil, &there, &error), error);
    drag(k->soil, to, to, yaw, UPRIGHT, OVER, 10, k->total);
}

static void begin(cycles *k)
{
    k->map = rough(101, 0.1);
    k->soil = soil_on(k->map, "dirt_1");
    k->random = td_random_seed(3, 5);
    k->total = td_soil_balance_of(k->soil).total_mg;
}

static void end(cycles *k)
{
    td_soil_free(&k->soil);
    td_elevation_free(&k->map);
}

static void random_cycles(void **state)
{
    (void)state;
#ifdef __SANITIZE_ADDRESS__
    const int count = 60;
#else
    const int count = 1000;
#endif
    char first[TD_HASH_HEX_SIZE], second[TD_HASH_HEX_SIZE];
    cycles k;
    td_soil_state s;
    begin(&k);
    for (int n = 0; n < count; n++) one_cycle(&k);
    td_soil_get(&s, k.soil);
    const int *d = s.disturbed;
    int outside = 0, changed = 0;
    for (int r = 0; r < k.map->rows; r++)
        for (int c = 0; c < k.map->columns; c++) {
            const float was = k.map->height[r * k.map->columns + c];
            const double is = td_soil_height(k.soil, c, r);
            const bool same = isnan(was) ? isnan(is) : is == (double)was;
            const bool inside = c >= d[0] && r >= d[1] && c <= d[2] && r <= d[3];
            if (!inside && !same) fail_msg("cell (%d, %d) outside the disturbed area has changed", c, r);
            outside += !inside;
            changed += !same;
        }
    assert_true(outside > 500 && changed > 1000);
    check_ok(td_soil_hash(first, k.soil, &error), error);
    print_message("%d cycles, %d updates: %lld mg stay %lld mg; %d cells changed, %d outside\n", count,
                  (int)s.updates, (long long)k.total, (long long)td_soil_balance_of(k.soil).total_mg, changed,
                  outside);
    end(&k);
    begin(&k);
    k.total = 0; /* counted the first time */
    for (int n = 0; n < count; n++) one_cycle(&k);
    check_ok(td_soil_hash(second, k.soil, &error), error);
    assert_string_equal(first, second);
    end(&k);
}

/* ---- unknown ground, refusals ---- */

typedef struct told {
    int count;
    char text[512];
} told;

static void hear(td_log_level level, const char *topic, const char *text, void *user)
{
    told *t = user;
    (void)level, (void)topic;
    t->count++;
    snprintf(t->text, sizeof t->text, "%s", text);
}

static void unknown_ground_stays(void **state)
{
    (void)state;
    td_elevation *map = flat(81, 0.05), *after = NULL;
    td_soil *soil = NULL;
    told t = {0};
    td_soil_options o = td_soil_options_default();
    const td_soil_preset preset = preset_of("sand");
    const td_soil_bucket bucket = td_soil_bucket_zx200();
    o.log = (td_log){hear, &t};
    for (int r = 30; r <= 50; r++) /* a strip across the way, x from -0.25 to 0 */
        for (int c = 35; c <= 40; c++) map->height[r * 81 + c] = NAN;
    check_ok(td_soil_new(&soil, map, &preset, &bucket, &o, &error), error);
    const int64_t total = td_soil_balance_of(soil).total_mg;
    for (int pass = 0; pass < 2; pass++) {
        const double z = -0.2 - 0.1 * pass, from[3] = {1, 0, z}, to[3] = {-1, 0, z};
        const td_pose start = pose_at(1, 0, z, 0, DIG);
        check_ok(td_soil_place(soil, &start, &error), error);
        drag(soil, from, to, 0, DIG, UPRIGHT, 80, total);
    }
    check_ok(td_soil_settle(soil, &error), error);
    td_soil_state s;
    td_soil_get(&s, soil);
    assert_int_equal(t.count, 1);
    assert_non_null(strstr(t.text, "no height"));
    assert_true(s.unknown_cells > 50);
    /* The middle of the hole: the bucket keeps what it has. */
    const int64_t load = s.bucket_mg;
    td_pose over = pose_at(-0.125, 0, 1, 0.5 * PI, OVER);
    for (int r = 0; r < 81; r++)
        for (int c = 0; c < 81; c++)
            assert_int_equal(isnan(td_soil_height(soil, c, r)), isnan(map->height[r * 81 + c]));
    td_elevation_free(&after);
    check_ok(td_soil_map(&after, soil, &error), error);
    int simulated = 0;
    for (int i = 0; i < 81 * 81; i++) {
        if (isnan(map->height[i])) assert_int_equal(after->provenance[i], TD_CELL_UNKNOWN);
        simulated += after->provenance[i] == TD_CELL_SIMULATED;
        if (after->provenance[i] == TD_CELL_SIMULATED)
            assert_true(isnan(after->sigma[i]));
        else
            assert_true(isnan(map->height[i]) || after->height[i] == map->height[i]);
    }
    assert_true(simulated > 300 && load > 0);
    check_ok(td_soil_place(soil, &over, &error), error);
    over = pose_at(40, 0, 1, 0, OVER); /* far off the map */
    check_ok(td_soil_place(soil, &over, &error), error);
    s = step_to(soil, &over);
    assert_true(s.bucket_mg == load && s.airborne_mg == 0);
    td_elevation_free(&after);
    td_soil_free(&soil);
    td_elevation_free(&map);
}

/* Cells wider than the bucket: what falls between their centres falls on the nearest. */
static void coarse_cells(void **state)
{
    (void)state;
    td_elevation *map = flat(7, 3);
    td_soil *soil = soil_on(map, "dirt_1");
    const double from[3] = {1, 0, -0.1}, to[3] = {-0.6, 0, -0.1}, aside[3] = {4.4, 4.4, 1};
    const td_pose start = pose_at(1, 0, -0.1, 0, DIG), over = pose_at(4.4, 4.4, 1, 0, UPRIGHT);
    const int64_t total = td_soil_balance_of(soil).total_mg;
    check_ok(td_soil_place(soil, &start, &error), error);
    const td_soil_state full = drag(soil, from, to, 0, DIG, DIG, 8, total);
    check_near((double)full.bucket_mg * MG, 0.8 * 1474 / 1.28, 1e-5);
    check_ok(td_soil_place(soil, &over, &error), error);
    assert_int_equal(drag(soil, aside, aside, 0, UPRIGHT, OVER - 20, 10, total).bucket_mg, 0);
    check_ok(td_soil_settle(soil, &error), error);
    check_less(0, td_soil_loose_height(soil, 4, 4));
    td_soil_free(&soil);
    td_elevation_free(&map);
}

static void walls_at_the_border(void **state)
{
    (void)state;
    td_elevation *map = flat(21, 0.05);
    td_soil *soil = soil_on(map, "sand");
    check_ok(td_soil_pour(soil, 0, 0, 100000000, &error), error);
    check_ok(td_soil_settle(soil, &error), error);
    assert_true(td_soil_balance_of(soil).loose_mg == 100000000);
    td_soil_free(&soil);
    td_elevation_free(&map);
}

static void refuses_by_name(void **state)
{
    (void)state;
    td_elevation *map = flat(21, 0.05);
    td_soil *soil = NULL;
    td_soil_preset p = preset_of("dirt_1");
    td_soil_bucket b = td_soil_bucket_zx200();
    td_soil_options o = td_soil_options_default();
    check_fails(td_soil_new(&soil, NULL, &p, &b, NULL, &error), TD_ERROR_ARGUMENT, error, "there is no map");
    td_elevation big = *map;
    big.columns = big.rows = 10000;
    check_fails(td_soil_new(&soil, &big, &p, &b, NULL, &error), TD_ERROR_ARGUMENT, error,
                "10000 x 10000 cells");
    check_fails(td_soil_new(&soil, map, NULL, &b, NULL, &error), TD_ERROR_ARGUMENT, error, "no preset");
    p.swell = 0.5;
    check_fails(td_soil_new(&soil, map, &p, &b, NULL, &error), TD_ERROR_ARGUMENT, error, "swell");
    p = preset_of("dirt_1"), p.density_kg_m3 = NAN;
    check_fails(td_soil_new(&soil, map, &p, &b, NULL, &error), TD_ERROR_ARGUMENT, error, "density_kg_m3");
    p = preset_of("dirt_1");
    b.heaped_m3 = 0.1;
    check_fails(td_soil_new(&soil, map, &p, &b, NULL, &error), TD_ERROR_ARGUMENT, error, "heaped_m3");
    b = td_soil_bucket_zx200(), b.opening[0] = 5, b.opening[2] = -0.586;
    check_fails(td_soil_new(&soil, map, &p, &b, NULL, &error), TD_ERROR_ARGUMENT, error, "opening");
    b = td_soil_bucket_zx200();
    o.period_s = 0;
    check_fails(td_soil_new(&soil, map, &p, &b, &o, &error), TD_ERROR_ARGUMENT, error, "period_s");
    assert_null(soil);
    check_ok(td_soil_new(&soil, map, &p, &b, NULL, &error), error);
    const td_pose above = pose_at(0, 0, 0.1, 0, DIG), deep = pose_at(0, 0, -1.7, 0, DIG);
    char before[TD_HASH_HEX_SIZE], after[TD_HASH_HEX_SIZE];
    check_ok(td_soil_step(soil, &above, 0.02, &error), error);
    check_ok(td_soil_hash(before, soil, &error), error);
    check_fails(td_soil_step(soil, &deep, 0.02, &error), TD_ERROR_DATA, error, "buried");
    /* Buried by what fell on it, it can come out. */
    const td_pose rising = pose_at(0, 0, -1.65, 0, DIG);
    td_soil *under = NULL;
    check_ok(td_soil_new(&under, map, &p, &b, NULL, &error), error);
    check_fails(td_soil_step(under, &deep, 0.02, &error), TD_ERROR_DATA, error, "buried");
    check_ok(td_soil_place(under, &deep, &error), error);
    check_ok(td_soil_step(under, &rising, 0.02, &error), error);
    td_soil_free(&under);
    const td_pose far = pose_at(0, 9, 0, 0, DIG);
    check_fails(td_soil_step(soil, &far, 0.02, &error), TD_ERROR_ARGUMENT, error, "leapt");
    td_pose bad = above;
    bad.t[1] = NAN;
    check_fails(td_soil_step(soil, &bad, 0.02, &error), TD_ERROR_ARGUMENT, error, "site_from_bucket");
    check_fails(td_soil_step(soil, &above, 0, &error), TD_ERROR_ARGUMENT, error, "dt_s");
    check_fails(td_soil_pour(soil, 21, 0, 5, &error), TD_ERROR_ARGUMENT, error, "not on the map");
    check_fails(td_soil_pour(soil, 1, 0, -5, &error), TD_ERROR_ARGUMENT, error, "mass_mg");
    check_ok(td_soil_hash(after, soil, &error), error);
    assert_string_equal(before, after);
    td_soil_free(&soil);
    check_ok(td_soil_new(&soil, map, &p, NULL, NULL, &error), error);
    check_fails(td_soil_place(soil, &above, &error), TD_ERROR_ARGUMENT, error, "no bucket");
    td_soil_free(&soil);
    for (int i = 0; i < 441; i++) map->height[i] = NAN;
    check_fails(td_soil_new(&soil, map, &p, &b, NULL, &error), TD_ERROR_DATA, error, "one hole");
    td_elevation_free(&map);
}

static void parse_fails(const char *figure, const char *other, const char *words)
{
    char text[4096];
    td_soil_preset p;
    const char *names[] = {"density_kg_m3", "swell",         "cohesion_pa", "adhesion_pa",
                           "friction_deg",  "tool_friction", "repose_deg"};
    const char *values[] = {"1500", "1.2", "1000", "0", "30", "0.3", "33"};
    int n = snprintf(text, sizeof text, "teledimos: soil 1\nname: test\nfigures:\n");
    for (int i = 0; i < 7; i++) {
        const bool that = strcmp(names[i], figure) == 0;
        if (that && !*other) continue;
        n += snprintf(text + n, sizeof text - (size_t)n,
                      that ? "  %s: {%s}\n" : "  %s: {value: %s, source: here}\n", names[i],
                      that ? other : values[i]);
    }
    check_fails(td_soil_preset_parse(&p, text, (size_t)n, "soil.yaml", &error), error.status, error, words);
    assert_true(error.status != TD_OK);
}

static void presets(void **state)
{
    (void)state;
    const td_soil_preset dirt = preset_of("dirt_1"), clay = preset_of("clay");
    preset_of("loam");
    preset_of("sand");
    assert_string_equal(dirt.name, "dirt_1");
    check_near(dirt.density_kg_m3, 1474, 0);
    check_near(tan(dirt.tool_friction_rad), 0.417, 1e-15);
    check_near(clay.friction_rad, 12 * PI / 180, 1e-15);
    parse_fails("swell", "", "soil.yaml: figures.swell: is missing");
    parse_fails("swell", "value: 0.9, source: here", "figures.swell.value");
    parse_fails("swell", "value: .nan, source: here", "figures.swell.value");
    parse_fails("swell", "value: 1.1", "figures.swell.source");
    parse_fails("swell", "value: 1.1, source: ''", "say where");
    parse_fails("swell", "value: 1.5, source: here, range: [1.1, 1.3]", "outside its own range");
    parse_fails("density_kg_m3", "value: -3, source: here", "figures.density_kg_m3.value");
    parse_fails("tool_friction", "value: 0.9, source: here", "above the soil's own");
    parse_fails("adhesion_pa", "value: 2000, source: here", "above cohesion_pa");
    parse_fails("friction_deg", "value: 0, source: here", "figures.friction_deg.value");
}

int main(void)
{
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(presets),
        cmocka_unit_test(cuts_what_it_sweeps),
        cmocka_unit_test(spills_ahead),
        cmocka_unit_test(pushing_back_compacts),
        cmocka_unit_test(holds_by_its_tilt),
        cmocka_unit_test(bank_of_sand_falls),
        cmocka_unit_test(force_is_the_wedges),
        cmocka_unit_test(runs_at_its_own_rate),
        cmocka_unit_test(unknown_ground_stays),
        cmocka_unit_test(coarse_cells),
        cmocka_unit_test(walls_at_the_border),
        cmocka_unit_test(refuses_by_name),
        cmocka_unit_test(heaps_rest_at_repose),
        cmocka_unit_test(random_cycles),
    };
    return cmocka_run_group_tests(tests, NULL, NULL);
}
