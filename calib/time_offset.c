/* The time offset of two streams of poses of one body. */
#include <math.h>
#include <stdlib.h>
#include <string.h>

#include "calib/hand_eye_mistakes.h"
#include "core/linalg.h"
#include "core/robot_poses.h"

enum { FEWEST_POSES = 20, MOST_SAMPLES = 8192, MOST_BLOCKS = 120, ROUNDS = 30, UNKNOWNS = 4 };

static const double WINDOW_S = 0.25; /* rotations are taken over this, or over four poses */
static const double LEAST_LIKENESS = 0.5, LARGEST_PART = 0.5;

typedef struct stream {
    const double *time;
    const td_pose *pose;
    size_t count;
    double step_s, gap_s; /* between neighbours: usual, and from where on a gap */
} stream;

static int compare_doubles(const void *a, const void *b)
{
    double x = *(const double *)a, y = *(const double *)b;
    return (x > y) - (x < y);
}

static td_status stream_init(stream *s, const char *which, const double *time, const td_pose *pose,
                             size_t count, td_error *error)
{
    if (count < FEWEST_POSES)
        return td_fail(error, TD_ERROR_DATA,
                       "time offset: %zu poses in the %s stream; at least %d are needed", count, which,
                       FEWEST_POSES);
    double *step = malloc(count * sizeof *step);
    if (!step) return td_fail(error, TD_ERROR_MEMORY, "time offset: no memory for %zu poses", count);
    bool ascends = isfinite(time[0]);
    for (size_t i = 1; i < count; i++) {
        step[i - 1] = time[i] - time[i - 1];
        ascends = ascends && step[i - 1] > 0 && isfinite(time[i]);
    }
    qsort(step, count - 1, sizeof *step, compare_doubles);
    *s = (stream){.time = time, .pose = pose, .count = count, .step_s = step[(count - 1) / 2]};
    s->gap_s = 5 * s->step_s;
    free(step);
    if (!ascends)
        return td_fail(error, TD_ERROR_DATA, "time offset: the times of the %s stream do not ascend", which);
    return TD_OK;
}

/* The pose at a time; false outside and in gaps. */
static bool stream_at(td_pose *pose, const stream *s, double time)
{
    size_t low = 0, high = s->count;
    if (!(time >= s->time[0] && time <= s->time[high - 1])) return false;
    while (high - low > 1) {
        size_t middle = low + (high - low) / 2;
        if (s->time[middle] <= time)
            low = middle;
        else
            high = middle;
    }
    *pose = s->pose[low];
    if (s->time[low] == time) return true;
    double gap = s->time[low + 1] - s->time[low];
    if (gap > s->gap_s) return false;
    *pose = td_pose_between(&s->pose[low], &s->pose[low + 1], (time - s->time[low]) / gap);
    return true;
}

/* Rotation vector from one pose to another, in the body. */
static void turn_between(double w[3], const td_pose *from, const td_pose *to)
{
    td_pose back = td_pose_inverse(from), d = td_pose_compose(&back, to);
    td_rotation_log(w, d.q);
}

/* ---- cross-correlation of the angular speeds ---- */

/* Speeds on a common grid of `step_s` from each stream's first time on; NaN where there is none. */
static double *speeds(size_t *count, const stream *s, double step_s, double window_s)
{
    *count = (size_t)((s->time[s->count - 1] - s->time[0]) / step_s) + 1;
    double *speed = malloc(*count * sizeof *speed);
    for (size_t i = 0; speed && i < *count; i++) {
        td_pose p, q;
        double w[3], at = s->time[0] + (double)i * step_s;
        speed[i] = NAN;
        if (!stream_at(&p, s, at - window_s / 2) || !stream_at(&q, s, at + window_s / 2)) continue;
        turn_between(w, &p, &q);
        speed[i] = hypot(hypot(w[0], w[1]), w[2]) / window_s;
    }
    return speed;
}

