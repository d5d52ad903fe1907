/* Our nouns as messages that Foxglove shows: JSON by Foxglove's schemas
 * (https://docs.foxglove.dev/docs/sdk/schemas), for recordings (mcap.h) and live.
 *
 * Frames are named after the links of the robot; the ground's frame ("site") is their root. *json ends in a
 * 0, is *size bytes long without it, and is to be freed with free(). Numbers carry 12 digits. Refused, naming
 * the field: numbers that are not finite, texts that are not UTF-8. */
#ifndef TELEDIMOS_CORE_FOXGLOVE_H
#define TELEDIMOS_CORE_FOXGLOVE_H

#include <stddef.h>
#include <stdint.h>

#include "cloud.h"
#include "elevation.h"
#include "log.h"
#include "mcap.h"
#include "plant.h"
#include "pose.h"
#include "robot.h"

#ifdef __cplusplus
extern "C" {
#endif

typedef enum td_foxglove_kind {
    TD_FOXGLOVE_TRANSFORMS, /* foxglove.FrameTransforms */
    TD_FOXGLOVE_POSE,       /* foxglove.PoseInFrame */
    TD_FOXGLOVE_SCENE,      /* foxglove.SceneUpdate */
    TD_FOXGLOVE_GRID,       /* foxglove.Grid */
    TD_FOXGLOVE_LOG,        /* foxglove.Log */
    TD_FOXGLOVE_IMAGE,      /* foxglove.CompressedImage */
    TD_FOXGLOVE_CLOUD,      /* foxglove.PointCloud */
    TD_FOXGLOVE_JOINTS, /* teledimos.JointStates: our own, for plots: /joints.joints[:]{name=="boom"}.position
                         */
    TD_FOXGLOVE_KIND_COUNT
} td_foxglove_kind;

/* A channel for messages of a kind, with its JSON schema. */
TD_API td_mcap_channel td_foxglove_channel(td_foxglove_kind kind, const char *topic);

/* parent_from_link of every link at q, and of the root link in the frame `ground` where site_from_vehicle is
 * not NULL. */
TD_API td_status td_foxglove_transforms(char **json, size_t *size, const td_robot *robot, const double *q,
                                        const char *ground, const td_pose *site_from_vehicle,
                                        uint64_t time_ns, td_error *error);
TD_API td_status td_foxglove_pose(char **json, size_t *size, const td_pose *frame_from_object,
                                  const char *frame, uint64_t time_ns, td_error *error);
/* The robot's shapes, an entity a link, in the links' frames: sent once, the transforms move them. A capsule
 * is a cylinder with a sphere at each end. rgba 0 … 1. */
TD_API td_status td_foxglove_machine(char **json, size_t *size, const td_robot *robot, const double rgba[4],
                                     uint64_t time_ns, td_error *error);
/* Height and sigma, 32-bit reals (NaN: unknown), and td_provenance, a byte, in the map's frame. At most
 * TD_FOXGLOVE_MAX_CELLS. */
enum { TD_FOXGLOVE_MAX_CELLS = 1 << 24 };
TD_API td_status td_foxglove_grid(char **json, size_t *size, const td_elevation *map, uint64_t time_ns,
                                  td_error *error);
TD_API td_status td_foxglove_log(char **json, size_t *size, td_log_level level, const char *topic,
                                 const char *text, uint64_t time_ns, td_error *error);
/* An image already encoded; format "png" or "jpeg". */
TD_API td_status td_foxglove_image(char **json, size_t *size, const void *bytes, size_t byte_count,
                                   const char *format, const char *frame, uint64_t time_ns, td_error *error);
/* x, y, z and sigma as 32-bit reals from the cloud's first point, which is the message's pose; red, green,
 * blue, alpha. At most TD_FOXGLOVE_MAX_POINTS. */
enum { TD_FOXGLOVE_MAX_POINTS = 1 << 22 };
TD_API td_status td_foxglove_cloud(char **json, size_t *size, const td_cloud *cloud, const char *frame,
                                   uint64_t time_ns, td_error *error);
/* Name, position, rate and force of each joint. */
TD_API td_status td_foxglove_joints(char **json, size_t *size, const td_robot *robot,
                                    const td_plant_state *state, uint64_t time_ns, td_error *error);

#ifdef __cplusplus
}
#endif
#endif
