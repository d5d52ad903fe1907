/* teledimos reconstruct: a dataset's stereo pairs into an elevation map. */
#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include <unistd.h>

#include "apps/reconstruct_internal.h"
#include "apps/reconstruct_team.h"
#include "core/file.h"

static const char *dataset_path, *rig_path, *prior_path, *region_text, *start_text, *crs, *method = "ours";
static cli_common common;
static cli_list gates;
static bool accept;
static int gate_every = 10, levels = 0, believe = 3, memory_mb = 1024, texels = 4;
static double start[4];
static double near_m = 2, far_m = 20, cell_m = 0.05, prior_sigma_m = 0.5;

static const char *const methods[] = {"ours", "opencv", NULL};

static cli_option options[] = {
    {CLI_STRING, "rig", 0, &rig_path, "FILE",
     "calibration of the cameras, as rig.yaml or a file of OpenCV, ROS, Kalibr, ViSP or mrcal; default: the "
     "dataset's",
     0, 0, NULL},
    {.type = CLI_HEADING, .name = "Dense matching"},
    {CLI_REAL, "near", 0, &near_m, "M", "nearest depth looked for; default 2", 0.01, 1e4, NULL},
    {CLI_REAL, "far", 0, &far_m, "M", "farthest depth; default 20", 0.02, 1e5, NULL},
    {CLI_INT, "levels", 0, &levels, "N", "disparities looked for; default 0: what --near and --far need", 0,
     4096, NULL},
    {CLI_STRING, "matcher", 0, &method, "NAME", "ours (default), or opencv (its SGBM, a second opinion)", 0,
     0, methods},
    {.type = CLI_HEADING, .name = "The map"},
    {CLI_REAL, "cell", 0, &cell_m, "M", "side of its cells; default 0.05", 1e-3, 100, NULL},
    {CLI_STRING, "region", 0, &region_text, "X0,Y0,X1,Y1",
     "only this part of the site, m; default: all that is seen", 0, 0, NULL},
    {CLI_STRING, "prior", 0, &prior_path, "FILE",
     "a map that is known before (GeoTIFF): kept where nothing is seen, fused where something is", 0, 0,
     NULL},
    {CLI_REAL, "prior-sigma", 0, &prior_sigma_m, "M", "its standard deviation where it has none; default 0.5",
     1e-3, 100, NULL},
    {CLI_STRING, "start", 0, &start_text, "X,Y,Z,HEADING",
     "where the base stands before the first frame, m and degrees, to a metre and 8 degrees: frames whose "
     "pose frames.csv does not give are then found on the --prior",
     0, 0, NULL},
    {CLI_INT, "believe", 0, &believe, "N",
     "frames in a row that must agree that the ground has changed; default 3", 1, 100, NULL},
    {CLI_INT, "memory", 0, &memory_mb, "MB",
     "memory for the map's cells, 64 bytes each; what is beyond is kept in DIR/state. Default 1024. The "
     "products do not depend on it",
     1, 1 << 24, NULL},
    {.type = CLI_HEADING, .name = "The products"},
    {CLI_INT, "texels", 0, &texels, "N",
     "of the orthophoto, along the side of a cell: 1, 2, 4 (default) or 8; 0: no orthophoto", 0, 8, NULL},
    {CLI_STRING, "crs", 0, &crs, "EPSG:CODE",
     "coordinate reference system of the site's x (east) and y (north), in metres: written into the "
     "products; "
     "default: the prior map's",
     0, 0, NULL},
    {.type = CLI_HEADING, .name = "The quality gate"},
    {CLI_INT, "look", 0, &gate_every, "N",
     "look at the epipolar residual of the first and each N-th frame; default 10; 0: never", 0, 1000000,
     NULL},
    {CLI_LIST, "gate", 0, &gates, "KEY=VALUE", NULL, 0, 0, NULL},
    {CLI_FLAG, "accept", 0, &accept, NULL, "end with status 0 even when the gate refuses", 0, 0, NULL},
    CLI_COMMON_OPTIONS(common,
                       "folder for the products: map.tif, orthophoto.tif, map.ply, map.las, map.glb, "
                       "result.yaml, report.html, log.jsonl",
                       "this job draws none"),
};

