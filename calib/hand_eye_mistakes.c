#include "calib/hand_eye_mistakes.h"

#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "core/linalg.h"

/* On correct data with noise a hypothesis never leaves as little as half of the residual; a mistake that is
 * put right leaves a tenth and less. */
static const double far_better = 3;
/* What is left must be a small part of the motion itself. */
static const double small_part = 0.2;

enum { FEWEST_VIEWS = 5, MOST_PAIRS = 1000, REWEIGHTINGS = 5, SUSPECTS = 8, MOST_SHIFTS = 100 };

/* As in hand_eye_solvers: A_i X B_i = Z in every setup. */
typedef struct poses {
    size_t count;
    td_pose *a, *b;
} poses;

/* A motion between two views: A X = X B, as rotation vectors and translations. */
typedef struct pair {
    size_t i, j;
    double ra[9], wa[3], ta[3], wb[3], tb[3];
    double weight, residual;
} pair;

typedef struct judge {
    size_t count; /* views said */
    poses said, tried;
    pair *pair;
    double *sorted;                 /* (pairs) room */
    double *said_view, *tried_view; /* (views) residual of each view, m */
    double lever_m;                 /* the target's usual distance: of radians in metres */
    double motion_m;                /* how far the usual motion goes */
    td_hand_eye_setup setup;
    const td_hand_eye_view *view;
    td_hand_eye_mistake found[TD_MAX_MISTAKES + 1];
    double left_m[TD_MAX_MISTAKES + 1];
    size_t found_count;
} judge;

/* ---- the residual ---- */

static int compare_doubles(const void *a, const void *b)
{
    double x = *(const double *)a, y = *(const double *)b;
    return (x > y) - (x < y);
}

static double median(double *x, size_t n)
{
    if (!n) return NAN;
    qsort(x, n, sizeof *x, compare_doubles);
    return x[n / 2];
}

/* Views `step` and more apart are paired so that there are not too many pairs; neighbours always. */
static size_t gather_pairs(judge *g, const poses *p)
{
    size_t n = 0, all = p->count * (p->count - 1) / 2, step = 1 + all / MOST_PAIRS;
    for (size_t i = 0; i < p->count; i++)
        for (size_t j = i + 1; j < p->count; j += step) {
            td_pose inverse = td_pose_inverse(&p->a[j]), a = td_pose_compose(&inverse, &p->a[i]);
            inverse = td_pose_inverse(&p->b[i]);
            td_pose b = td_pose_compose(&p->b[j], &inverse);
            pair *q = &g->pair[n++];
            *q = (pair){.i = i, .j = j, .weight = 1};
            td_pose_rotation(q->ra, &a);
            td_rotation_log(q->wa, a.q);
            td_rotation_log(q->wb, b.q);
            memcpy(q->ta, a.t, sizeof a.t);
            memcpy(q->tb, b.t, sizeof b.t);
        }
    return n;
}

/* R that turns the w_b into the w_a: Kabsch's solution of Park and Martin's problem. */
static bool fit_rotation(double r[9], const pair *p, size_t n)
{
    double m[9] = {0};
    for (size_t k = 0; k < n; k++)
        for (int e = 0; e < 9; e++) m[e] += p[k].weight * p[k].wa[e / 3] * p[k].wb[e % 3];
    return td_nearest_rotation(r, m, NULL) == TD_OK;
}

static void rotate(double out[3], const double r[9], const double v[3])
{
    for (int e = 0; e < 3; e++) out[e] = r[3 * e] * v[0] + r[3 * e + 1] * v[1] + r[3 * e + 2] * v[2];
}

