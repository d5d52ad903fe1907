/* What a soil is like: its preset, read from YAML, each figure with its source.
 *
 *   teledimos: soil 1
 *   name: dirt_1
 *   about: free text
 *   figures:
 *     density_kg_m3: {value: 1474, source: "…", range: [1300, 1600]}   # of the bank: undisturbed ground
 *     swell: {value: 1.28, source: "…"}              # volume when dug, over that of the bank
 *     cohesion_pa: {value: 2100, source: "…"}
 *     adhesion_pa: {value: 0, source: "…"}           # to the tool
 *     friction_deg: {value: 40, source: "…"}         # angle of internal friction
 *     tool_friction: {value: 0.417, source: "…"}     # coefficient against steel: tan of the angle delta
 *     repose_deg: {value: 40, source: "…"}           # the slope at which dumped soil comes to rest
 *
 * `range` (may be missing) is what the source gives; the value must be in it. */
#ifndef TELEDIMOS_SIM_SOIL_PRESET_H
#define TELEDIMOS_SIM_SOIL_PRESET_H

#include <stddef.h>

#include "../core/rig.h"
#include "../core/status.h"

#ifdef __cplusplus
extern "C" {
#endif

typedef struct td_soil_preset {
    char name[TD_NAME_SIZE];
    double density_kg_m3; /* of the bank */
    double swell;         /* loose soil has density_kg_m3 / swell */
    double cohesion_pa, adhesion_pa;
    double friction_rad, tool_friction_rad, repose_rad;
} td_soil_preset;

/* Refused, naming file and field: what is missing, unknown, without a source, out of its range or of any
 * soil's, friction with the tool above the soil's own, adhesion above cohesion. */
TD_API td_status td_soil_preset_read(td_soil_preset *preset, const char *path, td_error *error);
TD_API td_status td_soil_preset_parse(td_soil_preset *preset, const char *text, size_t size, const char *name,
                                      td_error *error);
/* The same bounds, for a preset made by a program. */
TD_API td_status td_soil_preset_check(const td_soil_preset *preset, td_error *error);

#ifdef __cplusplus
}
#endif
#endif