static cli_command command = {
    .name = "reconstruct",
    .summary = "a dataset's stereo pairs into an elevation map",
    .usage = "DATASET -o DIR [options]",
    .text =
        "Matches each pair densely, places its points by the pose of the base (columns x_m, y_m, z_m, qw, "
        "qx, qy, qz "
        "of frames.csv: site_from_vehicle) and fuses them into a map whose cells have a height, a standard "
        "deviation, a count and where they come from. With a robot (robot: {urdf, mount} in dataset.yaml, "
        "joint "
        "angles in frames.csv) the machine's own arm is left out.\n\n"
        "A frame without a pose is located by tags on the site (site_tags in dataset.yaml), or else by the "
        "ground it sees, from where the last frame was; one that cannot be is named and left out. DATASET "
        "may also be a folder in EuRoC's layout, or a pair in Middlebury's.\n\n"
        "Products: map.tif (GeoTIFF: height, sigma, count, provenance, time), orthophoto.tif (GeoTIFF, "
        "RGBA), "
        "map.ply and map.las (the cells as points with colour and sigma), map.glb (glTF: the surface with "
        "the "
        "orthophoto on it, Y up, origin in its extras), report.html.\n\n"
        "An image may be a picture of a video: left.mp4#120 in frames.csv is the one after 120 others. The "
        "two cameras' times (columns NAME_time_s, or the videos' own) are compared: what moves in between "
        "is wrong in depth.\n\n"
        "Run again after an interruption or a kill, it goes on where it stopped, and ends with the same "
        "bytes. A frame that fails is named, the others go on, and the exit status is 3. Started by "
        "mpirun, or by Slurm's srun --mpi=pmix, its processes share the frames, on as many machines as see "
        "the dataset's folder; the bytes are the same again. mpirun binds each to a processor unless told "
        "--bind-to none.\n\n"
        "Exit status: 0 done, 1 failed, 2 wrong usage, 3 the gate refuses the result (--accept).",
    .examples = "  teledimos render datasets/site-trench -o site --frames 1..3\n"
                "  teledimos reconstruct site -o map\n"
                "  mpirun -n 2 teledimos reconstruct site -o map\n",
    .option = options,
    .option_count = sizeof options / sizeof *options,
    .least = 0,
    .most = 1,
    .positional = &dataset_path,
};

static td_status parse_region(double region[4], td_error *error)
{
    char rest;
    if (!region_text) return TD_OK;
    if (sscanf(region_text, "%lf,%lf,%lf,%lf%c", &region[0], &region[1], &region[2], &region[3], &rest) !=
            4 ||
        !(region[0] < region[2]) || !(region[1] < region[3]))
        return td_fail(error, TD_ERROR_ARGUMENT,
                       "--region %s: write X0,Y0,X1,Y1 in metres with X0 < X1 and Y0 < Y1", region_text);
    return TD_OK;
}

static td_status parse_start(td_error *error)
{
    char rest;
    if (!start_text) return TD_OK;
    if (sscanf(start_text, "%lf,%lf,%lf,%lf%c", &start[0], &start[1], &start[2], &start[3], &rest) != 4 ||
        !(fabs(start[0]) < 1e7 && fabs(start[1]) < 1e7 && fabs(start[2]) < 1e5 && fabs(start[3]) <= 360))
        return td_fail(error, TD_ERROR_ARGUMENT, "--start %s: write X,Y,Z in metres and HEADING in degrees",
                       start_text);
    start[3] *= 0.017453292519943295;
    return TD_OK;
}

static td_status prepare(reconstruct_job *work, gate_row *rows, td_dataset **dataset, td_error *error)
{
    for (size_t i = 0; i < gates.count; i++)
        TD_TRY(gate_set(rows, reconstruct_gate_count, gates.value[i], error));
    if (!dataset_path)
        return td_fail(error, TD_ERROR_ARGUMENT, "DATASET is missing (usage: teledimos %s %s)", command.name,
                       command.usage);
    if (texels != 0 && texels != 1 && texels != 2 && texels != 4 && texels != 8)
        return td_fail(error, TD_ERROR_ARGUMENT, "--texels: must be 0, 1, 2, 4 or 8, not %d", texels);
    TD_TRY(reconstruct_crs(work, NULL, error));
    if (!(near_m < far_m)) return td_fail(error, TD_ERROR_ARGUMENT, "--near must be below --far");
    TD_TRY(parse_region(work->how->fusion.region, error));
    TD_TRY(parse_start(error));
    if (start_text) work->how->start = start;
    TD_TRY(td_dataset_read(dataset, dataset_path, error));
    work->dataset = *dataset;
    TD_TRY(reconstruct_frames(work, error));
    snprintf(work->how->fusion.frame, sizeof work->how->fusion.frame, "%s",
             work->has_poses          ? "site"
             : work->rig->has_vehicle ? "vehicle"
                                      : "rig");
    TD_TRY(reconstruct_prepare(work, error));
    return team_rank() == 0 ? reconstruct_begin(work, error) : TD_OK;
}

