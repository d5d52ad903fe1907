#include "tests/servo/dig_scene.h"

typedef struct ground_case {
    const char *name;
    double slope_x, slope_y, bump_m, yaw;
    double x, y, length, depth, width, heading; /* heading: NAN: to the machine */
    double dump_x, dump_y;
} ground_case;
static const ground_case CASE[] = {
    {"flat", 0, 0, 0, 0, 7, 0, 2.4, 0.5, 0, NAN, 0.5, 6},
    {"slope", 0.1, 0.06, 0, 0, 7, 0.5, 2.4, 0.5, 0, NAN, 0.5, 6},
    {"rough", 0.02, -0.03, 0.12, 0.4, 6.5, 2, 2.2, 0.6, 0, NAN, 5, -4},
    {"pit", -0.05, 0.03, 0.05, 0, 7, 0.3, 2.0, 0.6, 2.4, 180, 0.5, -6},
    {"deep", 0, 0, 0, 0, 7, 0, 3, 1.1, 0, NAN, -3, 5.5},
    {"askew", 0, 0, 0.03, 0, 6.8, 1.5, 2.4, 0.5, 0, 180, 0.5, -6},
};
static scene scene_of(const ground_case *c)
{
    scene s = make_scene(c->slope_x, c->slope_y, c->bump_m);
    s.site_from_vehicle = standing(c->slope_x, c->slope_y, c->yaw);
    s.dig.from = (td_task_point){.at_m = {c->x, c->y, c->slope_x * c->x + c->slope_y * c->y}};
    s.dig.length_m = c->length, s.dig.depth_m = c->depth, s.dig.width_m = c->width;
    s.dig.has_heading = !isnan(c->heading);
    s.dig.heading_deg = s.dig.has_heading ? c->heading : 0;
    s.dump = (td_task_point){.at_m = {c->dump_x, c->dump_y, c->dump_x * c->slope_x + c->dump_y * c->slope_y}};
    return s;
}
static void first(void **state)
{
    (void)state;
    for (int i = 0; i < 6; i++) {
    scene s = scene_of(CASE + i);
    td_dig_plan *plan = NULL;
    printf("---- %s\n", CASE[i].name);
    if (td_dig_plan_make(&plan, request_of(&s), NULL, &error) != TD_OK) { printf("%s\n", error.message); continue; }
    printf("passes %d lanes %d moves %d trench %.3f cut %.3f left %.3f loose %.3f depth %.2f along %.3f across %.3f\n", plan->pass_count, plan->lane_count, plan->move_count, plan->trench_m3, plan->cut_m3, plan->left_m3, plan->loose_m3, plan->depth_m, plan->floor.along, plan->floor.across);
    replayed r = replay(&s, plan);
    double above;
    double rms = floor_off(&above, &plan->floor, r.map, 0.05);
    printf("dug %.3f dumped %.3f spilt %.3f fullest %.3f time %.0f rms %.4f above %.4f unplanned %.3f\n", r.dug_m3, r.dumped_m3, r.spilt_m3, r.fullest_m3, r.time_s, rms, above, r.unplanned_depth_m);
    rms = floor_off(&above, &plan->floor, plan->expected, 0.05);
    printf("expected rms %.4f above %.4f\n", rms, above);
    td_elevation_free(&r.map);
    td_dig_plan_free(&plan);
    free_scene(&s);
    }
}
int main(void)
{
    const struct CMUnitTest tests[] = {cmocka_unit_test(first)};
    return cmocka_run_group_tests(tests, NULL, NULL);
}
