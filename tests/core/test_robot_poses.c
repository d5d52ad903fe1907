/* Proves that robot poses come out the same from every convention of file, and that what is malformed is
 * refused with file and line. References: rotation matrices multiplied here from the elementary ones, and for
 * rotation vectors Rodrigues' formula, never the library's own quaternions (tolerance: rounding); on the real
 * files, numbers copied from them. Blind to files whose numbers are right for another convention than named:
 * hand_eye_mistakes looks for those. */
#include <locale.h>

#include "core/random.h"
#include "core/robot_poses.h"
#include "tests/check.h"
#include "tests/scratch.h"

static const double degree = 0.017453292519943295;

static td_robot_poses *parse(const char *text, const td_robot_poses_options *options)
{
    td_error error = {0};
    td_robot_poses *poses = NULL;
    check_ok(td_robot_poses_parse(&poses, text, strlen(text), "p.csv", options, &error), error);
    return poses;
}

static void elementary(double r[9], int axis, double angle)
{
    int i = (axis + 1) % 3, j = (axis + 2) % 3;
    memset(r, 0, 9 * sizeof *r);
    r[4 * axis] = 1;
    r[4 * i] = r[4 * j] = cos(angle);
    r[3 * i + j] = -sin(angle);
    r[3 * j + i] = sin(angle);
}

static void multiply(double c[9], const double a[9], const double b[9])
{
    double out[9];
    for (int i = 0; i < 9; i++)
        out[i] = a[i / 3 * 3] * b[i % 3] + a[i / 3 * 3 + 1] * b[3 + i % 3] + a[i / 3 * 3 + 2] * b[6 + i % 3];
    memcpy(c, out, sizeof out);
}

/* Rz(z) Ry(y) Rx(x) */
static void zyx(double r[9], double z, double y, double x)
{
    double part[9];
    elementary(r, 2, z);
    elementary(part, 1, y);
    multiply(r, r, part);
    elementary(part, 0, x);
    multiply(r, r, part);
}

/* Rodrigues: I + sin K + (1 - cos) K^2. */
static void rodrigues(double r[9], const double w[3])
{
    double angle = sqrt(w[0] * w[0] + w[1] * w[1] + w[2] * w[2]), a = angle > 0 ? 1 / angle : 0;
    double k[9] = {0, -w[2] * a, w[1] * a, w[2] * a, 0, -w[0] * a, -w[1] * a, w[0] * a, 0}, k2[9];
    multiply(k2, k, k);
    for (int i = 0; i < 9; i++) r[i] = (i % 4 == 0) + sin(angle) * k[i] + (1 - cos(angle)) * k2[i];
}

static void check_pose(const td_robot_pose *pose, const double r[9], double x, double y, double z,
                       double slack)
{
    double seen[9];
    td_pose_rotation(seen, &pose->base_from_hand);
    for (int k = 0; k < 9; k++) check_near(seen[k], r[k], slack);
    check_near(pose->base_from_hand.t[0], x, slack);
    check_near(pose->base_from_hand.t[1], y, slack);
    check_near(pose->base_from_hand.t[2], z, slack);
}

