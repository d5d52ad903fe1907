/* A scene: the ground as an elevation map, solid bodies on it, pictures (boards), a machine in a state. What
 * cameras are rendered from and motions are checked against. Frame "site": x forward or east, y left or
 * north, z up. */
#ifndef TELEDIMOS_CORE_SCENE_H
#define TELEDIMOS_CORE_SCENE_H

#include "elevation.h"
#include "image.h"
#include "robot.h"

#ifdef __cplusplus
extern "C" {
#endif

/* Reflectance of a surface: smooth random grain over position (sum of octaves of gradient noise, so that it
 * looks the same from every side and at every scale), or a picture. */
typedef struct td_surface {
    double albedo;   /* mean, 0 to 1 */
    double contrast; /* standard deviation of the grain, 0 to 1; 0: plain */
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

#ifdef __cplusplus
}
#endif
#endif
