#include "tests/check.h"

#include "core/random.h"
#include "servo/trajectory_generator.h"

static void first(void **state)
{
    (void)state;
    td_error error = {0};
    td_robot *r = NULL;
    check_ok(td_robot_read(&r, TD_SOURCE_DIR "/datasets/zx200/zx200.urdf", &error), error);
    td_random random = td_random_seed(3, 1);
    td_tool tool = {.link = td_robot_find_link(r, "bucket_tip"), .link_from_tool = td_pose_identity(), .row_count = 4, .row = {TD_TOOL_X, TD_TOOL_Y, TD_TOOL_Z, TD_TOOL_PITCH}};
    int ok = 0, bad = 0;
    for (int task = 0; task < 200; task++) {
        td_via via[4] = {0};
        double q[5][4];
        for (int i = 0; i < 5; i++) {
            for (int k = 0; k < 4; k++) {
                double lo = fmax(r->joint[k].lower, -1.5), hi = fmin(r->joint[k].upper, 1.5);
                if (k) lo = r->joint[k].lower, hi = r->joint[k].upper;
                q[i][k] = lo + (hi - lo) * td_random_uniform(&random);
            }
            if (i == 0) continue;
            double pose[6];
            td_tool_pose(pose, r, &tool, q[i]);
            for (int k = 0; k < 4; k++) via[i - 1].value[k] = task % 2 ? pose[tool.row[k]] : q[i][k];
            via[i - 1].tolerance_m = via[i - 1].tolerance_rad = 0.05;
            via[i - 1].stop = false;
        }
        td_trajectory *t = NULL;
        td_nearest nearest;
        td_status s = td_trajectory_plan(&t, &nearest, r, task % 2 ? &tool : NULL, q[0], via, task % 2 ? 1 : 4, NULL, &error);
        if (s != TD_OK) {
            if (bad++ < 10) printf("%d: %s\n", task, error.message);
            continue;
        }
        ok++;
        td_trajectory_shares m;
        check_ok(td_trajectory_check(&m, t, r, td_robot_pump(r), 2000, &error), error);
        if (task < 40) printf("%d knots %zu %.2f s: pos %.5f speed %.5f acc %.5f flow %.5f pump %.5f events %zu\n", task, t->count, td_trajectory_duration(t), m.position.share, m.speed.share, m.acceleration.share, m.flow.share, m.pump.share, t->event_count);
        td_trajectory_free(&t);
    }
    printf("ok %d bad %d\n", ok, bad);
    td_robot_free(&r);
}

int main(void)
{
    const struct CMUnitTest tests[] = {cmocka_unit_test(first)};
    return cmocka_run_group_tests(tests, NULL, NULL);
}
