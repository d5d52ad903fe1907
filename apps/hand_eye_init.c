/* A hand-eye dataset to fill in. */
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <unistd.h>

#include "apps/hand_eye_internal.h"
#include "core/file.h"

static const char DESCRIPTION[] =
    "# A hand-eye dataset. Fill in, then: teledimos hand-eye THIS_FOLDER -o DIR\n"
    "name: my-robot\n"
    "setup: %s\n"
    "root: .                      # folder of images and poses\n"
    "target: {kind: chessboard, columns: 9, rows: 6, spacing_m: 0.025}\n"
    "cameras:\n"
    "  - {name: camera, model: brown5}\n"
    "# rig: rig.yaml              # the camera's calibration (OpenCV, ROS, Kalibr, ViSP, mrcal files too);\n"
    "#                            # without it, it is calibrated from the same images\n"
    "robot:\n"
    "  poses: poses.csv           # base_from_hand; a row for each frame, in their order\n"
    "  # convention: matrix       # rows of 16 numbers; visp: pose_%%d.yaml; ethz: t x y z qx qy qz qw\n"
    "  # inverted: true           # the file holds hand_from_base\n"
    "  # length_unit: mm\n"
    "  # angle_unit: deg\n";

static const char FRAMES[] = "frame,camera\n01,01.png\n02,02.png\n";

/* The columns' names say convention and unit. */
static const char POSES[] =
    "# base_from_hand. Other columns that are understood: rx_rad,ry_rad,rz_rad (rotation vector),\n"
    "# roll_deg,pitch_deg,yaw_deg (R = Rz Ry Rx), a_deg,b_deg,c_deg (KUKA); lengths in _m or _mm\n"
    "x_m,y_m,z_m,qw,qx,qy,qz\n"
    "0.400,0.100,0.500,1,0,0,0\n"
    "0.410,0.120,0.480,0.9689,0.2474,0,0\n";

static td_status write_new(const char *folder, const char *name, const char *text, td_error *error)
{
    char *path = td_path_join(folder, name);
    if (!path) return td_fail(error, TD_ERROR_MEMORY, "out of memory");
    td_status status =
        access(path, F_OK) == 0
            ? td_fail(error, TD_ERROR_ARGUMENT, "%s is there already; --init writes nothing over", path)
            : td_file_write(path, text, strlen(text), error);
    free(path);
    return status;
}

td_status hand_eye_init(const char *folder, td_hand_eye_setup setup, td_error *error)
{
    char description[sizeof DESCRIPTION + 32];
    snprintf(description, sizeof description, DESCRIPTION, td_hand_eye_setup_name(setup));
    TD_TRY(td_folder_make(folder, error));
    TD_TRY(write_new(folder, "dataset.yaml", description, error));
    TD_TRY(write_new(folder, "frames.csv", FRAMES, error));
    return write_new(folder, "poses.csv", POSES, error);
}
