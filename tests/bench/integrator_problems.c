#include "tests/bench/integrator_problems.h"

#include <math.h>
#include <stdio.h>

/* The zx200 at rest, then all joints' rates are commanded at once: the valves open with their lag, and the
 * swing and the suspension ring. */
static bool make_machine(bench_problem *p, double oil_n_m, td_error *error)
{
    td_robot *robot = NULL;
    td_plant_state start = {.site_from_vehicle = td_pose_identity(), .q = {0, -0.4, 1.4, 0.4}};
    const td_plant_command command = {.kind = TD_COMMAND_RATE, .value = {0.2, -0.1, 0.15, 0.25}};
    if (td_robot_read(&robot, TD_SOURCE_DIR "/datasets/zx200/zx200.urdf", error) != TD_OK) return false;
    td_machine_options options = td_machine_options_default(robot);
    options.oil_n_m = oil_n_m;
    bool ok = td_machine_new(&p->machine, robot, &options, NULL, error) == TD_OK &&
              td_machine_reset(p->machine, &start, error) == TD_OK &&
              td_machine_settle(p->machine, error) == TD_OK &&
              td_machine_command(p->machine, &command, NULL, error) == TD_OK;
    td_robot_free(&robot);
    if (!ok) return false;
    p->ode = *td_machine_ode(p->machine);
    p->ode.event_count = 0; /* no joint meets its stop, and the peer looks for none */
    p->t_end = 4;
    memcpy(p->y0, td_machine_values(p->machine), p->ode.size * sizeof *p->y0);
    /* What is small: lengths and angles 0.01, speeds 0.1, forces 10 kN. */
    for (size_t i = 0; i < p->ode.size; i++) {
        char name[TD_NAME_SIZE + 16];
        td_machine_state_name(name, p->machine, i);
        const bool place = strstr(name, "quaternion") || strstr(name, "position") || strstr(name, "angle");
        p->absolute[i] = place ? 0.01 : strstr(name, "force") ? 1e4 : 0.1;
    }
    return true;
}

static void make_standard(bench_problem *p, int index)
{
    static const double mu[5] = {1, 10, 100, 1e3, 1e4};
    if (index < 5) van_der_pol(&p->standard, mu[index]);
    if (index == 5) robertson(&p->standard);
    if (index == 6) hires(&p->standard);
    if (index == 7) oregonator(&p->standard);
    p->ode = p->standard.ode;
    p->t_end = p->standard.t_end;
    memcpy(p->y0, p->standard.y0, sizeof p->standard.y0);
    for (size_t i = 0; i < p->ode.size; i++) p->absolute[i] = p->standard.absolute;
}

bool bench_problem_make(bench_problem *p, int index, td_error *error)
{
    static const char *const names[BENCH_PROBLEMS] = {
        "van der Pol 1", "van der Pol 10", "van der Pol 100", "van der Pol 1e3", "van der Pol 1e4",
        "Robertson",     "HIRES",          "Oregonator",      "machine 1e6",     "machine 1e7",
        "machine 1e8",   "machine 1e9",    "machine 1e10"};
    *p = (bench_problem){.name = names[index]};
    if (index >= 8) return make_machine(p, pow(10, index - 2), error);
    make_standard(p, index);
    return true;
}

void bench_problem_free(bench_problem *p)
{
    td_machine_free(&p->machine);
}

double bench_problem_error(const bench_problem *p, const double *end, const double *truth, double relative)
{
    double most = 0;
    for (size_t i = 0; i < p->ode.size; i++)
        most = fmax(most, fabs(end[i] - truth[i]) / (relative * (fabs(truth[i]) + p->absolute[i])));
    return most;
}
