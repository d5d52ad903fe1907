/* A camera-to-vehicle dataset to fill in. */
#include <stdlib.h>
#include <string.h>
#include <unistd.h>

#include "apps/vehicle_internal.h"
#include "core/file.h"

static const char DESCRIPTION[] =
    "# A camera-to-vehicle dataset. Fill in, then: teledimos vehicle THIS_FOLDER -o DIR\n"
    "name: my-machine\n"
    "rig: rig.yaml                # the cameras, as teledimos calibrate wrote them\n"
    "robot:\n"
    "  urdf: machine.urdf         # its links and joints; machine.yaml beside it: its cylinders\n"
    "  joints: angles.csv         # what the joints' sensors said in each frame\n"
    "  mount: upper               # link that carries the cameras\n"
    "  # vehicle: undercarriage   # link whose frame is the vehicle's; default: the mount\n"
    "  # tip: bucket_tip          # link whose origin is the tool's tip; default: the last one\n"
    "  sigma_deg: 0.05            # of one reading; or {boom: 0.05, arm: 0.1}\n"
    "# Six points or more on a link of the arm, not on a line, measured in the link's frame.\n"
    "points:\n"
    "  - {name: p1, link: arm, place_m: [0.35, 0.25, 0.10], sigma_m: 0.001}\n"
    "  - {name: p2, link: arm, place_m: [1.20, -0.25, -0.05], sigma_m: 0.001}\n"
    "  - {name: p3, link: arm, place_m: [2.50, null, 0.25], sigma_m: 0.001}    # null: unknown\n"
    "sights: sights.csv           # where each camera sees them\n"
    "sigma_px: 0.5                # how well they were found\n"
    "# Or a board on the arm (or on the ground: the robot's root), found in images that frames.csv names:\n"
    "# boards:\n"
    "#   - {name: plate, link: arm, target: {kind: aprilgrid, columns: 4, rows: 3, tag_size_m: 0.12,\n"
    "#      spacing_m: 0.156}}\n"
    "# cameras: [{name: left, model: brown5}, {name: right, model: brown5}]\n";

static const char ANGLES[] =
    "# A column a joint: NAME_deg or NAME_rad (NAME_m, NAME_mm where it slides), or\n"
    "# the length of its cylinder: NAME_cylinder_m\n"
    "frame,swing_deg,boom_deg,arm_deg,bucket_deg\n"
    "01,0.0,-35.20,95.10,20.00\n"
    "02,0.0,-20.75,110.40,35.00\n";

static const char SIGHTS[] = "frame,camera,point,x_px,y_px\n"
                             "01,left,p1,612.40,388.15\n"
                             "01,right,p1,548.02,391.77\n";

static td_status check_new(const char *folder, const char *name, td_error *error)
{
    char *path = td_path_join(folder, name);
    if (!path) return td_fail(error, TD_ERROR_MEMORY, "out of memory");
    td_status status =
        access(path, F_OK) == 0
            ? td_fail(error, TD_ERROR_ARGUMENT, "%s is there already; --init writes nothing over", path)
            : TD_OK;
    free(path);
    return status;
}

static td_status write_file(const char *folder, const char *name, const char *text, td_error *error)
{
    char *path = td_path_join(folder, name);
    if (!path) return td_fail(error, TD_ERROR_MEMORY, "out of memory");
    td_status status = td_file_write(path, text, strlen(text), error);
    free(path);
    return status;
}

td_status vehicle_init(const char *folder, td_error *error)
{
    static const char *const name[] = {"dataset.yaml", "angles.csv", "sights.csv"};
    const char *const text[] = {DESCRIPTION, ANGLES, SIGHTS};
    TD_TRY(td_folder_make(folder, error));
    for (int i = 0; i < 3; i++) TD_TRY(check_new(folder, name[i], error));
    for (int i = 0; i < 3; i++) TD_TRY(write_file(folder, name[i], text[i], error));
    return TD_OK;
}