/* t that solves (R_A - I) t = R t_b - t_a; along what the motion leaves open it is held near zero. */
static bool fit_translation(double t[3], const double r[9], const pair *p, size_t n)
{
    double h[9] = {0}, g[3] = {0};
    for (size_t k = 0; k < n; k++) {
        double m[9], rb[3], y[3];
        rotate(rb, r, p[k].tb);
        for (int e = 0; e < 9; e++) m[e] = p[k].ra[e] - (e % 4 == 0);
        for (int e = 0; e < 3; e++) y[e] = rb[e] - p[k].ta[e];
        for (int e = 0; e < 3; e++) {
            for (int f = 0; f < 3; f++)
                h[3 * e + f] += p[k].weight * (m[e] * m[f] + m[3 + e] * m[3 + f] + m[6 + e] * m[6 + f]);
            g[e] += p[k].weight * (m[e] * y[0] + m[3 + e] * y[1] + m[6 + e] * y[2]);
        }
    }
    double hold = 1e-9 * (h[0] + h[4] + h[8]) + 1e-30;
    for (int e = 0; e < 9; e += 4) h[e] += hold;
    if (td_invert_spd(h, h, 3, NULL) != TD_OK) return false;
    rotate(t, h, g);
    return true;
}

static void measure(pair *p, const double r[9], const double t[3], double lever_m)
{
    double turned[3], rb[3], rt[3], sum = 0;
    rotate(turned, r, p->wb);
    rotate(rb, r, p->tb);
    rotate(rt, p->ra, t);
    for (int e = 0; e < 3; e++) {
        double w = lever_m * (p->wa[e] - turned[e]), d = rt[e] - t[e] + p->ta[e] - rb[e];
        sum += w * w + d * d;
    }
    p->residual = sqrt(sum);
}

/* Residual of each view (m): the median over its pairs, so that a bad view is bad and leaves the others
 * good. False when nothing can be fitted. */
static bool judge_views(double *of_view, judge *g, const poses *p)
{
    size_t n = gather_pairs(g, p);
    double r[9], t[3];
    for (int round = 0; round < REWEIGHTINGS; round++) {
        if (!fit_rotation(r, g->pair, n) || !fit_translation(t, r, g->pair, n)) return false;
        for (size_t k = 0; k < n; k++) {
            measure(&g->pair[k], r, t, g->lever_m);
            g->sorted[k] = g->pair[k].residual;
        }
        double usual = 1.5 * median(g->sorted, n) + 1e-300;
        for (size_t k = 0; k < n; k++) g->pair[k].weight = 1 / (1 + pow(g->pair[k].residual / usual, 2));
    }
    for (size_t i = 0; i < p->count; i++) {
        size_t m = 0;
        for (size_t k = 0; k < n; k++)
            if (g->pair[k].i == i || g->pair[k].j == i) g->sorted[m++] = g->pair[k].residual;
        of_view[i] = median(g->sorted, m);
        if (!isfinite(of_view[i])) return false;
    }
    return true;
}

static double median_of(judge *g, const double *value, size_t from, size_t to)
{
    memcpy(g->sorted, value + from, (to - from) * sizeof *value);
    return median(g->sorted, to - from);
}

/* ---- what is found ---- */

/* Keeps a hypothesis that leaves `after` of `before`, if that is far better, in the order of what is left. */
static void consider(judge *g, double before, double after, const char *what)
{
    double better = before / (after + 1e-6 * g->motion_m);
    if (!(better >= far_better) || !(after <= small_part * g->motion_m)) return;
    size_t at = g->found_count < TD_MAX_MISTAKES ? g->found_count : TD_MAX_MISTAKES;
    while (at > 0 && g->left_m[at - 1] > after) {
        g->found[at] = g->found[at - 1];
        g->left_m[at] = g->left_m[at - 1];
        at--;
    }
    g->found[at].better = better;
    g->left_m[at] = after;
    snprintf(g->found[at].text, sizeof g->found[at].text,
             "%s: read so, the motions of robot and camera differ by %.3g mm instead of %.3g mm", what,
             1e3 * after, 1e3 * before);
    if (g->found_count < TD_MAX_MISTAKES) g->found_count++;
}

static void copy_said(judge *g)
{
    g->tried.count = g->count;
    memcpy(g->tried.a, g->said.a, g->count * sizeof *g->said.a);
    memcpy(g->tried.b, g->said.b, g->count * sizeof *g->said.b);
}

/* Judges g->tried, which concerns all views. */
static void try_all(judge *g, const char *what)
{
    if (!judge_views(g->tried_view, g, &g->tried)) return;
    consider(g, median_of(g, g->said_view, 0, g->count), median_of(g, g->tried_view, 0, g->tried.count),
             what);
}