static void test_angles(void **state)
{
    (void)state;
    td_random random = td_random_seed(1, 0);
    for (int trial = 0; trial < 200; trial++) {
        char text[512];
        double v[3], r[9];
        for (int k = 0; k < 3; k++) v[k] = 6.2 * (td_random_uniform(&random) - 0.5);
        if (trial == 0) v[0] = v[1] = v[2] = 0;
        if (trial == 1) v[1] = 90 * degree; /* gimbal lock */

        snprintf(text, sizeof text, "x_m,y_m,z_m,roll_rad,pitch_rad,yaw_rad\n1,-2,3,%.17g,%.17g,%.17g\n",
                 v[0], v[1], v[2]);
        zyx(r, v[2], v[1], v[0]);
        td_robot_poses *p = parse(text, NULL);
        check_pose(&p->pose[0], r, 1, -2, 3, 1e-12);
        td_robot_poses_free(&p);

        snprintf(text, sizeof text, "x_mm,y_mm,z_mm,a_deg,b_deg,c_deg\n1000,-2000,3000,%.17g,%.17g,%.17g\n",
                 v[0] / degree, v[1] / degree, v[2] / degree);
        zyx(r, v[0], v[1], v[2]);
        p = parse(text, NULL);
        check_pose(&p->pose[0], r, 1, -2, 3, 1e-12);
        td_robot_poses_free(&p);

        snprintf(text, sizeof text, "rx_rad,ry_rad,rz_rad,z_m,y_m,x_m\n%.17g,%.17g,%.17g,3,-2,1\n", v[0],
                 v[1], v[2]);
        rodrigues(r, v);
        p = parse(text, NULL);
        check_pose(&p->pose[0], r, 1, -2, 3, 1e-12);
        td_robot_poses_free(&p);

        snprintf(text, sizeof text, "x,y,z,rx,ry,rz\n1,-2,3,%.17g,%.17g,%.17g\n", v[0] / degree,
                 v[1] / degree, v[2] / degree);
        p = parse(text, &(td_robot_poses_options){.metres = 0.001, .radians = degree});
        check_pose(&p->pose[0], r, 1e-3, -2e-3, 3e-3, 1e-12);
        td_robot_poses_free(&p);

        snprintf(text, sizeof text,
                 "rows: 6\ncols: 1\ndata: \n  - [1]\n  - [-2]\n  - [3]\n  - [%.17g]\n  - "
                 "[%.17g]\n  - [%.17g]\n",
                 v[0], v[1], v[2]);
        p = parse(text, NULL);
        check_pose(&p->pose[0], r, 1, -2, 3, 1e-12);
        td_robot_poses_free(&p);
    }
}

static void test_quaternions_and_matrices(void **state)
{
    (void)state;
    /* 120 degrees about (1,1,1): x to y, y to z, z to x; and 90 about z, whose quaternion is not symmetric.
     */
    static const double cyclic[9] = {0, 0, 1, 1, 0, 0, 0, 1, 0}, about_z[9] = {0, -1, 0, 1, 0, 0, 0, 0, 1};
    const char *const same[] = {
        "qw,qx,qy,qz,x_m,y_m,z_m\n0.5,0.5,0.5,0.5,1,2,3\n0.70710678118654752,0,0,0.70710678118654752,1,2,3\n",
        "x_mm,y_m,z_m,qz,qy,qx,qw,note\n1000,2,3,.5,.5,.5,.5,hi\n1000,2,3,0.70710678118654752,0,0,"
        "0.70710678118654752,\n",
        "0 0 1 1  1 0 0 2  0 1 0 3  0 0 0 1\n\n# next\n0,-1,0,1,1,0,0,2,0,0,1,3,0,0,0,1",
        "0\t0\t1\t1\t1\t0\t0\t2\t0\t1\t0\t3\r\n0;-1;0;1;1;0;0;2;0;0;1;3\r\n",
        "0 0 1 1\n1 0 0 2\n0 1 0 3\n0 0 0 1\n\n0 -1 0 1\n1 0 0 2\n0 0 1 3\n0 0 0 1\n",
        "1 2 3 0.5 0.5 0.5 0.5\n1 2 3 0 0 0.70710678118654752 0.70710678118654752\n",
        "7, 1, 2, 3, 0.5, 0.5, 0.5, 0.5\n8, 1, 2, 3, 0, 0, 0.70710678118654752, 0.70710678118654752\n"};
    for (size_t i = 0; i < sizeof same / sizeof *same; i++) {
        td_robot_poses *p = parse(same[i], NULL);
        assert_int_equal(p->count, 2);
        check_pose(&p->pose[0], cyclic, 1, 2, 3, 1e-15);
        check_pose(&p->pose[1], about_z, 1, 2, 3, 1e-15);
        if (i == 6)
            check_near(p->pose[1].time_s, 8, 0);
        else
            assert_true(isnan(p->pose[1].time_s));
        td_robot_poses_free(&p);
        assert_null(p);
    }
    td_robot_poses *p = parse("1 2 3 0.70710678118654752 0 0 0.70710678118654752\n",
                              &(td_robot_poses_options){.scalar_first = true});
    check_pose(&p->pose[0], about_z, 1, 2, 3, 1e-15);
    td_robot_poses_free(&p);
    p = parse(
        "rows: 4\ncols: 4\ndata:\n  - [0, -1, 0, 1]\n  - [1, 0, 0, 2]\n  - [0, 0, 1, 3]\n  - [0, 0, 0, 1]\n",
        NULL);
    check_pose(&p->pose[0], about_z, 1, 2, 3, 1e-15);
    td_robot_poses_free(&p);
    /* Written with few digits: taken, and exact afterwards. */
    p = parse("0.866 -0.5 0 1 0.5 0.866 0 2 0 0 1 3\n", NULL);
    double q2 = 0, thirty[9];
    for (int k = 0; k < 4; k++) q2 += p->pose[0].base_from_hand.q[k] * p->pose[0].base_from_hand.q[k];
    check_near(q2, 1, 1e-15);
    zyx(thirty, 30 * degree, 0, 0);
    check_pose(&p->pose[0], thirty, 1, 2, 3, 1e-4);
    td_robot_poses_free(&p);
}

