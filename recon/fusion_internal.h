/* What the files of the fusion share. */
#ifndef TELEDIMOS_RECON_FUSION_INTERNAL_H
#define TELEDIMOS_RECON_FUSION_INTERNAL_H

#include <stdio.h>

#include "depth_points_internal.h"
#include "fusion.h"

enum { TD_TILE_SIDE = 128, TD_TILE_CELLS = TD_TILE_SIDE * TD_TILE_SIDE };

/* ---- a cell: fusion_cell.c ---- */

typedef struct td_estimate {
    float height;   /* m above the tile's base */
    float noise;    /* m^2 */
    float common;   /* m, standard deviation by the calibration */
    float share;    /* weight in `height` of the measurements from `place` */
    uint32_t place; /* where the last measurement was taken from */
    uint32_t count; /* points */
} td_estimate;

/* All zero: not known. */
typedef struct td_cell {
    td_estimate now, rival; /* rival: what contradicts it */
    double time_s;
    uint8_t provenance;
    uint8_t rival_frames;  /* that say so, one after another */
    uint8_t passed_frames; /* that looked through the cell, one after another */
    uint8_t rival_whole;   /* 1: one of those saw the cell well */
    uint8_t spare[4];
} td_cell;
_Static_assert(sizeof(td_cell) == 64, "cells are stored as they are");

typedef struct td_measure {
    double height;   /* m above the tile's base */
    double noise;    /* m^2 */
    double repeated; /* m^2, of it: the same in every frame from this place */
    double anywhere; /* m^2, of it: the same in every frame */
    double common;   /* m */
    uint32_t place, count;
    double time_s;
    bool in_part; /* most of the cell is hidden */
} td_measure;

typedef enum td_cell_outcome {
    TD_CELL_NEW,
    TD_CELL_AGREES,
    TD_CELL_GATED,
    TD_CELL_RESET,
    TD_CELL_IGNORED
} td_cell_outcome;

td_cell_outcome td_cell_measure(td_cell *cell, const td_measure *m, const td_fusion_options *options);
/* Looked through by one frame more; true: cleared. */
bool td_cell_pass(td_cell *cell, const td_fusion_options *options);
double td_cell_sigma(const td_cell *cell);
/* Share of the variance of one of n pixels' errors that is left in their mean: the errors are white noise
 * averaged over squares of `correlation` px, the pixels a square. */
double td_mean_variance(double n, double correlation);
/* False: no state that the filter can come to. */
bool td_cell_sound(const td_cell *cell, const td_fusion_options *options);

/* ---- tiles: fusion_tiles.c ---- */

typedef struct td_tile {
    int32_t x, y;  /* cells x … x + 127 times 128 */
    double base;   /* m, a whole number */
    td_cell *cell; /* (128,128), rows in y; NULL: in the folder */
    bool stored;   /* the folder holds a state of it, the last one unless it is in memory */
    uint64_t used;
} td_tile;

struct td_fusion {
    td_fusion_options options; /* folder is owned */
    char *crs;
    int32_t bounds[4]; /* first and last cell in x and in y */
    td_tile **tile;    /* (tile_count), by y, then x */
    size_t tile_count, tile_room, resident, capacity;
    uint64_t clock;
    uint64_t frames;
    uint32_t place; /* number of the place; 0: none yet */
    td_pose place_pose;
};

/* NULL: not there. */
td_tile *td_tiles_find(const td_fusion *fusion, int32_t x, int32_t y);
/* Makes the tile when it is not there, in the folder's care until fetched. */
td_status td_tiles_make(td_tile **tile, td_fusion *fusion, int32_t x, int32_t y, double base,
                        td_error *error);
/* Refuses, before anything is changed, when so many tiles more would not fit. */
td_status td_tiles_check_room(const td_fusion *fusion, size_t more, td_error *error);
/* Brings `count` tiles (at most the capacity) into memory, to be changed. */
td_status td_tiles_fetch(td_fusion *fusion, td_tile *const *tile, size_t count, td_error *error);
/* A tile's cells without bringing it in: its own, or `scratch` (128,128) filled. */
td_status td_tiles_peek(const td_cell **cell, td_cell *scratch, const td_fusion *fusion, const td_tile *tile,
                        td_error *error);
void td_tiles_free(td_fusion *fusion);

/* ---- bytes of a tile: fusion_file.c ---- */

