/* teledimos match, between its files: what was asked, and what was found. */
#ifndef TELEDIMOS_APPS_MATCH_INTERNAL_H
#define TELEDIMOS_APPS_MATCH_INTERNAL_H

#include "apps/gate.h"
#include "apps/job.h"
#include "core/cloud.h"
#include "core/elevation.h"
#include "recon/epipolar_gate.h"
#include "recon/match.h"
#include "recon/triangulation.h"

typedef enum match_mode { MATCH_AUTOMATIC, MATCH_GUIDED, MATCH_CHOSEN } match_mode;

/* One left point with its candidates, or the one match that stands. */
typedef struct match_point {
    char name[TD_NAME_SIZE];
    double left[2];
    td_match *candidate; /* (count) best first */
    size_t count;
    int chosen; /* of the candidates; -1: none */
    size_t row; /* of the table that names it */
} match_point;

typedef struct match_job {
    match_mode mode;
    const char *image_path[2], *rig_path, *points_path;
    td_image *image[2];
    td_rig *rig; /* corrected when that was asked for */
    td_pair pair;
    td_match_options options;
    match_point *point; /* (point_count) as given, or as found */
    size_t point_count;
    td_match_tally tally;
    bool has_gate, corrected;
    td_epipolar_gate epipolar;
    td_rig *offer; /* the rig with the rotation taken up; NULL: none is offered */
    /* Triangulated: of the points that have a choice, in their order. */
    size_t count;
    size_t *index; /* (count) which point */
    td_match *match;
    td_point3 *space; /* (count) in the map's frame */
    bool calibration_known;
    char frame[TD_NAME_SIZE]; /* "vehicle" or "rig" */
    double cell_m;            /* 0: from the points' spacing */
    double longest_m;         /* of a triangle's sides; 0: any */
    td_elevation *map;        /* NULL: too few points */
    uint32_t (*triangle)[3];
    size_t triangle_count;
    char map_remark[300]; /* why there is no map; "": there is one */
    gate_result gate;
} match_job;

extern const td_schema_row match_schema[];
extern const size_t match_schema_count;
extern const gate_row match_gate_defaults[];
extern const size_t match_gate_count;

/* CSV of left points (x_px, y_px, optional name), of candidates with picks, of finished matches. */
td_status match_points_read(match_job *m, td_error *error);
td_status match_choices_read(match_job *m, td_error *error);
td_status match_candidates_write(const match_job *m, const char *path, td_error *error);
td_status match_matches_write(const match_job *m, const char *path, td_error *error);

/* A place that a person chose, to a fraction of a pixel where the windows tell. */
void match_refine_choice(const match_job *m, td_match *choice);
/* Points in space in the map's frame, triangles and map; points.ply. */
td_status match_space(match_job *m, td_error *error);
td_status match_cloud_write(const match_job *m, const char *path, td_error *error);

void match_judge(match_job *m, const gate_row *rows);
json_t *match_result(const match_job *m);
void match_table(const void *found);
td_status match_report(const void *found, const char *path, td_error *error);

/* Turns a point and its covariances from the rig into the frame of the map. */
void match_to_frame(const match_job *m, td_point3 *p);
/* Standard deviation, m, along the worst direction of a covariance (3,3); NaN where it is not known. */
double match_sigma(const double covariance[9]);

#endif
