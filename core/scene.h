/* A scene: the ground as an elevation map, solid bodies on it, pictures (boards), a machine in a state. What
 * cameras are rendered from and motions are checked against. Frame "site": x forward or east, y left or
 * north, z up.
 *
 * scene.yaml (all but the first line, name, rig and frames may be missing; files beside it):
 *
 *   teledimos: scene 1
 *   name: my-site
 *   about: free text
 *   rig: rig.yaml
 *   frames: frames.csv
 *   target: {kind: chessboard, …}         # what the boards among the pictures are, for the dataset's users
 *   grounds:                              # one or several; frames.csv says which by its column `ground`
 *     - {name: before, map: site.tif}
 *     - name: after
 *       generate:
 *         columns: 400
 *         rows: 300
 *         cell_m: 0.05
 *         origin_m: [0, -7.5]
 *         seed: 1
 *         roughness_m: 0.08               # standard deviation of the heights
 *         scale_m: 4                      # size of the largest hills
 *         slope: [0.02, 0.0]
 *         rocks: {count: 60, size_m: [0.1, 0.5]}
 *         trench: {from_m: [6, 1], to_m: [9, 1], width_m: 0.9, depth_m: 0.8}
 *         mound: {at_m: [7, 3], radius_m: 1.2, height_m: 0.7}
 *   surface: {albedo: 0.35, contrast: 0.3, grain_m: 0.4, octaves: 8, seed: 1}     # of the ground
 *   solids:
 *     - {name: crate, box_m: [0.6, 0.4, 0.3], at_m: [4, 0], yaw_deg: 30}          # on the first ground
 *     - {name: ramp, wedge_m: [1, 0.5, 0.4], at_m: [5, 1, 0]}                     # highest at its +x end
 *     - {name: stone, rock_m: [0.5, 0.4, 0.3], seed: 4, at_m: [4, 2]}
 *     - {name: part, ply: part.ply, pose: {q: [1, 0, 0, 0], t_m: [0, 0, 0]}, surface: {…}}
 *   pictures:
 *     - {name: board, file: board.png, width_m: 0.4, link: arm, pose: {q: …, t_m: …}}
 *   robot: {urdf: zx200.urdf, surface: {…}}
 *   mount: {link: upper, pose: {q: …, t_m: …}}    # link_from_rig; no link: of the vehicle (the robot's
 * root); # default: the rig's vehicle_from_rig light: {azimuth_deg: 120, elevation_deg: 50, ambient: 0.3}
 *   image: {samples: 3, blur_px: 0.6, vignetting: 0.5, gain: 1, offset: 0, read_noise: 1, shot_noise: 0.02}
 *
 * frames.csv: columns x_m y_m z_m qw qx qy qz (site_from_vehicle; missing: identity), optional frame (name),
 * time_s, ground, and a column NAME_rad (prismatic: NAME_m) for each joint that moves (missing: 0). */
#ifndef TELEDIMOS_CORE_SCENE_H
#define TELEDIMOS_CORE_SCENE_H

#include <jansson.h>
#include <stddef.h>
#include <stdint.h>

#include "elevation.h"
#include "image.h"
#include "rig.h"
#include "robot.h"

#ifdef __cplusplus
extern "C" {
#endif

/* Reflectance of a surface: smooth random grain over position (sum of octaves of gradient noise, so that it
 * looks the same from every side and at every scale), or a picture. */
typedef struct td_surface {
    double albedo;   /* mean, 0 to 1 */
    double contrast; /* standard deviation of the grain, as a share of the mean, 0 to 1; 0: plain */
    double grain_m;  /* size of the coarsest grain */
    int octaves;     /* each half the size of the one before */
    uint64_t seed;
} td_surface;

/* A body with flat sides, stone or box: triangles, counter-clockwise seen from outside. */
typedef struct td_solid {
    char name[TD_NAME_SIZE];
    td_pose site_from_solid;
    size_t corner_count, triangle_count;
    double (*corner)[3]; /* m */
    uint32_t (*triangle)[3];
    td_surface surface;
} td_solid;

/* A flat picture, such as a printed board: x to its right, y down, z into it; origin at its upper left. */
typedef struct td_scene_picture {
    char name[TD_NAME_SIZE];
    td_pose site_from_picture; /* or from the link that carries it, when link >= 0 */
    int link;
    double width_m, height_m;
    td_image *image; /* grey */
} td_scene_picture;

typedef struct td_scene {
    td_elevation *ground; /* NULL: none */
    td_surface ground_surface;
    size_t solid_count, picture_count;
    td_solid *solid;
    td_scene_picture *picture;
    td_robot *robot; /* NULL: none */
    td_surface robot_surface;
    td_pose site_from_vehicle; /* of the robot's root link */
    double q[TD_ROBOT_MAX_JOINTS];
    double sun[3];  /* unit vector towards the sun */
    double ambient; /* share of light that comes from everywhere, 0 to 1 */
} td_scene;

/* How images are formed (sim/stereo_view.h says what of). */
typedef struct td_scene_image {
    int samples;
    double blur_px, vignetting, gain, offset, read_noise, shot_noise;
} td_scene_image;

typedef struct td_scene_ground {
    char name[TD_NAME_SIZE];
    td_elevation *map;
} td_scene_ground;

typedef struct td_scene_frame {
    char name[TD_NAME_SIZE];
    double time_s; /* NaN: not given */
    int ground;    /* -1: none */
    td_pose site_from_vehicle;
    double q[TD_ROBOT_MAX_JOINTS];
} td_scene_frame;

enum { TD_SCENE_MAX_GROUNDS = 16 };

/* A scene and what happens in it. */
typedef struct td_scene_file {
    char name[TD_NAME_SIZE];
    td_scene scene; /* with the first ground, in the first frame's state */
    int ground_count;
    td_scene_ground ground[TD_SCENE_MAX_GROUNDS];
    td_scene_image image;
    json_t *target; /* NULL: none */
    char *urdf;     /* path of the robot's file; NULL: none */
    td_rig *rig;
    int mount_link; /* -1: the vehicle */
    td_pose mount_from_rig;
    size_t frame_count;
    td_scene_frame *frame;
} td_scene_file;

/* Reads the scene and every file that it names. Everything is checked, sizes and numbers bounded. */
TD_API td_status td_scene_read(td_scene_file **file, const char *path, td_error *error);
/* From the text of scene.yaml and of frames.csv; files are looked for in `folder`. `folder` NULL: only checks
 * what can be without opening a file or making a ground: these are then missing. */
TD_API td_status td_scene_parse(td_scene_file **file, const char *yaml, size_t yaml_size, const char *csv,
                                size_t csv_size, const char *folder, td_error *error);
TD_API void td_scene_free(td_scene_file **file);

/* Puts the scene into a frame's state, and gives the rig's place in it. */
TD_API void td_scene_pose(td_scene_file *file, size_t frame, td_pose *site_from_rig);

#ifdef __cplusplus
}
#endif
#endif
