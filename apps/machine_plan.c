#include "apps/machine_plan.h"

#include <jansson.h>
#include <math.h>
#include <stdlib.h>
#include <string.h>

#include "core/machine_messages.h"

/* The moves' positions are the steps of a task, whose parser is trusted with what comes from elsewhere. */
enum { MOST_MOVES = 500 };

/* ---- written ---- */

static json_t *floor_json(const td_dig_floor *f)
{
    return json_pack("[f, f, f, f, f, f, f, f]", f->start[0], f->start[1], f->start[2], f->heading_rad,
                     f->length_m, f->width_m, f->along, f->across);
}

static json_t *moves_json(const td_dig_plan *p)
{
    json_t *moves = json_array();
    for (int i = 0; i < p->move_count; i++) {
        const td_dig_move *m = p->move + i;
        json_array_append_new(moves, json_pack("[i, i, i, i, f, f, f]", m->pass, m->lane, (int)m->phase,
                                               (int)m->contact, m->cut_m3, m->load_m3, m->depth_m));
    }
    return moves;
}

/* A task of those positions, as its own text. */
static td_status positions_text(char **text, const td_dig_plan *p, const td_task *task, td_error *error)
{
    td_task copy = *task;
    copy.frame = TD_TASK_SITE;
    copy.step_count = p->move_count;
    copy.step = calloc((size_t)p->move_count + 1, sizeof *copy.step);
    if (!copy.step) return td_fail(error, TD_ERROR_MEMORY, "no memory for a plan");
    for (int i = 0; i < p->move_count; i++)
        copy.step[i] = (td_task_step){.kind = TD_TASK_POSITION, .as.position = p->move[i].position};
    const td_status status = td_task_text(text, &copy, error);
    free(copy.step);
    return status;
}

td_status machine_plan_text(char **text, const td_dig_plan *p, const td_task *task, td_error *error)
{
    char *positions = NULL;
    if (p->move_count > MOST_MOVES)
        return td_fail(error, TD_ERROR_DATA,
                       "the trench takes %d moves; a machine elsewhere is sent %d at most: dig it in parts",
                       p->move_count, MOST_MOVES);
    TD_TRY(positions_text(&positions, p, task, error));
    json_t *o = json_pack("{s:o, s:[f, f, f, f, f], s:[i, i], s:o, s:s}", "floor", floor_json(&p->floor),
                          "m3", p->trench_m3, p->cut_m3, p->left_m3, p->loose_m3, p->depth_m, "counts",
                          p->pass_count, p->lane_count, "moves", moves_json(p), "task", positions);
    free(positions);
    *text = o ? json_dumps(o, JSON_COMPACT | JSON_REAL_PRECISION(17)) : NULL;
    json_decref(o);
    if (!*text) return td_fail(error, TD_ERROR_MEMORY, "no memory for a plan");
    if (strlen(*text) <= TD_MACHINE_MAX_TASK) return TD_OK;
    free(*text);
    *text = NULL;
    return td_fail(error, TD_ERROR_DATA,
                   "the trench's %d moves are too much for a message to a machine elsewhere: dig it in parts",
                   p->move_count);
}

/* ---- read ---- */

static bool is_finite(const double *x, int count)
{
    for (int i = 0; i < count; i++)
        if (!isfinite(x[i])) return false;
    return true;
}

/* Of one of the plan's passes and lanes. */
static bool read_move(td_dig_move *m, const td_dig_plan *p, json_t *row)
{
    int phase = -1, contact = 0;
    const bool read = json_unpack(row, "[iiiiFFF!]", &m->pass, &m->lane, &phase, &contact, &m->cut_m3,
                                  &m->load_m3, &m->depth_m) == 0;
    m->phase = (td_dig_phase)phase;
    m->contact = contact != 0;
    return read && phase >= TD_DIG_RETURN && phase <= TD_DIG_DUMP && m->pass >= 0 &&
           m->pass < p->pass_count && m->lane >= 0 && m->lane < p->lane_count && is_finite(&m->cut_m3, 1) &&
           is_finite(&m->depth_m, 1);
}

/* Takes the joints of a step's position. */
static bool take_positions(td_dig_plan *p, td_task *task)
{
    if (task->step_count != p->move_count || task->frame != TD_TASK_SITE) return false;
    for (int i = 0; i < p->move_count; i++) {
        td_task_position *from = &task->step[i].as.position;
        if (task->step[i].kind != TD_TASK_POSITION || from->via_count) return false;
        p->move[i].position = *from;
        from->joint = NULL;
        from->joint_count = 0;
    }
    return true;
}

static td_status read_all(td_dig_plan *p, json_t *o, td_error *error)
{
    td_dig_floor *f = &p->floor;
    json_t *moves = NULL;
    const char *positions = NULL;
    td_task *task = NULL;
    if (json_unpack(o, "{s:[FFFFFFFF], s:[FFFFF], s:[ii], s:o, s:s}", "floor", f->start, f->start + 1,
                    f->start + 2, &f->heading_rad, &f->length_m, &f->width_m, &f->along, &f->across, "m3",
                    &p->trench_m3, &p->cut_m3, &p->left_m3, &p->loose_m3, &p->depth_m, "counts",
                    &p->pass_count, &p->lane_count, "moves", &moves, "task", &positions) != 0 ||
        !json_is_array(moves) || json_array_size(moves) > MOST_MOVES || !is_finite(f->start, 3))
        return td_fail(error, TD_ERROR_FORMAT, "the plan that came is none");
    const int count = (int)json_array_size(moves);
    p->move = calloc((size_t)count + 1, sizeof *p->move);
    if (!p->move) return td_fail(error, TD_ERROR_MEMORY, "no memory for a plan");
    for (int i = 0; i < count; i++)
        if (!read_move(p->move + i, p, json_array_get(moves, (size_t)i)))
            return td_fail(error, TD_ERROR_FORMAT, "the plan that came has no proper move %d", i + 1);
    TD_TRY(td_task_parse(&task, positions, strlen(positions), "the plan that came", error));
    p->move_count = count;
    const bool taken = take_positions(p, task);
    td_task_free(&task);
    return taken ? TD_OK
                 : td_fail(error, TD_ERROR_FORMAT, "the plan that came has other positions than moves");
}

td_status machine_plan_parse(td_dig_plan **plan, const char *text, size_t size, td_error *error)
{
    json_t *o = json_loadb(text, size, JSON_REJECT_DUPLICATES, NULL);
    td_dig_plan *p = *plan = calloc(1, sizeof *p);
    if (!p) {
        json_decref(o);
        return td_fail(error, TD_ERROR_MEMORY, "no memory for a plan");
    }
    const td_status status =
        o ? read_all(p, o, error) : td_fail(error, TD_ERROR_FORMAT, "the plan that came is no JSON");
    json_decref(o);
    if (status != TD_OK) td_dig_plan_free(plan);
    return status;
}
