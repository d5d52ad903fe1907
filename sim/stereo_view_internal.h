/* The parts of the ray caster. A ray is an origin (site, m) and a direction; distances along it are in units
 * of the direction's length, which is 1 wherever a distance leaves these rooms. */
#ifndef TELEDIMOS_SIM_STEREO_VIEW_INTERNAL_H
#define TELEDIMOS_SIM_STEREO_VIEW_INTERNAL_H

#include <stdbool.h>
#include <stdint.h>

#include "sim/stereo_view.h"

/* ---- the ground ---- */

enum { TD_GROUND_MAX_LEVELS = 32 };

/* Lowest and highest height of a square of patches; low > high where there is none. */
typedef struct td_span {
    float low, high;
} td_span;

/* A map as a surface of bilinear patches: patch (i, j) hangs between the cells (i, j) … (i+1, j+1). Level k
 * of the pyramid holds the spans of 2^k x 2^k patches, k = 1 … levels-1; those of level 0 are read from the
 * map. */
typedef struct td_ground_rays {
    const td_elevation *map;
    int levels, width[TD_GROUND_MAX_LEVELS], height[TD_GROUND_MAX_LEVELS];
    td_span *span[TD_GROUND_MAX_LEVELS]; /* (height,width); [0]: NULL */
} td_ground_rays;

td_status td_ground_rays_new(td_ground_rays *ground, const td_elevation *map, td_error *error);
void td_ground_rays_free(td_ground_rays *ground);
/* Brings the pyramid up to date after these cells have changed. */
void td_ground_rays_update(td_ground_rays *ground, int column, int row, int columns, int rows);
/* Distance of the first crossing of the surface in [clear, end), from above or below; `end` when there is
 * none. Before `clear` the ray is known to meet nothing: 0, or what td_ground_rays_clear says. */
double td_ground_rays_cast(const td_ground_rays *ground, const double origin[3], const double ray[3],
                           double clear, double end);
/* A distance, no less than `clear`, up to which these rays from one point all stay above the ground, when
 * they do up to `clear` (0: not known). The narrower their beam, the nearer the ground it is. */
double td_ground_rays_clear(const td_ground_rays *ground, const double origin[3], const double (*ray)[3],
                            int count, double clear);
/* Unit normal, upwards, above (x, y): of the slopes at the cells, by central differences, interpolated. */
void td_ground_rays_normal(const td_ground_rays *ground, double x, double y, double normal[3]);

/* ---- bodies ---- */

typedef enum td_body_kind { TD_BODY_TRIANGLE, TD_BODY_PRIMITIVE, TD_BODY_PICTURE } td_body_kind;

/* One thing with a surface, in the site. */
typedef struct td_body {
    td_body_kind kind;
    const td_surface *surface; /* NULL: a picture's */
    double low[3], high[3];    /* the box around it */
    union {
        struct {
            double corner[3], side[2][3],
                normal[3]; /* one corner, the ways to the others, outward unit normal */
            td_pose site_from_solid;
        } triangle;
        struct {
            td_primitive_kind kind;
            double size[3]; /* half lengths; or radius, half length; or radius */
            double rotation[9], centre[3];
        } primitive;
        struct {
            const td_scene_picture *picture;
            double corner[3], right[3], down[3], normal[3]; /* unit vectors */
        } picture;
    } of;
} td_body;

/* A node of a tree of boxes: its bodies are body[order[first … first+count)] when count > 0; else its
 * children are the node behind it and node `second`. */
typedef struct td_box_node {
    double low[3], high[3];
    uint32_t first, count, second;
} td_box_node;

typedef struct td_bodies {
    size_t count, capacity, node_count;
    td_body *body;
    uint32_t *order;
    td_box_node *node;
} td_bodies;

/* Appends what stands still (solids, pictures on no link) or what moves (the robot's shapes, pictures on its
 * links); then td_bodies_sort makes the tree. */