/* ---- conventions ---- */

/* In the robot's own sense, whatever the setup makes of it. */
static td_pose as_said(const judge *g, const td_pose *a)
{
    return g->setup == TD_EYE_TO_HAND ? td_pose_inverse(a) : *a;
}

/* A^-1 X B = Z reads A Z B^-1 = X: robot poses inverted, target poses inverted and the other setup are one
 * and the same to the motions. */
static void try_inverted(judge *g)
{
    copy_said(g);
    for (size_t i = 0; i < g->count; i++) g->tried.a[i] = td_pose_inverse(&g->said.a[i]);
    try_all(g,
            g->setup == TD_EYE_TO_HAND
                ? "the robot's poses look inverted (hand_from_base), or the target's are (target_from_rig), "
                  "or the camera is in the hand"
                : "the robot's poses look inverted (hand_from_base), or the target's are (target_from_rig), "
                  "or the camera stands beside the robot (eye-to-hand)");
}

static void try_lengths(judge *g, double factor, const char *what)
{
    copy_said(g);
    for (size_t i = 0; i < g->count; i++)
        for (int k = 0; k < 3; k++) g->tried.a[i].t[k] *= factor;
    try_all(g, what);
}

static void try_quaternions(judge *g, int first, const char *what)
{
    copy_said(g);
    for (size_t i = 0; i < g->count; i++) {
        td_pose p = as_said(g, &g->said.a[i]), read = p;
        for (int k = 0; k < 4; k++) read.q[k] = p.q[(k + first) % 4];
        g->tried.a[i] = as_said(g, &read);
    }
    try_all(g, what);
}

static void set_turn(judge *g, size_t i, const double w[3])
{
    td_pose p = as_said(g, &g->said.a[i]);
    td_rotation_exp(p.q, w);
    g->tried.a[i] = as_said(g, &p);
}

static const double degrees = 57.29577951308232, pi = 3.14159265358979324;

/* Radians that were taken for degrees: the turns are all small. */
static void try_radians(judge *g)
{
    copy_said(g);
    for (size_t i = 0; i < g->count; i++) {
        double w[3];
        td_pose p = as_said(g, &g->said.a[i]);
        td_rotation_log(w, p.q);
        for (int k = 0; k < 3; k++) w[k] *= degrees;
        if (w[0] * w[0] + w[1] * w[1] + w[2] * w[2] > 4 * pi * pi) return;
        set_turn(g, i, w);
    }
    try_all(g, "the robot's rotation vectors look like radians taken for degrees");
}

/* Degrees that were taken for radians were wound round and round: of the axis the turn is known only up to
 * whole turns of 2 pi, so the angle up to multiples of 2 pi / 57.3. Each view has `WINDINGS` readings. */
enum { WINDINGS = 59 };

static bool reading(double w[3], const double wound[3], int winding)
{
    double angle = sqrt(wound[0] * wound[0] + wound[1] * wound[1] + wound[2] * wound[2]);
    double turn = (angle + 2 * pi * (winding - WINDINGS / 2)) / degrees;
    for (int k = 0; k < 3; k++) w[k] = angle > 0 ? wound[k] / angle * turn : 0;
    return fabs(turn) <= pi + 1e-9;
}

typedef struct winding_search {
    double (*wound)[3]; /* (views) as said */
    size_t view[3];
    double angle[3]; /* of the camera between views 0-1, 0-2, 1-2 */
} winding_search;

static double angle_between(const td_pose *p, const td_pose *q)
{
    td_pose inverse = td_pose_inverse(p), d = td_pose_compose(&inverse, q);
    return td_pose_angle(&d);
}

static td_pose turn_of(const double w[3])
{
    td_pose p = {{1, 0, 0, 0}, {0, 0, 0}};
    td_rotation_exp(p.q, w);
    return p;
}

