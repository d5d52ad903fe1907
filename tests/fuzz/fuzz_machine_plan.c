/* Any bytes as the plan of a trench from elsewhere: refused with a sentence, or taken within all bounds that
 * who digs by it trusts; and then, written, it is taken again and the same bytes. */
#include <math.h>
#include <stdint.h>
#include <stdlib.h>
#include <string.h>

#include "apps/machine_plan.h"

int LLVMFuzzerTestOneInput(const uint8_t *data, size_t size);

static void must(bool fine)
{
    if (!fine) abort();
}

static void check_bounds(const td_dig_plan *p)
{
    const td_dig_floor *f = &p->floor;
    must(isfinite(f->start[0]) && isfinite(f->start[1]) && isfinite(f->start[2]));
    must(isfinite(f->heading_rad) && isfinite(f->length_m) && isfinite(f->width_m));
    must(isfinite(f->along) && isfinite(f->across));
    must(p->move_count > 0 && p->move_count <= 500 && p->pass_count >= 0 && p->lane_count >= 0);
    must(!p->expected && !p->left && p->left_count == 0);
    for (int i = 0; i < p->move_count; i++) {
        const td_dig_move *m = p->move + i;
        must(m->pass >= 0 && m->pass < p->pass_count && m->lane >= 0 && m->lane < p->lane_count);
        must(m->phase >= TD_DIG_RETURN && m->phase <= TD_DIG_DUMP && !m->position.via_count);
        must(isfinite(m->cut_m3) && isfinite(m->load_m3) && isfinite(m->depth_m));
        for (int k = 0; k < m->position.joint_count; k++) must(isfinite(m->position.joint[k].value));
        for (int k = 0; k < 3; k++) must(m->position.joint_count || isfinite(m->position.to.at_m[k]));
    }
}

static char *written(const td_dig_plan *plan, const td_task *task)
{
    char *text = NULL;
    must(machine_plan_text(&text, plan, task, NULL) == TD_OK);
    return text;
}

int LLVMFuzzerTestOneInput(const uint8_t *data, size_t size)
{
    static const char of[] = "teledimos: task 1\nname: t\nsteps: [{wait: {for_s: 1}}]\n";
    td_error error = {0};
    td_dig_plan *plan = NULL, *again = NULL;
    td_task *task = NULL;
    if (machine_plan_parse(&plan, (const char *)data, size, &error) != TD_OK) {
        must(error.message[0] && !plan);
        return 0;
    }
    check_bounds(plan);
    must(td_task_parse(&task, of, sizeof of - 1, "task", &error) == TD_OK);
    char *text = written(plan, task);
    must(machine_plan_parse(&again, text, strlen(text), &error) == TD_OK);
    char *second = written(again, task);
    must(strcmp(text, second) == 0);
    free(text);
    free(second);
    td_task_free(&task);
    td_dig_plan_free(&plan);
    td_dig_plan_free(&again);
    return 0;
}
