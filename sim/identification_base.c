/* Base parameters: the sums of inertial parameters that enter the joints' forces (Gautier 1991), and their
 * names. */
#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "core/random.h"
#include "sim/identification_internal.h"

enum { DRAWS = 120 };
static const double PI = 3.14159265358979323846;

/* A column is a sum of others when less of it is left, as a share of its length. */
static const double DEPENDENT = 1e-9;

/* ---- parameters as the robot's file has them ---- */

td_status td_id_standard(double *value, const td_id_model *m, const td_robot *robot, const double *viscous,
                         const double *coulomb, td_error *error)
{
    td_dynamics *dynamics = NULL;
    double *all = calloc((size_t)(10 * robot->link_count), sizeof *all);
    td_status status = all ? td_dynamics_new(&dynamics, robot, error)
                           : td_fail(error, TD_ERROR_MEMORY, "no memory for inertial parameters");
    if (status == TD_OK) {
        td_dynamics_parameters(all, dynamics);
        for (int i = 0; i < m->links; i++) memcpy(value + 10 * i, all + 10 * m->link[i], 10 * sizeof *value);
        for (int k = 0; k < m->n; k++) {
            value[10 * m->links + k] = viscous[k];
            value[10 * m->links + m->n + k] = coulomb[k];
        }
    }
    td_dynamics_free(&dynamics);
    free(all);
    return status;
}

/* What size a parameter may have: mass m, m L and m L^2, L the distance of a link's mass from its joint. */
static void set_sizes(td_id_model *m)
{
    double effort = 0;
    for (int i = 0; i < m->links; i++) {
        const double *p = m->prior + 10 * i, mass = p[0];
        const double reach = sqrt((p[4] + p[7] + p[9]) / (2 * mass));
        for (int k = 0; k < 10; k++)
            m->size[10 * i + k] = mass * (k == 0 ? 1 : k < 4 ? reach : reach * reach);
        effort += 9.81 * mass * reach;
    }
    for (int k = 0; k < m->n; k++) {
        const td_robot_joint *j = m->robot->joint + k;
        const double most = isfinite(j->effort) && j->effort > 0 ? j->effort : effort,
                     fast = isfinite(j->speed) && j->speed > 0 ? j->speed : 1;
        m->size[10 * m->links + k] = fmax(m->o.viscous[k], 0.05 * most / fast);
        m->size[10 * m->links + m->n + k] = fmax(m->o.coulomb[k], 0.02 * most);
    }
}

/* ---- states ---- */

static void angles_to_rotation(double r[9], const double a[3])
{
    const double cr = cos(a[0]), sr = sin(a[0]), cp = cos(a[1]), sp = sin(a[1]), cy = cos(a[2]),
                 sy = sin(a[2]);
    const double rows[9] = {cy * cp,
                            cy * sp * sr - sy * cr,
                            cy * sp * cr + sy * sr,
                            sy * cp,
                            sy * sp * sr + cy * cr,
                            sy * sp * cr - cy * sr,
                            -sp,
                            cp * sr,
                            cp * cr};
    memcpy(r, rows, sizeof rows);
}

static void rotate_back(double out[3], const double r[9], const double v[3])
{
    for (int i = 0; i < 3; i++) out[i] = r[i] * v[0] + r[3 + i] * v[1] + r[6 + i] * v[2];
}

/* omega = turn(a) a', alpha = turn a'' + turn' a', for a = roll, pitch, yaw. */
static void set_base(td_id_state *s, const td_id_model *m, const double *value, const double *rate,
                     const double *second)
{
    const double *a = value + 3, *d = rate + 3;
    const double cr = cos(a[0]), sr = sin(a[0]), cp = cos(a[1]), sp = sin(a[1]);
    const double turn[9] = {1, 0, -sp, 0, cr, cp * sr, 0, -sr, cp * cr};
    const double changed[3] = {-cp * d[1] * d[2],
                               -sr * d[0] * d[1] + (cp * cr * d[0] - sp * sr * d[1]) * d[2],
                               -cr * d[0] * d[1] - (cp * sr * d[0] + sp * cr * d[1]) * d[2]};
    double r[9];
    angles_to_rotation(r, a);
    memcpy(s->turn, turn, sizeof turn);
    for (int i = 0; i < 3; i++) {
        s->nu[i] = s->acceleration[i] = 0;
        for (int k = 0; k < 3; k++) {
            s->back[3 * i + k] = r[3 * k + i];
            s->nu[i] += turn[3 * i + k] * d[k];
            s->acceleration[i] += turn[3 * i + k] * second[3 + k];
        }
        s->acceleration[i] += changed[i];
    }
    rotate_back(s->nu + 3, r, rate);
    rotate_back(s->acceleration + 3, r, second);
    rotate_back(s->gravity, r, m->o.gravity);
}