static void test_options(void **state)
{
    (void)state;
    td_robot_poses *p =
        parse("frame,time_s,x_m,y_m,z_m,roll_deg,pitch_deg,yaw_deg,a,c\nhome,1.5,1,2,3,0,0,90,,\n",
              &(td_robot_poses_options){.inverted = true, .metres = 9, .radians = 9});
    assert_string_equal(p->pose[0].name, "home");
    check_near(p->pose[0].time_s, 1.5, 0);
    static const double back[9] = {0, 1, 0, -1, 0, 0, 0, 0, 1}; /* -R^T t = -(y, -x, z) */
    check_pose(&p->pose[0], back, -2, 1, -3, 1e-15);
    td_robot_poses_free(&p);
    td_error error = {0};
    td_robot_poses_options bad = {.metres = -1};
    check_fails(td_robot_poses_parse(&p, "1", 1, "p", &bad, &error), TD_ERROR_ARGUMENT, error,
                "metres is -1");
    bad = (td_robot_poses_options){.radians = NAN};
    check_fails(td_robot_poses_parse(&p, "1", 1, "p", &bad, &error), TD_ERROR_ARGUMENT, error, "radians is");
    bad = (td_robot_poses_options){.convention = TD_POSES_CONVENTION_COUNT};
    check_fails(td_robot_poses_parse(&p, "1", 1, "p", &bad, &error), TD_ERROR_ARGUMENT, error, "convention");
}

static void refused(const char *text, const td_robot_poses_options *options, const char *words)
{
    td_error error = {0};
    td_robot_poses *p = NULL;
    check_fails(td_robot_poses_parse(&p, text, strlen(text), "p.csv", options, &error), TD_ERROR_FORMAT,
                error, words);
    assert_null(p);
    if (strncmp(error.message, "p.csv", 5) != 0) fail_msg("'%s' does not begin with the file", error.message);
    assert_int_equal(td_robot_poses_parse(&p, text, strlen(text), "p.csv", options, NULL), TD_ERROR_FORMAT);
}