/* Ranks in (0, 1] instead of speeds: poses that flipped are then no more than fast. */
static void rank(double *speed, size_t n, double *room)
{
    size_t known = 0;
    for (size_t i = 0; i < n; i++)
        if (!isnan(speed[i])) room[known++] = speed[i];
    qsort(room, known, sizeof *room, compare_doubles);
    for (size_t i = 0; i < n; i++) {
        size_t low = 0, high = known;
        while (!isnan(speed[i]) && high - low > 1) {
            size_t middle = low + (high - low) / 2;
            if (room[middle] <= speed[i])
                low = middle;
            else
                high = middle;
        }
        if (!isnan(speed[i])) speed[i] = (double)(low + 1) / (double)known;
    }
}

/* Pearson's coefficient of a[i + lag] and b[i] where both are; NaN where they share less than a quarter of
 * the shorter. */
static double likeness(const double *a, size_t na, const double *b, size_t nb, long lag)
{
    double n = 0, sa = 0, sb = 0, saa = 0, sbb = 0, sab = 0;
    size_t first = lag < 0 ? (size_t)-lag : 0;
    for (size_t i = first; i < nb && (size_t)((long)i + lag) < na; i++) {
        double x = a[(long)i + lag], y = b[i];
        if (isnan(x) || isnan(y)) continue;
        n++, sa += x, sb += y, saa += x * x, sbb += y * y, sab += x * y;
    }
    if (n < 8 || n < 0.25 * (double)(na < nb ? na : nb)) return NAN;
    double va = saa - sa * sa / n, vb = sbb - sb * sb / n;
    return va > 1e-12 * saa && vb > 1e-12 * sbb ? (sab - sa * sb / n) / sqrt(va * vb) : NAN;
}

static td_status find_lag(double *offset_s, const stream *a, const stream *b, double window_s,
                          td_error *error)
{
    double longest = fmax(a->time[a->count - 1] - a->time[0], b->time[b->count - 1] - b->time[0]);
    double step_s = fmax(fmax(a->step_s, b->step_s) / 2, longest / MOST_SAMPLES);
    size_t na, nb;
    double *sa = speeds(&na, a, step_s, window_s), *sb = speeds(&nb, b, step_s, window_s);
    double *like = malloc((na + nb) * sizeof *like), best = -INFINITY, rival = -INFINITY;
    if (!sa || !sb || !like) {
        free(sa), free(sb), free(like);
        return td_fail(error, TD_ERROR_MEMORY, "time offset: no memory");
    }
    rank(sa, na, like);
    rank(sb, nb, like);
    long at = 0, apart = (long)ceil(2 * window_s / step_s) + 1;
    for (long lag = -(long)nb + 1; lag < (long)na; lag++) {
        double c = like[lag + (long)nb - 1] = likeness(sa, na, sb, nb, lag);
        if (c > best) best = c, at = lag;
    }
    for (long lag = -(long)nb + 2; lag + 1 < (long)na; lag++) {
        const double *c = like + lag + (long)nb - 1;
        if (labs(lag - at) > apart && c[0] >= c[-1] && c[0] >= c[1]) rival = fmax(rival, c[0]);
    }
    free(sa), free(sb), free(like);
    *offset_s = a->time[0] - b->time[0] + (double)at * step_s;
    if (!(best >= LEAST_LIKENESS))
        return td_fail(
            error, TD_ERROR_DATA,
            "time offset: the angular speeds of both streams are alike to %.2f at best (1: the same); are "
            "they of one body, and does it turn?",
            isfinite(best) ? best : 0);
    if (rival > 0.98 * best)
        return td_fail(
            error, TD_ERROR_DATA,
            "time offset: the motion repeats itself, so that two offsets explain it alike (%.3f and "
            "%.3f); move the body irregularly",
            best, rival);
    return TD_OK;
}

/* ---- least squares ---- */

/* Rotations of the second stream between poses about a window apart, and what the first has in between. */
typedef struct turns {
    size_t count;
    size_t *from, *to; /* (count) poses of b */
    double *b;         /* (count,3) rotation vectors in b's body */
    double *residual;  /* (count,3) */
    double *slope;     /* (count,3,4) by the offset and by a turn of R */
    double *weight;    /* (count); 0: the first stream has nothing there */
    double *sorted;    /* (count) room */
} turns;

static void turns_free(turns *t)
{
    free(t->from);
    free(t->to);
    free(t->b);
    free(t->residual);
    free(t->slope);
    free(t->weight);
    free(t->sorted);
}