/* Three views whose motions differ most. */
static void choose_views(winding_search *s, const judge *g)
{
    double best = -1, w[3], v[3], across = -1;
    td_pose back = td_pose_inverse(&g->said.b[0]);
    s->view[0] = 0;
    s->view[1] = 1;
    s->view[2] = 2;
    for (size_t i = 1; i < g->count; i++) {
        td_pose d = td_pose_compose(&g->said.b[i], &back);
        if (td_pose_angle(&d) <= best) continue;
        best = td_pose_angle(&d);
        s->view[1] = i;
        td_rotation_log(w, d.q);
    }
    for (size_t i = 1; i < g->count; i++) {
        td_pose d = td_pose_compose(&g->said.b[i], &back);
        td_rotation_log(v, d.q);
        double area =
            hypot(hypot(w[1] * v[2] - w[2] * v[1], w[2] * v[0] - w[0] * v[2]), w[0] * v[1] - w[1] * v[0]);
        if (i == s->view[1] || area <= across) continue;
        across = area;
        s->view[2] = i;
    }
    static const int first[3] = {0, 0, 1}, second[3] = {1, 2, 2};
    for (int k = 0; k < 3; k++) {
        /* Camera in the target's frame and in its own turn by the same angle. */
        s->angle[k] = angle_between(&g->said.b[s->view[first[k]]], &g->said.b[s->view[second[k]]]);
    }
}

/* With three readings chosen, R_X follows, then R_Z, and of every other view the reading that fits best. */
static double unwind_all(judge *g, const winding_search *s, const double chosen[3][3])
{
    pair p[3];
    double r[9], sum = 0;
    td_pose a[3];
    for (int k = 0; k < 3; k++) {
        a[k] = turn_of(chosen[k]);
        if (g->setup == TD_EYE_TO_HAND) a[k] = td_pose_inverse(&a[k]);
    }
    for (int k = 0; k < 3; k++) {
        int i = k == 2 ? 1 : 0, j = k == 0 ? 1 : 2;
        td_pose back = td_pose_inverse(&a[j]), d = td_pose_compose(&back, &a[i]);
        td_rotation_log(p[k].wa, d.q);
        back = td_pose_inverse(&g->said.b[s->view[i]]);
        d = td_pose_compose(&g->said.b[s->view[j]], &back);
        td_rotation_log(p[k].wb, d.q);
        p[k].weight = 1;
    }
    if (!fit_rotation(r, p, 3)) return INFINITY;
    td_pose x = td_pose_from_rotation(r, (const double[3]){0}), z = td_pose_compose(&a[0], &x);
    z = td_pose_compose(&z, &g->said.b[s->view[0]]);
    for (size_t i = 0; i < g->count; i++) {
        td_pose xb = td_pose_compose(&x, &g->said.b[i]), back = td_pose_inverse(&xb);
        td_pose wanted = td_pose_compose(&z, &back);
        if (g->setup == TD_EYE_TO_HAND) wanted = td_pose_inverse(&wanted);
        double best = INFINITY, w[3];
        for (int c = 0; c < WINDINGS; c++) {
            if (!reading(w, s->wound[i], c)) continue;
            td_pose turn = turn_of(w);
            double off = angle_between(&turn, &wanted);
            if (off >= best) continue;
            best = off;
            set_turn(g, i, w);
        }
        sum += fmin(best, 0.3);
    }
    return sum;
}

static void unwind(judge *g, winding_search *s)
{
    const double near = 0.04; /* rad */
    double least = INFINITY, w[3][3], best[3][3] = {{0}};
    for (int c0 = 0; c0 < WINDINGS; c0++) {
        if (!reading(w[0], s->wound[s->view[0]], c0)) continue;
        td_pose p0 = turn_of(w[0]);
        for (int c1 = 0; c1 < WINDINGS; c1++) {
            if (!reading(w[1], s->wound[s->view[1]], c1)) continue;
            td_pose p1 = turn_of(w[1]);
            if (fabs(angle_between(&p0, &p1) - s->angle[0]) > near) continue;
            for (int c2 = 0; c2 < WINDINGS; c2++) {
                if (!reading(w[2], s->wound[s->view[2]], c2)) continue;
                td_pose p2 = turn_of(w[2]);
                if (fabs(angle_between(&p0, &p2) - s->angle[1]) > near ||
                    fabs(angle_between(&p1, &p2) - s->angle[2]) > near)
                    continue;
                double off = unwind_all(g, s, (const double(*)[3])w);
                if (off >= least) continue;
                least = off;
                memcpy(best, w, sizeof best);
            }
        }
    }
    if (!isfinite(least)) return;
    unwind_all(g, s, (const double(*)[3])best);
    try_all(g, "the robot's rotation vectors look like degrees taken for radians");
}