enum { TD_TILE_HEAD_BYTES = 24, TD_TILE_MAP_BYTES = TD_TILE_CELLS / 8 };
#define TD_TILE_MOST_BYTES (TD_TILE_HEAD_BYTES + TD_TILE_MAP_BYTES + TD_TILE_CELLS * sizeof(td_cell))
size_t td_tile_pack(unsigned char *bytes, const td_tile *tile, const td_cell *cell);
/* Reads one tile's bytes; false: damaged, or it ended. */
bool td_tile_unpack(td_tile *tile, td_cell *cell, FILE *file, const td_fusion_options *options);
/* What td_fusion_load does once the file is open. */
td_status td_fusion_load_stream(td_fusion **fusion, const td_fusion_options *options, FILE *file,
                                const char *name, td_error *error);

/* ---- a frame: fusion_edge.c, fusion_relief.c, fusion_points.c, fusion_measure.c ---- */

typedef struct td_frame_point {
    float x, y, z; /* m: from its cell's centre; above the camera */
    float weight;  /* 1/m^2: 1 / variance of its depth */
    float edge;    /* m^2: variance of its depth besides, for edges near */
    uint32_t cell; /* in its tile */
} td_frame_point;

/* Points that follow one another in a row of pixels and lie in one tile. */
typedef struct td_frame_run {
    const td_frame_point *point;
    size_t count;
} td_frame_run;

/* What a frame's points say of a cell. */
typedef struct td_frame_cell {
    double weight, weight2, x, y, z; /* sums; x, y, z weighted, then their means */
    double residual;                 /* m^2, weighted sum of squares off the plane */
    double slope[2], slope_variance; /* of each */
    double relief;                   /* m^2, of the cells around off their plane, beyond matching's noise */
    double edge;                     /* m^2: weighted mean of the points' */
    double smear; /* m^2: variance of the heights around, where no surface can be; else 0 */
    uint32_t count;
    uint16_t cell;
} td_frame_cell;

typedef struct td_frame_tile {
    int32_t x, y;
    const td_frame_run *run; /* (runs) its points, in the order of the pixels */
    size_t runs, points;
    td_frame_cell *cell; /* (cells) in the order they were met */
    size_t cells;
    uint16_t *slot;      /* (128,128) index in `cell` + 1; 0: nothing */
    td_measure *measure; /* (cells); height is above the camera until it is applied; count 0: outside of the
                            map */
} td_frame_tile;

/* A frame's rows are worked on in so many parts, whatever the threads are. */
enum { TD_FRAME_STRIPS = 16 };

typedef struct td_frame_cells {
    const td_fusion *fusion;
    const td_fusion_frame *frame;
    int threads;
    uint32_t place;
    td_pose site_from_camera; /* the rectified left camera */
    double to_site[9], rig_from_site[9];
    int32_t box[4]; /* first and last tile in x and in y */
    int32_t *at;    /* (box) index in `tile`; -1: none */
    td_frame_tile *tile;
    size_t tile_count;
    td_frame_run *run;                      /* by tile */
    td_frame_point *point[TD_FRAME_STRIPS]; /* in the order of the pixels */
    size_t point_count;
    float *edge;   /* (height,width) of td_frame_edges, while the points are sorted */
    float *relief; /* blocks of td_frame_relief, as long */
} td_frame_cells;

/* Standard deviation, px, that edges near a pixel give its disparity besides its sigma: (height,width). */
td_status td_frame_edges(float **edge, const td_disparity *disparity, int threads, td_error *error);
/* Standard deviation, px, of the disparities around off their plane, one for each block of TD_RELIEF_BLOCK x
 * TD_RELIEF_BLOCK px, those at the right and lower border begun. */
enum { TD_RELIEF_BLOCK = 4 };
td_status td_frame_relief(float **relief, const td_disparity *disparity, int threads, td_error *error);
td_status td_frame_sort(td_frame_cells *cells, td_error *error);
td_status td_frame_measure(td_frame_cells *cells, td_error *error);
void td_frame_free(td_frame_cells *cells);

/* ---- visibility: fusion_visibility.c ---- */

/* Cells of the tile that the frame did not measure and looked through; how many were cleared. */
size_t td_frame_look_through(td_cell *cell, const td_tile *tile, const td_frame_tile *measured,
                             const td_frame_cells *frame);

/* Variance, m^2, that the frame's pose gives the height at `p` (site, m) of ground whose normal is along
 * `up`. */
double td_frame_pose_variance(const td_frame_cells *frame, const double p[3], const double up[3]);

#endif
