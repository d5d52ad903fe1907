/* A machine on its ground: the world (sim/world.h) on a map, soil that is dug (sim/soil.h), stones, and the
 * check of a motion against what the map says (sim/clearance.h), behind one plant. What simulate, rehearse
 * and servo work in.
 *
 * Time. The world goes on in its own steps; before each the soil is given the bucket's place, updates at its
 * own rate, and its force acts on the bucket until the next update. While the bucket stands nearly still
 * between two updates the soil's resistance falls off with its speed, so that it does not push it back. */
#ifndef TELEDIMOS_APPS_STATION_H
#define TELEDIMOS_APPS_STATION_H

#include "core/plant.h"
#include "core/progress.h"
#include "sim/clearance.h"
#include "sim/soil.h"
#include "sim/world.h"

struct td_field;

enum { STATION_MAX_STONES = 64, STATION_PATH = 1100 };

/* What a scenario says of the ground:
 *
 *   ground: {map: site.tif}                       (a map that is there)
 *   ground: {site: ../site-dig, frames: 1..4, cell_m: 0.06, region_m: [-5, -9, 13, 9]}
 *                                                 (a scene: rendered into OUT/site, reconstructed into
 *                                                 OUT/map, and kept for the next run)
 *     soil: ../soils/loam.yaml                    (missing: nothing can be dug)
 *     sigma_m: 0.03                               (of heights whose own is not known)
 *     unseen_top_m: 0.5                           (unknown ground may be so high; missing: the highest known)
 *     stones: [{at_m: [5, 1, 0.3], radius_m: 0.2, density_kg_m3: 2600, friction: 0.6}] */
typedef struct station_ground {
    char map[STATION_PATH], site[STATION_PATH]; /* one of them; "": not that one */
    char frames[32];                            /* of the site; "": all */
    double cell_m, sigma_m, unseen_top_m;
    bool has_region;
    double region[4]; /* x0, y0, x1, y1 */
    bool has_soil;
    char soil_path[STATION_PATH];
    td_soil_preset soil;
    int stone_count;
    td_world_stone stone[STATION_MAX_STONES];
} station_ground;
/* `field`: the mapping; `folder`: where its files lie. */
td_status station_ground_read(station_ground *ground, const struct td_field *field, const char *folder,
                              td_error *error);
/* Its map: read, or made by the commands render and reconstruct, which keep what an earlier run of them made
 * of the same inputs. `output`: the folder for site and map. */
td_status station_ground_map(td_elevation **map, const station_ground *ground, const char *output,
                             int threads, const td_progress *progress, td_error *error);

typedef struct station station;
/* The machine settled on the map as it is at first. Copies what it is given, but for the robot, which is
 * lent. Refused by name: what td_world_new, td_world_reset and td_soil_new refuse; soil with a robot that has
 * no bucket we know. */
td_status station_new(station **s, const td_robot *robot, const td_machine_options *machine,
                      const td_plant_state *start, const td_elevation *map, const station_ground *ground,
                      td_error *error);
void station_free(station **s);
/* Back to how it was made: the map, the soil, the machine, the stones; the clock shows time_s. */
td_status station_restart(station *s, double time_s, td_error *error);
/* The same, but where `start` is, settled; `stays`: on the ground as it is now, which is that at first from
 * then on. */
td_status station_stand(station *s, const td_plant_state *start, bool stays, td_error *error);
/* The plant is lent: it lives as long as the station, and its free does nothing. */
td_plant station_plant(station *s);
/* What plans and checks of motions see in place of the ground as it is, which somebody only believes to know:
 * a map, and how sure the joints' zeros are (joints; NULL: quite). Map NULL: the ground as it is. */
td_status station_believe(station *s, const td_elevation *map, const double *sigma_zero, td_error *error);

td_status station_drive(station *s, double left_m_s, double right_m_s, td_error *error);
double station_half_gauge(const station *s);
double station_height(const station *s, double x, double y);
/* Where a stone lies by now; false: there is none of that number. */
bool station_stone(td_pose *site_from_stone, const station *s, int index);

/* The map as it is now; lent until the next call or step. */
td_status station_map(const td_elevation **map, station *s, td_error *error);
/* As plans are to see it: as it is believed, or is. Lent likewise. */
td_status station_seen(const td_elevation **map, station *s, td_error *error);
/* As it was when the station was made. */
const td_elevation *station_first_map(const station *s);
bool station_has_soil(const station *s);
td_soil_bucket station_bucket(const station *s);
int station_bucket_link(const station *s);
/* All zero where there is no soil. */
td_soil_state station_soil(const station *s);
double station_cutting_peak(const station *s); /* N, the largest since it was made */
double station_mass_error(const station *s);   /* kg: all the soil's mass now less that at first */

/* The motion from q to q of `samples` rows against the map as it is. `bucket_may_touch`: contact of what the
 * last joint moves is meant. `words` says why not. */
td_status station_check(bool *accepted, td_clearance *clearance, char *words, size_t size, station *s,
                        const double *time_s, const double *q, size_t samples, bool bucket_may_touch,
                        td_error *error);

#endif