static void try_degrees(judge *g)
{
    winding_search s = {.wound = malloc(g->count * sizeof *s.wound)};
    if (!s.wound) return;
    copy_said(g);
    for (size_t i = 0; i < g->count; i++) {
        td_pose p = as_said(g, &g->said.a[i]);
        td_rotation_log(s.wound[i], p.q);
    }
    choose_views(&s, g);
    unwind(g, &s);
    free(s.wound);
}

static void try_mirrored(judge *g)
{
    /* Mirroring base and hand in any plane is, up to rotations that X and Z take up, mirroring in the origin:
     * rotations stay, translations change their sign. */
    try_lengths(g, -1, "the robot's frames look mirrored (left-handed)");
}

/* ---- the order of the views ---- */

static void try_reversed(judge *g)
{
    copy_said(g);
    for (size_t i = 0; i < g->count; i++) g->tried.a[i] = g->said.a[g->count - 1 - i];
    try_all(g, "the robot's poses look as if they were listed in reverse order");
}

/* Two lists of which one has an entry too many at `from`: the rest of it moves up by one. */
static void drop_one(judge *g, bool of_robot, size_t from)
{
    copy_said(g);
    td_pose *list = of_robot ? g->tried.a : g->tried.b;
    memmove(list + from, list + from + 1, (g->count - 1 - from) * sizeof *list);
    g->tried.count = g->count - 1;
}

static void try_shifted(judge *g)
{
    size_t step = 1 + g->count / MOST_SHIFTS;
    for (int of_robot = 0; of_robot < 2; of_robot++) {
        double least = INFINITY, before = 0, after = 0;
        size_t where = 0;
        for (size_t from = 0; from + 4 <= g->count; from += step) {
            drop_one(g, of_robot, from);
            if (!judge_views(g->tried_view, g, &g->tried)) continue;
            double sum = 0;
            for (size_t i = 0; i < g->tried.count; i++) sum += g->tried_view[i];
            if (sum >= least) continue;
            least = sum;
            where = from;
            after = median_of(g, g->tried_view, from, g->tried.count);
            before = median_of(g, g->said_view, from, g->count);
        }
        char text[200];
        snprintf(text, sizeof text, "from view %s on the %s looks shifted by one: %s", g->view[where].name,
                 of_robot ? "list of robot poses" : "list of images",
                 of_robot ? "it has a pose too many there, or an image is missing"
                          : "it has an image too many there, or a robot pose is missing");
        if (isfinite(least)) consider(g, before, after, text);
    }
}

/* The views that fit worst, worst first. */
static size_t find_suspects(size_t suspect[SUSPECTS], const judge *g)
{
    size_t n = 0;
    for (size_t i = 0; i < g->count; i++) {
        size_t at = n < SUSPECTS ? n++ : SUSPECTS - 1;
        if (at == SUSPECTS - 1 && n == SUSPECTS && i >= SUSPECTS &&
            g->said_view[suspect[at]] >= g->said_view[i])
            continue;
        while (at > 0 && g->said_view[suspect[at - 1]] < g->said_view[i]) {
            suspect[at] = suspect[at - 1];
            at--;
        }
        suspect[at] = i;
    }
    return n;
}

static void try_exchanged(judge *g)
{
    size_t suspect[SUSPECTS], n = find_suspects(suspect, g);
    double least = INFINITY, before = 0;
    size_t best[2] = {0, 0};
    for (size_t p = 0; p < n; p++)
        for (size_t q = p + 1; q < n; q++) {
            size_t i = suspect[p], j = suspect[q];
            copy_said(g);
            g->tried.a[i] = g->said.a[j];
            g->tried.a[j] = g->said.a[i];
            if (!judge_views(g->tried_view, g, &g->tried)) continue;
            double after = fmax(g->tried_view[i], g->tried_view[j]);
            if (after >= least) continue;
            least = after;
            before = fmin(g->said_view[i], g->said_view[j]);
            best[0] = i < j ? i : j;
            best[1] = i < j ? j : i;
        }
    char text[200];
    snprintf(text, sizeof text, "the robot's poses of views %s and %s look exchanged", g->view[best[0]].name,
             g->view[best[1]].name);
    if (isfinite(least)) consider(g, before, least, text);
}