static void test_refusals(void **state)
{
    (void)state;
    static const char head[] = "x_m,y_m,z_m,qw,qx,qy,qz\n";
    char text[512];
    refused("", NULL, "holds no pose");
    refused("# nothing\n", NULL, "holds no pose");
    refused(head, NULL, "holds no pose");
    snprintf(text, sizeof text, "%s0,0,0,1,0,0,0\n0,0,nan,1,0,0,0\n", head);
    refused(text, NULL, "p.csv:3: column z_m");
    snprintf(text, sizeof text, "%s0,0,0,1,0,0\n", head);
    refused(text, NULL, "p.csv:2");
    snprintf(text, sizeof text, "%s0,0,0,1,0,0,0.1\n", head);
    refused(text, NULL, "p.csv:2: column qw: the quaternion's length is 1.00499");
    snprintf(text, sizeof text, "%s0,0,0,0,0,0,0\n", head);
    refused(text, NULL, "length is 0");
    snprintf(text, sizeof text, "%s1e6,0,0,1,0,0,0\n", head);
    refused(text, NULL, "pose 1 lies 1e+06 m from the base");
    refused("x_m,y_m,qw,qx,qy,qz\n", NULL, "p.csv:1: has no column z_m");
    refused("x_m,y_m,z_m,qw,qx,qy\n", NULL, "3 of the 4 columns of a rotation; qz is missing");
    refused("x_m,y_m,z_m\n1,2,3\n", NULL, "no columns of a rotation");
    refused("x_m,y_m,z_m,x_mm,qw,qx,qy,qz\n", NULL, "has x in two units (x_m and x_mm)");
    refused("x_m,y_m,z_m,qw,qx,qy,qz,rx_rad,ry_rad,rz_rad\n", NULL, "two rotations (qw");
    refused("time_s,x_m,y_m,z_m,a_deg,b_deg,c_deg\n2,0,0,0,0,0,0\n1.5,0,0,0,0,0,0\n", NULL,
            "p.csv:3: column time_s: the time goes back by 0.5 s");
    refused("frame,x_m,y_m,z_m,a_deg,b_deg,c_deg\n"
            "0123456789012345678901234567890123456789012345678901234567890123,0,0,0,0,0,0\n",
            NULL, "longer than 63 bytes");

    refused("1 0 0 0 0 1 0 0 0 0 1 0 0 0 0 1\n1 0 0 0 0 1 0 0 0 0 1 0\n", NULL,
            "p.csv:2: holds 12 numbers instead of 16, as the first row");
    refused("1 0 0 0 0 1 0 0 0 0 1\n", NULL, "p.csv:1: holds 11 numbers");
    refused("0.1 0.2 0.3 1 2 3\n", NULL, "name the columns in a header");
    refused("1 0 0 0 0 1 0 0 0 0 1 0 0 0 0 1 7\n", NULL, "more than 16 numbers");
    refused("\n1 0 0 0 0 1 0 nan 0 0 1 0 0 0 0 1\n", NULL, "p.csv:2: number 8 is 'nan', which is no number");
    refused("1 0 0 inf 0 1 0 0 0 0 1 0\n", NULL, "'inf'");
    refused("1 0 0 0 0 1 0 0 0 0 1 0\n1 0 0 0 0 1 0 0 0 0 1e999 0\n", NULL, "1e999");
    refused("1 0 0 0 0 1 0 0 0 0 -1 0\n", NULL, "p.csv:1: the matrix is no rotation: it mirrors");
    refused("2 0 0 0 0 2 0 0 0 0 2 0\n", NULL, "it changes lengths (determinant 8)");
    refused("1 0.1 0 0 0 1 0 0 0 0 1 0\n", NULL, "not at right angles");
    refused("1 0 0 0 0 1 0 0 0 0 1 0 0 0 0 2\n", NULL, "the last row of a pose is 0 0 0 1, not 0 0 0 2");
    refused("1 0 0 0 0 1 0 0 0 0 1 0 5 6 7 1\n", NULL, "column by column");
    refused("1 0 0 0\n0 1 0 0\n0 0 1 0\n", NULL, "four rows of 4 ends in row 3");
    refused("1 2 3 0 0 0 1\n1 2 3 0 0 0.2 1\n", NULL, "p.csv:2: the quaternion's length is 1.0198");
    refused("1 1 2 3 0 0 0 1\n0.5 1 2 3 0 0 0 1\n", NULL, "p.csv:2: the time goes back by 0.5 s");
    td_robot_poses_options ethz = {.convention = TD_POSES_ETHZ}, csv = {.convention = TD_POSES_CSV},
                           visp = {.convention = TD_POSES_VISP};
    refused("1 0 0 0 0 1 0 0 0 0 1 0 0 0 0 1\n", &ethz, "16 numbers instead of 8 (t x y z qx qy qz qw)");
    refused("1 2 3\n", &csv, "has no column x_m");

    refused("rows: 6\ncols: 1\n", NULL, "data");
    refused("rows: 6\ncols: 1\ndata: [[1], [2], [3], [0], [0]]\n", NULL, "data");
    refused("rows: 6\ncols: 1\ndata: [[1], [2], [3], [0], [0], [.nan]]\n", NULL, "data[5]");
    refused("rows: 3\ncols: 2\ndata: []\n", NULL, "an array of 3 x 2 is no pose");
    refused("rows: 4\ncols: 4\ndata: [[1, 0, 0, 0], [0, 1, 0, 0], [0, 0, -1, 0], [0, 0, 0, 1]]\n", NULL,
            "no rotation: it mirrors");
    refused("rows: 6\ncols: 1\ndata: [[1], [2], [3], [1e9], [0], [0]]\n", NULL, "turns by more than 1e6 rad");
    refused("1 2 3", &visp, "p.csv");
}