static td_status turns_gather(turns *t, const stream *b, double window_s, td_error *error)
{
    size_t n = b->count;
    *t = (turns){.from = malloc(n * sizeof *t->from),
                 .to = malloc(n * sizeof *t->to),
                 .b = malloc(3 * n * sizeof *t->b),
                 .residual = malloc(3 * n * sizeof *t->residual),
                 .slope = malloc(12 * n * sizeof *t->slope),
                 .weight = malloc(n * sizeof *t->weight),
                 .sorted = malloc(n * sizeof *t->sorted)};
    if (!t->from || !t->to || !t->b || !t->residual || !t->slope || !t->weight || !t->sorted) {
        turns_free(t);
        return td_fail(error, TD_ERROR_MEMORY, "time offset: no memory");
    }
    for (size_t i = 0, j = 0; i < n; i++) {
        while (j < n && b->time[j] - b->time[i] < window_s) j++;
        if (j == n) break;
        if (b->time[j] - b->time[i] > window_s + b->gap_s) continue;
        t->from[t->count] = i;
        t->to[t->count] = j;
        turn_between(t->b + 3 * t->count, &b->pose[i], &b->pose[j]);
        t->count++;
    }
    return TD_OK;
}

static bool turn_of_first(double w[3], const stream *a, const stream *b, const turns *t, size_t k,
                          double offset_s)
{
    td_pose p, q;
    if (!stream_at(&p, a, b->time[t->from[k]] + offset_s) || !stream_at(&q, a, b->time[t->to[k]] + offset_s))
        return false;
    turn_between(w, &p, &q);
    return true;
}

/* R that turns the second's rotation vectors into the first's. */
static bool fit_rotation(double r[9], const stream *a, const stream *b, const turns *t, double offset_s)
{
    double m[9] = {0};
    for (size_t k = 0; k < t->count; k++) {
        double w[3];
        if (!turn_of_first(w, a, b, t, k, offset_s)) continue;
        for (int e = 0; e < 9; e++) m[e] += w[e / 3] * t->b[3 * k + e % 3];
    }
    return td_nearest_rotation(r, m, NULL) == TD_OK;
}

/* Residuals w_a(offset) - R w_b and their slopes; the slope by time from differences half a pose apart.
 * Returns the robust scale of a residual's length (median), NaN without any. */
static double linearise(turns *t, const stream *a, const stream *b, double offset_s, const double r[9])
{
    size_t n = 0;
    double h = fmax(a->step_s, 1e-4) / 2;
    for (size_t k = 0; k < t->count; k++) {
        double w[3], before[3], behind[3], turned[3], *e = t->residual + 3 * k, *s = t->slope + 12 * k;
        const double *v = t->b + 3 * k;
        t->weight[k] = 0;
        if (!turn_of_first(w, a, b, t, k, offset_s) || !turn_of_first(before, a, b, t, k, offset_s - h) ||
            !turn_of_first(behind, a, b, t, k, offset_s + h))
            continue;
        for (int i = 0; i < 3; i++) {
            turned[i] = r[3 * i] * v[0] + r[3 * i + 1] * v[1] + r[3 * i + 2] * v[2];
            e[i] = w[i] - turned[i];
            s[4 * i] = (behind[i] - before[i]) / (2 * h);
        }
        /* -R' w_b = -(I + [d]x) R w_b: by d, [R w_b]x. */
        const double x[9] = {0, -turned[2], turned[1], turned[2], 0, -turned[0], -turned[1], turned[0], 0};
        for (int i = 0; i < 9; i++) s[4 * (i / 3) + 1 + i % 3] = x[i];
        t->weight[k] = 1;
        t->sorted[n++] = sqrt(e[0] * e[0] + e[1] * e[1] + e[2] * e[2]);
    }
    if (!n) return NAN;
    qsort(t->sorted, n, sizeof *t->sorted, compare_doubles);
    return t->sorted[n / 2];
}