void td_id_state_from(td_id_state *s, const td_id_model *m, const double *value, const double *rate,
                      const double *second, bool base_moves)
{
    const size_t n = (size_t)m->n;
    memcpy(s->q, value, n * sizeof *value);
    memcpy(s->nu + 6, rate, n * sizeof *rate);
    memcpy(s->acceleration + 6, second, n * sizeof *second);
    if (base_moves) {
        set_base(s, m, value + n, rate + n, second + n);
        return;
    }
    double r[9];
    td_pose_rotation(r, &m->o.site_from_vehicle);
    memset(s->nu, 0, 6 * sizeof *s->nu);
    memset(s->acceleration, 0, 6 * sizeof *s->acceleration);
    rotate_back(s->gravity, r, m->o.gravity);
}

/* ---- regressors ---- */

/* Column of the full regressor; of links alone. */
static int full_column(const td_id_model *m, int standard)
{
    return 10 * m->link[standard / 10] + standard % 10;
}

void td_id_rows(double *rows, const td_id_model *m, const td_id_state *s)
{
    const int wide = 10 * m->robot->link_count;
    td_dynamics_regressor(m->full, m->dynamics, s->q, s->nu, s->acceleration, s->gravity);
    for (int k = 0; k < m->n; k++)
        for (int c = 0; c < m->count; c++) {
            const int standard = m->column[c], friction = standard - 10 * m->links;
            const double d = s->nu[6 + k];
            double value = 0;
            if (friction < 0)
                value = m->full[(6 + k) * wide + full_column(m, standard)];
            else if (friction % m->n == k)
                value = friction < m->n ? d : tanh(d / m->o.slip);
            rows[k * m->count + c] = value;
        }
}

void td_id_units(double *unit, const td_id_model *m, const td_id_state *s, bool base_moves)
{
    static const double still[TD_DYNAMICS_MAX] = {0};
    const int wide = 10 * m->robot->link_count, channels = m->n + (base_moves ? 6 : 0);
    for (int ch = 0; ch < channels; ch++) {
        double by[TD_DYNAMICS_MAX] = {0};
        const int b = ch - m->n;
        for (int i = 0; i < 3; i++) {
            if (b >= 3) by[i] = s->turn[3 * i + b - 3];
            if (b >= 0 && b < 3) by[3 + i] = s->back[3 * i + b];
        }
        if (b < 0) by[6 + ch] = 1;
        td_dynamics_regressor(m->full, m->dynamics, s->q, still, by, still);
        for (int k = 0; k < m->n; k++)
            for (int c = 0; c < m->count && m->column[c] < 10 * m->links; c++)
                unit[(k * channels + ch) * m->count + c] =
                    m->full[(6 + k) * wide + full_column(m, m->column[c])];
    }
}

/* ---- which columns are sums of others ---- */

static double drawn(td_random *random)
{
    return 2 * td_random_uniform(random) - 1;
}

/* Stacked regressor (rows, 10 links) of states drawn at random, each column in its parameter's size, each row
 * in the size of the joint's forces. */
static void draw_rows(double *stack, const td_id_model *m, bool base_moves)
{
    td_random random = td_random_seed(1991, 3);
    const int wide = 10 * m->robot->link_count, columns = 10 * m->links;
    for (int i = 0; i < DRAWS; i++) {
        double value[3][TD_DYNAMICS_MAX];
        td_id_state s;
        for (int k = 0; k < m->n + 6; k++) {
            const td_robot_joint *j = m->robot->joint + k;
            const bool bounded = k < m->n && isfinite(j->lower) && isfinite(j->upper);
            value[0][k] = bounded ? j->lower + (j->upper - j->lower) * td_random_uniform(&random)
                                  : (k < m->n ? PI : 0.4) * drawn(&random);
            for (int d = 1; d < 3; d++) value[d][k] = drawn(&random);
        }
        td_id_state_from(&s, m, value[0], value[1], value[2], base_moves);
        td_dynamics_regressor(m->full, m->dynamics, s.q, s.nu, s.acceleration, s.gravity);
        for (int k = 0; k < m->n; k++)
            for (int c = 0; c < columns; c++)
                stack[(size_t)(i * m->n + k) * (size_t)columns + (size_t)c] =
                    m->size[c] * m->full[(6 + k) * wide + full_column(m, c)];
    }
}

static double dot(const double *stack, size_t rows, int columns, int a, int b)
{
    double sum = 0;
    for (size_t i = 0; i < rows; i++)
        sum += stack[i * (size_t)columns + (size_t)a] * stack[i * (size_t)columns + (size_t)b];
    return sum;
}