static td_status run(reconstruct_job *work, job *j, td_dataset **dataset)
{
    gate_row rows[8];
    memcpy(rows, reconstruct_gate_defaults, reconstruct_gate_count * sizeof *rows);
    td_status status = prepare(work, rows, dataset, &j->error);
    TD_TRY(team_agree(status, work->key, &work->resumed, &j->error));
    if (team_rank() > 0) return team_serve(work, work->resumed, &j->error);
    TD_TRY(reconstruct_run(work, &j->error));
    reconstruct_judge(work, rows);
    if (terminal_interrupted())
        return td_fail(&j->error, TD_ERROR_CANCELLED, "interrupted: run again to go on");
    TD_TRY(reconstruct_products(work, j));
    const job_output output = {reconstruct_report, reconstruct_table, work};
    return job_finish(j, reconstruct_result(work), &output);
}

/* Several processes on one machine share its processors. */
static int threads_here(void)
{
    const long processors = sysconf(_SC_NPROCESSORS_ONLN);
    if (common.threads || team_neighbours() == 1) return common.threads;
    return processors > team_neighbours() ? (int)processors / team_neighbours() : 1;
}

static void set_parts(reconstruct_how *how, const char *tiles)
{
    how->dense.method = strcmp(method, "opencv") == 0 ? TD_DENSE_OPENCV : TD_DENSE_OURS;
    how->dense.levels = levels;
    how->fusion.place_m = 0.1 * sqrt(near_m * far_m); /* a tenth of a middling distance */
    how->dense.threads = how->fusion.threads = threads_here();
    how->fusion.cell_m = cell_m;
    how->fusion.believe_frames = believe;
    how->fusion.memory_bytes = (size_t)memory_mb << 20;
    how->fusion.folder = tiles;
}

static int work_for(job *j)
{
    td_dataset *dataset = NULL;
    reconstruct_how how = {.rig = rig_path,
                           .prior = prior_path,
                           .output = common.output,
                           .crs = crs,
                           .texels = texels,
                           .camera = {0, 1},
                           .near_m = near_m,
                           .far_m = far_m,
                           .prior_sigma_m = prior_sigma_m,
                           .dense = td_dense_options_default(),
                           .fusion = td_fusion_options_default(),
                           .gate_every = gate_every,
                           .progress = &j->progress,
                           .log = &j->log};
    char *tiles = job_path(j, "state/tiles");
    set_parts(&how, tiles);
    reconstruct_job work = {.how = &how};
    td_status status = tiles ? run(&work, j, &dataset) : TD_ERROR_MEMORY;
    int code = job_end(j, status, work.gate.verdict == VERDICT_REFUSED && !accept);
    reconstruct_free(&work);
    if (tiles) rmdir(tiles);
    td_dataset_free(&dataset);
    free(tiles);
    return code;
}

int main(int argc, char **argv)
{
    job j;
    td_error error = {0};
    if (!team_start(&error)) {
        cli_complain(command.name, "%s", error.message);
        return EXIT_FAILED;
    }
    static char gate_text[2400] = GATE_HELP;
    gate_help(gate_text, sizeof gate_text, reconstruct_gate_defaults, reconstruct_gate_count);
    for (size_t i = 0; i < command.option_count; i++)
        if (options[i].target == &gates) options[i].help = gate_text;
    int code =
        job_begin(&j, &command, &common, reconstruct_schema, reconstruct_schema_count, true, argc, argv);
    return team_end(code >= 0 ? code : work_for(&j));
}