static void test_locale(void **state)
{
    (void)state;
    static const char *const comma[] = {"de_DE.UTF-8", "fr_FR.UTF-8", "de_DE"};
    const char *set = NULL;
    for (size_t i = 0; i < sizeof comma / sizeof *comma && !set; i++) set = setlocale(LC_ALL, comma[i]);
    if (!set) print_message("no locale with a decimal comma here\n");
    td_robot_poses *p = parse("x_m,y_m,z_m,qw,qx,qy,qz\n0.5,1.25,-3e-1,1,0,0,0\n", NULL);
    check_near(p->pose[0].base_from_hand.t[1], 1.25, 0);
    td_robot_poses_free(&p);
    p = parse("0.5 1.25 -0.3 0 0 0 1.0\n", NULL);
    check_near(p->pose[0].base_from_hand.t[1], 1.25, 0);
    td_robot_poses_free(&p);
    setlocale(LC_ALL, "C");
}

static void test_interpolation(void **state)
{
    (void)state;
    td_robot_poses *p =
        parse("time_s,x_m,y_m,z_m,rx_deg,ry_deg,rz_deg\n10,0,0,0,0,0,170\n12,2,0,-4,0,0,-170\n"
              "12,2,0,-4,0,0,-170\n20,2,0,0,0,0,-170\n",
              NULL);
    td_pose at;
    double r[9];
    assert_true(td_robot_poses_at(&at, p, 10.5, 3));
    check_near(at.t[0], 0.5, 1e-14);
    check_near(at.t[2], -1, 1e-14);
    td_robot_pose seen = {.base_from_hand = at};
    zyx(r, 175 * degree, 0, 0); /* through 180, not through 0 */
    check_pose(&seen, r, 0.5, 0, -1, 1e-12);
    assert_true(td_robot_poses_at(&at, p, 10, 1));
    assert_true(td_robot_poses_at(&at, p, 12, 1)); /* on a pose, whatever the gap */
    assert_memory_equal(at.t, p->pose[2].base_from_hand.t, sizeof at.t);
    assert_true(td_robot_poses_at(&at, p, 20, 1));
    assert_false(td_robot_poses_at(&at, p, 9.999, 3));
    assert_false(td_robot_poses_at(&at, p, 20.001, 3));
    assert_false(td_robot_poses_at(&at, p, NAN, 3));
    assert_false(td_robot_poses_at(&at, p, 15, 3));
    assert_true(td_robot_poses_at(&at, p, 15, 0));
    check_near(at.t[2], -2.5, 1e-14);
    td_robot_poses_free(&p);
    p = parse("x_m,y_m,z_m,rx_deg,ry_deg,rz_deg\n0,0,0,0,0,170\n", NULL);
    assert_false(td_robot_poses_at(&at, p, 0, 3));
    td_robot_poses_free(&p);
}

static void write_text(const char *folder, const char *name, const char *text)
{
    td_error error = {0};
    char *path = td_path_join(folder, name);
    check_ok(td_file_write(path, text, strlen(text), &error), error);
    free(path);
}

