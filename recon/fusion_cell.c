/* The filter of a cell.
 *
 * Two estimates of one height, e = n + c with noise n and the calibration's share c, are put together as the
 * best linear unbiased one. Their errors have in common r c1 c2 (one rig) and of the noise m: what repeats
 * where the cell's last measurements come from the same place (`share` of them), and what repeats anywhere:
 *
 *   m = share repeated + (1 - share) anywhere,
 *   C = r c1 c2 + m,   k = (V1 - C) / (V1 + V2 - 2 C),   V = noise + c^2,
 *   h = h1 + k (h2 - h1),   noise = (1 - k)^2 n1 + k^2 n2 + 2 k (1 - k) m,
 *   c = (1 - k) c1 + k c2,
 *
 * k held to 0 … 1. The last line takes the calibration's errors as the same, r = 1, which is safe. For the
 * gain r is less: c1 and c2 hold the error of a slope, and full correlation would always take the smaller
 * one, which is then too small. `share` follows the weight of that place's measurements in the height. With C
 * = 0 this is the Kalman filter of a constant.
 *
 * What was seen in small part neither begins a cell nor joins it: it can only be, or bear out, a rival, which
 * is not believed before a better look bears it out too. */
#include <math.h>
#include <string.h>

#include "recon/fusion_internal.h"

static const double ALIKE = 0.5, ALIKE_THERE = 0.4; /* r: from two places; and more from one */

static uint32_t sum_of(uint32_t a, uint32_t b)
{
    return a > UINT32_MAX - b ? UINT32_MAX : a + b;
}

static void begin(td_estimate *e, const td_measure *m)
{
    *e = (td_estimate){(float)m->height, (float)m->noise, (float)m->common, 1, m->place, m->count};
}

static void join(td_estimate *e, const td_measure *m)
{
    const double noise = (double)e->noise, common = (double)e->common;
    const double share = e->place == m->place ? (double)e->share : 0;
    /* No more can be in common than both have. */
    const double shared = share * m->repeated + (1 - share) * m->anywhere;
    const double repeated = fmin(shared, sqrt(noise * m->noise));
    const double both = (ALIKE + ALIKE_THERE * share) * common * m->common + repeated;
    const double own = noise + common * common - both, other = m->noise + m->common * m->common - both;
    const double k = own + other > 0 ? fmin(fmax(own / (own + other), 0), 1) : 0;
    e->height = (float)((double)e->height + k * (m->height - (double)e->height));
    e->noise = (float)((1 - k) * (1 - k) * noise + k * k * m->noise + 2 * k * (1 - k) * repeated);
    e->common = (float)((1 - k) * common + k * m->common);
    e->share = (float)((1 - k) * share + k);
    e->place = m->place;
    e->count = sum_of(e->count, m->count);
}

static bool agrees(const td_estimate *e, const td_measure *m, double gate)
{
    const double off = m->height - (double)e->height;
    const double variance =
        (double)e->noise + (double)e->common * (double)e->common + m->noise + m->common * m->common;
    return off * off <= gate * gate * variance;
}

static void drop_rival(td_cell *cell)
{
    memset(&cell->rival, 0, sizeof cell->rival);
    cell->rival_frames = cell->rival_whole = 0;
}

/* One frame more contradicts the cell; true: it is believed. */
static bool contradict(td_cell *cell, const td_measure *m, const td_fusion_options *options)
{
    if (cell->rival_frames > 0 && agrees(&cell->rival, m, options->gate_sigma)) {
        join(&cell->rival, m);
        cell->rival_frames++;
    } else {
        begin(&cell->rival, m);
        cell->rival_frames = 1;
        cell->rival_whole = 0;
    }
    cell->rival_whole |= !m->in_part;
    if (!cell->rival_whole && cell->rival_frames == options->believe_frames) cell->rival_frames--;
    if (cell->rival_frames < options->believe_frames) return false;
    cell->now = cell->rival;
    cell->provenance = cell->rival_frames > 1 ? TD_CELL_FUSED : TD_CELL_MEASURED;
    drop_rival(cell);
    return true;
}

/* Whether a cell seen in small part is of use. */
static bool tells(const td_cell *cell, const td_measure *m, const td_fusion_options *options)
{
    if (cell->provenance == TD_CELL_UNKNOWN || options->believe_frames < 2) return false;
    if (agrees(&cell->now, m, options->gate_sigma)) return false;
    return cell->rival_frames == 0 || agrees(&cell->rival, m, options->gate_sigma);
}

td_cell_outcome td_cell_measure(td_cell *cell, const td_measure *m, const td_fusion_options *options)
{
    if (m->in_part && !tells(cell, m, options)) return TD_CELL_IGNORED;
    cell->passed_frames = 0;
    if (cell->provenance == TD_CELL_UNKNOWN) {
        begin(&cell->now, m);
        cell->provenance = TD_CELL_MEASURED;
        cell->time_s = m->time_s;
        return TD_CELL_NEW;
    }
    if (agrees(&cell->now, m, options->gate_sigma)) {
        join(&cell->now, m);
        cell->provenance = TD_CELL_FUSED;
        cell->time_s = m->time_s;
        drop_rival(cell);
        return TD_CELL_AGREES;
    }
    if (!contradict(cell, m, options)) return TD_CELL_GATED;
    cell->time_s = m->time_s;
    return TD_CELL_RESET;
}

bool td_cell_pass(td_cell *cell, const td_fusion_options *options)
{
    cell->passed_frames++;
    if (cell->passed_frames < options->believe_frames) return false;
    memset(cell, 0, sizeof *cell);
    return true;
}

double td_cell_sigma(const td_cell *cell)
{
    return sqrt((double)cell->now.noise + (double)cell->now.common * (double)cell->now.common);
}

/* Along one side of s pixels the errors' autocorrelation is a triangle of half width L; the mean of its s^2
 * values is 1 - (s^2 - 1) / (3 s L) for s <= L, L/s - (L^2 - 1) / (3 s^2) beyond. */
double td_mean_variance(double n, double correlation)
{
    const double s = sqrt(fmax(n, 1)), l = correlation;
    const double side = s <= l ? 1 - (s * s - 1) / (3 * s * l) : l / s - (l * l - 1) / (3 * s * s);
    return side * side;
}

static bool estimate_sound(const td_estimate *e)
{
    return isfinite(e->height) && e->noise >= 0 && isfinite(e->noise) && e->common >= 0 &&
           isfinite(e->common) && e->share >= 0 && e->share <= 1;
}

bool td_cell_sound(const td_cell *cell, const td_fusion_options *options)
{
    static const uint8_t nothing[sizeof cell->spare];
    static const td_estimate none;
    if (cell->provenance != TD_CELL_PRIOR && cell->provenance != TD_CELL_MEASURED &&
        cell->provenance != TD_CELL_FUSED)
        return false;
    if (!estimate_sound(&cell->now) || isinf(cell->time_s) || memcmp(cell->spare, nothing, sizeof nothing))
        return false;
    if (cell->rival_whole > (cell->rival_frames > 0)) return false;
    if (cell->rival_frames >= options->believe_frames || cell->passed_frames >= options->believe_frames)
        return false;
    return cell->rival_frames > 0 ? estimate_sound(&cell->rival)
                                  : memcmp(&cell->rival, &none, sizeof none) == 0;
}