/* Huber's weights at two and a half times the median; normal equations h d = -g. */
static void accumulate(double h[16], double g[4], turns *t, double usual)
{
    memset(h, 0, 16 * sizeof *h);
    memset(g, 0, 4 * sizeof *g);
    for (size_t k = 0; k < t->count; k++) {
        if (t->weight[k] == 0) continue;
        const double *e = t->residual + 3 * k, *s = t->slope + 12 * k;
        double length = sqrt(e[0] * e[0] + e[1] * e[1] + e[2] * e[2]), edge = 2.5 * usual;
        t->weight[k] = length > edge ? edge / length : 1;
        for (int i = 0; i < 3; i++)
            for (int p = 0; p < UNKNOWNS; p++) {
                g[p] += t->weight[k] * s[4 * i + p] * e[i];
                for (int q = 0; q < UNKNOWNS; q++) h[4 * p + q] += t->weight[k] * s[4 * i + p] * s[4 * i + q];
            }
    }
}

/* ---- how well it is known ---- */

/* Error of each pose of b (rad, in a's body): R_a against R_Z R_b R^T with the robust mean R_Z; zero where a
 * has nothing. */
static bool pose_errors(double *error, const stream *a, const stream *b, double offset_s, const double r[9])
{
    td_pose turn = td_pose_from_rotation(r, (const double[3]){0}), back = td_pose_inverse(&turn), mean = back,
            at;
    double usual = INFINITY, *length = malloc(b->count * sizeof *length);
    for (int round = 0; round < 4 && length; round++) {
        double sum[16] = {0}, value[4], vector[16];
        size_t n = 0;
        for (size_t i = 0; i < b->count; i++) {
            memset(error + 3 * i, 0, 3 * sizeof *error);
            if (!stream_at(&at, a, b->time[i] + offset_s)) continue;
            td_pose other = td_pose_compose(&b->pose[i], &back), against = td_pose_inverse(&other);
            td_pose z = td_pose_compose(&at, &against), predicted = td_pose_compose(&mean, &other);
            turn_between(error + 3 * i, &predicted, &at);
            double off = hypot(hypot(error[3 * i], error[3 * i + 1]), error[3 * i + 2]);
            double weight = round ? 1 / (1 + pow(off / usual, 2)) : 1;
            for (int k = 0; k < 16; k++) sum[k] += weight * z.q[k / 4] * z.q[k % 4];
            length[n++] = off;
        }
        if (!n || td_eigen_symmetric(value, vector, sum, 4, NULL) != TD_OK) break;
        memcpy(mean.q, vector + 12, sizeof mean.q);
        qsort(length, n, sizeof *length, compare_doubles);
        usual = round ? length[n / 2] + 1e-12 : 4;
    }
    bool done = length;
    free(length);
    return done;
}

/* Standard deviation of the offset. A rotation between two poses errs by the difference of their errors, so
 * the sum that moved the offset is one over poses; its variance is that of its parts over blocks of the
 * stream, with what blocks near one another share (Newey and West 1987), for errors that last. */
static double offset_sigma(const turns *t, const double inverse[16], const stream *a, const stream *b,
                           double offset_s, const double r[9])
{
    double score[MOST_BLOCKS] = {0}, sum = 0;
    size_t n = b->count / 8 < MOST_BLOCKS ? b->count / 8 : MOST_BLOCKS, lags = n / 10 + 1;
    double *error = malloc(3 * b->count * sizeof *error);
    if (!error || n < 4 || !pose_errors(error, a, b, offset_s, r)) {
        free(error);
        return NAN;
    }
    for (size_t k = 0; k < t->count; k++)
        for (int i = 0; i < 3 && t->weight[k] > 0; i++) {
            const double *s = t->slope + 12 * k + 4 * i;
            double by = inverse[0] * s[0] + inverse[1] * s[1] + inverse[2] * s[2] + inverse[3] * s[3];
            score[t->to[k] * n / b->count] += t->weight[k] * by * error[3 * t->to[k] + i];
            score[t->from[k] * n / b->count] -= t->weight[k] * by * error[3 * t->from[k] + i];
        }
    free(error);
    for (size_t lag = 0; lag <= lags; lag++) {
        double share = (lag ? 2 : 1) * (1 - (double)lag / (double)(lags + 1));
        for (size_t block = lag; block < n; block++) sum += share * score[block] * score[block - lag];
    }
    return sqrt(sum / (1 - (double)lags / (double)n));
}