/* ---- all ---- */

static void judge_free(judge *g)
{
    free(g->said.a);
    free(g->said.b);
    free(g->tried.a);
    free(g->tried.b);
    free(g->pair);
    free(g->sorted);
    free(g->said_view);
    free(g->tried_view);
}

static bool judge_init(judge *g, td_hand_eye_setup setup, const td_hand_eye_view *view, size_t count)
{
    size_t all = count * (count - 1) / 2,
           pairs = all < 3 * MOST_PAIRS ? all : all / (1 + all / MOST_PAIRS) + count;
    size_t room = pairs > count ? pairs : count;
    *g = (judge){.count = count,
                 .setup = setup,
                 .view = view,
                 .said = {count, malloc(count * sizeof(td_pose)), malloc(count * sizeof(td_pose))},
                 .tried = {count, malloc(count * sizeof(td_pose)), malloc(count * sizeof(td_pose))},
                 .pair = malloc(room * sizeof *g->pair),
                 .sorted = malloc(room * sizeof *g->sorted),
                 .said_view = malloc(count * sizeof *g->said_view),
                 .tried_view = malloc(count * sizeof *g->tried_view)};
    if (!g->said.a || !g->said.b || !g->tried.a || !g->tried.b || !g->pair || !g->sorted || !g->said_view ||
        !g->tried_view)
        return false;
    for (size_t i = 0; i < count; i++) {
        g->said.a[i] = as_said(g, &view[i].base_from_hand);
        g->said.b[i] = view[i].rig_from_target;
        g->lever_m += pow(td_pose_distance(&g->said.b[i]), 2) / (double)count;
    }
    g->lever_m = sqrt(g->lever_m);
    if (!judge_views(g->said_view, g, &g->said)) return false;
    size_t n = gather_pairs(g, &g->said);
    for (size_t k = 0; k < n; k++) {
        const double *w = g->pair[k].wb, *t = g->pair[k].tb;
        g->sorted[k] = sqrt(pow(g->lever_m, 2) * (w[0] * w[0] + w[1] * w[1] + w[2] * w[2]) + t[0] * t[0] +
                            t[1] * t[1] + t[2] * t[2]);
    }
    g->motion_m = median(g->sorted, n);
    return isfinite(g->motion_m) && g->motion_m > 0;
}

size_t td_hand_eye_mistakes(td_hand_eye_mistake mistake[TD_MAX_MISTAKES], td_hand_eye_setup setup,
                            const td_hand_eye_view *view, size_t count)
{
    judge g;
    size_t named = 0;
    if (count < FEWEST_VIEWS || setup >= TD_HAND_EYE_SETUP_COUNT) return 0;
    if (judge_init(&g, setup, view, count)) {
        try_inverted(&g);
        try_lengths(&g, 1e-3, "the robot's lengths look like millimetres taken for metres");
        try_lengths(&g, 1e3,
                    "the target's size looks like millimetres taken for metres, or the robot's lengths like "
                    "metres taken for millimetres");
        try_quaternions(&g, 1, "the robot's quaternions look like w x y z read as x y z w");
        try_quaternions(&g, 3, "the robot's quaternions look like x y z w read as w x y z");
        /* The second has so many readings of each view that it explains the first's mistake too, by halves.
         */
        size_t before = g.found_count;
        try_radians(&g);
        if (g.found_count == before) try_degrees(&g);
        try_mirrored(&g);
        try_reversed(&g);
        try_shifted(&g);
        try_exchanged(&g);
        while (named < g.found_count && g.left_m[named] <= 2 * g.left_m[0] + 1e-6 * g.motion_m) {
            mistake[named] = g.found[named];
            named++;
        }
    }
    judge_free(&g);
    return named;
}