/* Modified Gram-Schmidt, twice, in the parameters' order; weight (columns) of the columns kept before in
 * column c: what is left of c has length *left. */
static void project(double *stack, size_t rows, int columns, const int *kept, int count, int c, double *onto)
{
    memset(onto, 0, (size_t)count * sizeof *onto);
    for (int round = 0; round < 2; round++)
        for (int i = 0; i < count; i++) {
            const double share = dot(stack, rows, columns, kept[i], c);
            onto[i] += share;
            for (size_t r = 0; r < rows; r++)
                stack[r * (size_t)columns + (size_t)c] -=
                    share * stack[r * (size_t)columns + (size_t)kept[i]];
        }
}

/* A = Q R in the kept columns; a dependent column is Q onto, so A_kept R^-1 onto. `upper` (columns,columns)
 * holds R by columns of kept ones. */
static void regroup(td_id_model *m, double *stack, double *upper, double *onto, size_t rows)
{
    const int columns = 10 * m->links;
    for (int c = 0; c < columns; c++) {
        const double before = sqrt(dot(stack, rows, columns, c, c));
        if (before < DEPENDENT) continue;
        project(stack, rows, columns, m->column, m->count, c, onto);
        const double left = sqrt(dot(stack, rows, columns, c, c));
        if (left > DEPENDENT * before) {
            for (size_t r = 0; r < rows; r++) stack[r * (size_t)columns + (size_t)c] /= left;
            for (int i = 0; i < m->count; i++) upper[i * columns + m->count] = onto[i];
            upper[m->count * columns + m->count] = left;
            m->group[(size_t)m->count * (size_t)m->standard + (size_t)c] = 1;
            m->column[m->count++] = c;
            continue;
        }
        for (int i = m->count - 1; i >= 0; i--) {
            for (int k = i + 1; k < m->count; k++) onto[i] -= upper[i * columns + k] * onto[k];
            onto[i] /= upper[i * columns + i];
        }
        for (int i = 0; i < m->count; i++) {
            const double weight = onto[i] * m->size[m->column[i]] / m->size[c];
            if (fabs(onto[i]) > 1e-7) m->group[(size_t)i * (size_t)m->standard + (size_t)c] = weight;
        }
    }
}

static td_status find_groups(td_id_model *m, bool base_moves, td_error *error)
{
    const int columns = 10 * m->links;
    const size_t rows = (size_t)(DRAWS * m->n), area = (size_t)columns * (size_t)columns;
    double *stack = calloc(rows * (size_t)columns, sizeof *stack), *upper = calloc(area, sizeof *upper),
           *onto = calloc((size_t)columns, sizeof *onto);
    td_status status = TD_OK;
    if (stack && upper && onto) {
        draw_rows(stack, m, base_moves);
        regroup(m, stack, upper, onto, rows);
        for (int k = 0; k < 2 * m->n; k++) {
            m->group[(size_t)m->count * (size_t)m->standard + (size_t)(columns + k)] = 1;
            m->column[m->count++] = columns + k;
        }
    } else {
        status = td_fail(error, TD_ERROR_MEMORY, "no memory for base parameters");
    }
    free(stack);
    free(upper);
    free(onto);
    return status;
}

void td_id_prior(double *covariance, const td_id_model *m, double width)
{
    for (int a = 0; a < m->count; a++)
        for (int b = 0; b < m->count; b++) {
            double sum = 0;
            for (int c = 0; c < m->standard; c++) {
                const double size = width * m->size[c];
                sum += m->group[a * m->standard + c] * m->group[b * m->standard + c] * size * size;
            }
            covariance[a * m->count + b] = sum;
        }
}

/* ---- making ---- */

static td_status allocate(td_id_model *m, td_error *error)
{
    const size_t p = (size_t)m->standard;
    m->prior = calloc(p, sizeof *m->prior);
    m->size = calloc(p, sizeof *m->size);
    m->column = calloc(p, sizeof *m->column);
    m->group = calloc(p * p, sizeof *m->group);
    m->base_prior = calloc(p, sizeof *m->base_prior);
    m->base_size = calloc(p, sizeof *m->base_size);
    m->full = calloc((size_t)(6 + m->n) * 10 * (size_t)m->robot->link_count, sizeof *m->full);
    return m->prior && m->size && m->column && m->group && m->base_prior && m->base_size && m->full
               ? TD_OK
               : td_fail(error, TD_ERROR_MEMORY, "no memory for base parameters");
}