/* The usual length of the rotations of the second stream that the first has something to. */
static double usual_turn(turns *t)
{
    size_t n = 0;
    for (size_t k = 0; k < t->count; k++)
        if (t->weight[k] > 0) t->sorted[n++] = hypot(hypot(t->b[3 * k], t->b[3 * k + 1]), t->b[3 * k + 2]);
    if (!n) return 0;
    qsort(t->sorted, n, sizeof *t->sorted, compare_doubles);
    return t->sorted[n / 2];
}

static td_status refine(double *offset_s, double *sigma_s, double *left, const stream *a, const stream *b,
                        double window_s, td_error *error)
{
    turns t;
    double r[9], h[16], g[4], step = INFINITY, begun_s = *offset_s;
    TD_TRY(turns_gather(&t, b, window_s, error));
    td_status status = fit_rotation(r, a, b, &t, *offset_s) ? TD_OK : TD_ERROR_DATA;
    for (int round = 0; round < ROUNDS && status == TD_OK; round++) {
        *left = linearise(&t, a, b, *offset_s, r);
        accumulate(h, g, &t, *left);
        status = isfinite(*left) ? td_invert_spd(h, h, UNKNOWNS, NULL) : TD_ERROR_DATA;
        if (status != TD_OK || fabs(step) < 1e-7) break;
        double d[4], turn[9], q[4];
        for (int p = 0; p < 4; p++)
            d[p] = -(h[4 * p] * g[0] + h[4 * p + 1] * g[1] + h[4 * p + 2] * g[2] + h[4 * p + 3] * g[3]);
        step = d[0];
        *offset_s += step;
        td_rotation_exp(q, d + 1);
        const td_pose by = {.q = {q[0], q[1], q[2], q[3]}};
        double old[9];
        memcpy(old, r, sizeof old);
        td_pose_rotation(turn, &by);
        td_multiply(r, turn, old, 3, 3, 3);
    }
    double sigma = status == TD_OK ? offset_sigma(&t, h, a, b, *offset_s, r) : NAN, turn_rad = usual_turn(&t);
    turns_free(&t);
    if (status != TD_OK || !isfinite(sigma) || !(fabs(*offset_s - begun_s) < 2 * window_s))
        return td_fail(
            error, TD_ERROR_DATA,
            "time offset: the rotations do not determine it; turn the body about several axes, now fast, "
            "now slowly");
    if (*left > LARGEST_PART * turn_rad)
        return td_fail(
            error, TD_ERROR_DATA,
            "time offset: the rotations of both streams differ by %.0f %% of their size wherever they are "
            "laid over one another; are they of one body?",
            100 * *left / turn_rad);
    *sigma_s = sigma;
    return TD_OK;
}

td_status td_time_offset(double *offset_s, double *sigma_s, const double *time_a, const td_pose *a,
                         size_t count_a, const double *time_b, const td_pose *b, size_t count_b,
                         td_error *error)
{
    stream first, second, turned;
    TD_TRY(stream_init(&first, "first", time_a, a, count_a, error));
    TD_TRY(stream_init(&second, "second", time_b, b, count_b, error));
    double window_s = fmax(WINDOW_S, 4 * fmax(first.step_s, second.step_s)), start = 0;
    TD_TRY(find_lag(&start, &first, &second, window_s, error));
    /* In the body a rotation is q_i^-1 q_j of poses in a fixed frame; of poses the other way round it is that
     * of their inverses. Which it is shows in what is left. */
    td_pose *inverse = malloc(count_b * sizeof *inverse);
    if (!inverse) return td_fail(error, TD_ERROR_MEMORY, "time offset: no memory");
    for (size_t i = 0; i < count_b; i++) inverse[i] = td_pose_inverse(&b[i]);
    turned = second;
    turned.pose = inverse;
    double offset[2] = {start, start}, sigma[2], left[2] = {INFINITY, INFINITY};
    td_status as_is = refine(&offset[0], &sigma[0], &left[0], &first, &second, window_s, error);
    td_status other =
        refine(&offset[1], &sigma[1], &left[1], &first, &turned, window_s, as_is == TD_OK ? NULL : error);
    free(inverse);
    if (as_is != TD_OK && other != TD_OK) return other;
    int best = as_is != TD_OK || (other == TD_OK && left[1] < left[0]);
    *offset_s = offset[best];
    if (sigma_s) *sigma_s = sigma[best];
    return TD_OK;
}