static void test_sets_of_files(void **state)
{
    const char *folder = *state;
    char text[256], name[64], path[512];
    for (int i = 1; i <= 11; i++) {
        snprintf(text, sizeof text,
                 "rows: 6\ncols: 1\ndata:\n  - [%d]\n  - [0]\n  - [0]\n  - [0]\n  - [0]\n  - [0]\n", i);
        snprintf(name, sizeof name, "pose_%d.yaml", i);
        write_text(folder, name, text);
    }
    td_error error = {0};
    td_robot_poses *p = NULL;
    check_ok(td_robot_poses_read(&p, folder, NULL, &error), error);
    assert_int_equal(p->count, 11);
    check_near(p->pose[10].base_from_hand.t[0], 11, 0); /* natural order */
    assert_string_equal(p->pose[1].name, "pose_2");
    td_robot_poses_free(&p);
    write_text(folder, "other.yaml", "nonsense");
    snprintf(path, sizeof path, "%s/pose_%%d.yaml", folder);
    check_ok(td_robot_poses_read(&p, path, NULL, &error), error);
    assert_int_equal(p->count, 11);
    td_robot_poses_free(&p);
    snprintf(path, sizeof path, "%s/pose_%%02d.yaml", folder);
    check_ok(td_robot_poses_read(&p, path, NULL, &error), error);
    assert_int_equal(p->count, 2);
    td_robot_poses_free(&p);
    check_fails(td_robot_poses_read(&p, folder, NULL, &error), TD_ERROR_FORMAT, error, "other.yaml");
    assert_null(p);
    snprintf(path, sizeof path, "%s/none_%%d.yaml", folder);
    check_fails(td_robot_poses_read(&p, path, NULL, &error), TD_ERROR_NOT_FOUND, error,
                "no file of this pattern");
    snprintf(path, sizeof path, "%s/none.csv", folder);
    check_fails(td_robot_poses_read(&p, path, NULL, &error), TD_ERROR_IO, error, "none.csv");
    write_text(folder, "two_1.txt", "1 2 3 0 0 0 1\n1 2 3 0 0 0 1\n");
    snprintf(path, sizeof path, "%s/two_%%d.txt", folder);
    check_fails(td_robot_poses_read(&p, path, NULL, &error), TD_ERROR_FORMAT, error, "holds 2 poses");
}

static void test_real_files(void **state)
{
    (void)state;
    const char *data = getenv("TELEDIMOS_DATA");
    char path[1024];
    td_error error = {0};
    td_robot_poses *p = NULL;
    if (!data) skip();
    snprintf(path, sizeof path, "%s/kuka_2/RobotPosesVec.txt", data);
    if (td_robot_poses_read(&p, path, NULL, &error) != TD_OK) {
        print_message("skipped: %s\n", error.message);
        skip();
    }
    assert_int_equal(p->count, 28);
    check_near(p->pose[0].base_from_hand.t[1], 1.129812866, 0);
    td_pose between = td_pose_inverse(&p->pose[0].base_from_hand);
    between = td_pose_compose(&between, &p->pose[1].base_from_hand);
    check_near(td_pose_distance(&between), 1.1e-6, 1e-6); /* the tool turns on the spot */
    td_robot_poses_free(&p);
    snprintf(path, sizeof path, "%s/visp-eye-in-hand/franka_pose_rPe_%%d.yaml", data);
    check_ok(td_robot_poses_read(&p, path, NULL, &error), error);
    assert_int_equal(p->count, 8);
    static const double w[3] = {-3.01226, 0.0236777, -0.451343};
    double r[9];
    rodrigues(r, w);
    check_pose(&p->pose[0], r, 0.335091, -0.0321497, 0.30857, 1e-12);
    assert_string_equal(p->pose[7].name, "franka_pose_rPe_8");
    td_robot_poses_free(&p);
}

int main(void)
{
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(test_angles),
        cmocka_unit_test(test_quaternions_and_matrices),
        cmocka_unit_test(test_options),
        cmocka_unit_test(test_refusals),
        cmocka_unit_test(test_locale),
        cmocka_unit_test(test_interpolation),
        cmocka_unit_test_setup_teardown(test_sets_of_files, scratch_make, scratch_remove),
        cmocka_unit_test(test_real_files),
    };
    return cmocka_run_group_tests(tests, NULL, NULL);
}