td_status td_id_model_make(td_id_model *m, const td_robot *robot, const td_identification_options *o,
                           bool base_moves, td_error *error)
{
    *m = (td_id_model){.robot = robot, .o = *o, .n = robot->joint_count};
    if (m->n < 1) return td_fail(error, TD_ERROR_DATA, "robot '%s' has no joint that moves", robot->name);
    for (int i = 0; i < robot->link_count; i++)
        if (robot->link[i].mass_kg > 0) m->link[m->links++] = i;
    m->standard = 10 * m->links + 2 * m->n;
    if (td_dynamics_zx200(&m->dynamics, robot, NULL) != TD_OK)
        TD_TRY(td_dynamics_new(&m->dynamics, robot, error));
    TD_TRY(allocate(m, error));
    TD_TRY(td_id_standard(m->prior, m, robot, o->viscous, o->coulomb, error));
    set_sizes(m);
    TD_TRY(find_groups(m, base_moves, error));
    for (int a = 0; a < m->count; a++) {
        double square = 0;
        for (int c = 0; c < m->standard; c++) {
            const double weight = m->group[a * m->standard + c];
            m->base_prior[a] += weight * m->prior[c];
            square += weight * weight * m->size[c] * m->size[c];
        }
        m->base_size[a] = sqrt(square);
    }
    return TD_OK;
}

void td_id_model_free(td_id_model *m)
{
    td_dynamics_free(&m->dynamics);
    free(m->prior);
    free(m->size);
    free(m->column);
    free(m->group);
    free(m->base_prior);
    free(m->base_size);
    free(m->full);
}

td_status td_base_parameters_of(double *value, const td_robot *robot, bool base_moves, const td_robot *other,
                                const double *viscous, const double *coulomb,
                                const td_identification_options *options, td_error *error)
{
    const td_identification_options o = options ? *options : td_identification_options_default(robot);
    td_id_model m = {0};
    td_status status = td_id_model_make(&m, robot, &o, base_moves, error);
    double *standard = status == TD_OK ? calloc((size_t)m.standard, sizeof *standard) : NULL;
    if (status == TD_OK && !standard)
        status = td_fail(error, TD_ERROR_MEMORY, "no memory for base parameters");
    if (status == TD_OK) status = td_id_standard(standard, &m, other, viscous, coulomb, error);
    for (int a = 0; status == TD_OK && a < m.count; a++) {
        value[a] = 0;
        for (int c = 0; c < m.standard; c++) value[a] += m.group[a * m.standard + c] * standard[c];
    }
    free(standard);
    td_id_model_free(&m);
    return status;
}

/* ---- in words ---- */

static const char *const names[12] = {"mass",       "mass_x",     "mass_y",     "mass_z",
                                      "inertia_xx", "inertia_xy", "inertia_xz", "inertia_yy",
                                      "inertia_yz", "inertia_zz", "viscous",    "coulomb"};
static const char *const words[12] = {"mass",       "mass x",     "mass y",           "mass z",
                                      "inertia xx", "inertia xy", "inertia xz",       "inertia yy",
                                      "inertia yz", "inertia zz", "viscous friction", "Coulomb friction"};

/* 0 to 9, 10, 11; whose it is. */
static int kind_of(const td_id_model *m, int standard, const char **owner)
{
    const int friction = standard - 10 * m->links;
    *owner =
        friction < 0 ? m->robot->link[m->link[standard / 10]].name : m->robot->joint[friction % m->n].name;
    return friction < 0 ? standard % 10 : 10 + friction / m->n;
}

void td_id_name(char name[2 * TD_NAME_SIZE], const td_id_model *m, int standard)
{
    const char *owner = "";
    const int kind = kind_of(m, standard, &owner);
    snprintf(name, 2 * TD_NAME_SIZE, "%s_%s", owner, names[kind]);
}

const char *td_id_unit(const td_id_model *m, int standard)
{
    const char *owner = "";
    const int kind = kind_of(m, standard, &owner), friction = standard - 10 * m->links;
    if (kind < 10) return kind == 0 ? "kg" : kind < 4 ? "kg m" : "kg m^2";
    const bool slides = m->robot->joint[friction % m->n].kind == TD_JOINT_PRISMATIC;
    return kind == 10 ? (slides ? "N s/m" : "N m s/rad") : slides ? "N" : "N m";
}

char *td_id_words(const td_id_model *m, const double *weight, double least)
{
    char *text = NULL;
    size_t size = 0;
    bool first = true;
    FILE *f = open_memstream(&text, &size);
    if (!f) return NULL;
    for (int c = 0; c < m->standard; c++) {
        const char *owner = "";
        const double w = weight[c];
        const int kind = kind_of(m, c, &owner);
        if (!(fabs(w) > least)) continue;
        fputs(w < 0 ? (first ? "-" : " - ") : first ? "" : " + ", f);
        if (fabs(fabs(w) - 1) > 1e-6) fprintf(f, "%.4g ", fabs(w));
        fprintf(f, "%s of %s", words[kind], owner);
        first = false;
    }
    fclose(f);
    return text;
}