td_status td_bodies_add_fixed(td_bodies *bodies, const td_scene *scene, td_error *error);
td_status td_bodies_add_moving(td_bodies *bodies, const td_scene *scene, td_error *error);
td_status td_bodies_sort(td_bodies *bodies, td_error *error);
void td_bodies_free(td_bodies *bodies);
/* The bodies that the rays of a beam may meet, in the tree's order. */
enum { TD_BEAM_BODIES = 16 };
typedef struct td_beam {
    bool many; /* more than are listed: the tree is to be asked */
    int count;
    uint32_t body[TD_BEAM_BODIES];
} td_beam;
/* Unit rays from one point; those whose first number is NaN count for nothing. */
void td_bodies_in_beam(td_beam *beam, const td_bodies *bodies, const double origin[3], const double (*ray)[3],
                       int count);
/* Distance of the first body in [0, end) and its index; `end`, index untouched, when there is none. Solids
 * and pictures are seen from both sides, a robot's shape only from outside it. `beam` (may be NULL) has the
 * ray among its own, and changes nothing but the time. */
double td_bodies_cast(const td_bodies *bodies, const td_beam *beam, const double origin[3],
                      const double ray[3], double end, uint32_t *index);
/* At a point of its surface: unit normal (outward), the point in the body's own frame, and a number that
 * differs between its flat sides. For a picture `local` is x right, y down (m). */
int td_body_surface(const td_body *body, const double point[3], double normal[3], double local[3]);

/* ---- grain ---- */

enum { TD_GRAIN_BLOCK = 64 };

/* Reflectance at `count` <= TD_GRAIN_BLOCK points of a surface (its own frame, m), each seen with a pixel of
 * `footprint` m. */
void td_grain(float *reflectance, const td_surface *surface, const double *x, const double *y,
              const double *z, const float *footprint, int count);

/* ---- the object ---- */

/* Directions of a camera's pixels, made once. */
typedef struct td_view_rays {
    struct td_view_rays *next;
    td_camera camera;
    float (*ray)[3]; /* (height,width) unit, camera frame; NaN: the model has none */
} td_view_rays;

/* A picture in halves: [k] is 2^k times smaller; [0] is the picture's own. */
enum { TD_PICTURE_SIZES = 12 };
typedef struct td_picture_sizes {
    int count;
    td_image *image[TD_PICTURE_SIZES];
} td_picture_sizes;

struct td_stereo_view {
    const td_scene *scene;
    td_picture_sizes *sizes; /* (picture_count) */
    bool has_ground;
    td_ground_rays ground;
    td_bodies fixed, moving;
    struct td_view_cache *cache;
};

/* What a ray meets first. */
typedef struct td_hit {
    double distance; /* INFINITY: nothing */
    td_view_what what;
    const td_body *body; /* NULL: ground or sky */
} td_hit;
/* `beam` (may be NULL): fixed bodies, moving ones. `clear` as in td_ground_rays_cast. */
td_hit td_stereo_view_trace(const td_stereo_view *view, const td_beam *beam, const double origin[3],
                            const double ray[3], double clear);

enum { TD_SHADE_BLOCK = TD_GRAIN_BLOCK };
/* A block of rays from one point and what they see. */
typedef struct td_shaded {
    double ray[TD_SHADE_BLOCK][3];  /* in: unit, site */
    float light[TD_SHADE_BLOCK];    /* out: what comes back, 1: a white surface that faces the sun */
    float distance[TD_SHADE_BLOCK]; /* out: m; INFINITY */
    uint32_t side[TD_SHADE_BLOCK];  /* out: differs where the surface is another, or bends sharply */
    uint8_t what[TD_SHADE_BLOCK];   /* out: td_view_what */
} td_shaded;
/* `spread`: angle between neighbouring rays, rad. A direction of NaN sees nothing. */
void td_stereo_view_shade(const td_stereo_view *view, const double origin[3], double spread, int count,
                          td_shaded *shaded);

/* The camera's directions, from the view's cache, which lives as long as the view. */
td_status td_stereo_view_rays(const td_view_rays **rays, const td_stereo_view *view, const td_camera *camera,
                              int threads, td_error *error);

enum { TD_NORMAL_TABLE_SIZE = 4096 };
/* Quantiles of the standard normal distribution at (i + 1/2) / TD_NORMAL_TABLE_SIZE. */
const float *td_stereo_view_normals(const td_stereo_view *view);

#endif
