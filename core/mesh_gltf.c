/* Meshes as binary glTF 2.0: twelve bytes of head, a JSON chunk, a chunk of bytes. */
#include <jansson.h>
#include <math.h>
#include <stdlib.h>
#include <string.h>

#include "core/bytes_internal.h"
#include "core/file.h"
#include "core/mesh.h"

enum {
    MAGIC = 0x46546C67,
    JSON_CHUNK = 0x4E4F534A,
    BIN_CHUNK = 0x004E4942,
    FLOAT = 5126,
    UINT = 5125,
    ARRAY_BUFFER = 34962,
    INDEX_BUFFER = 34963,
    CLAMP = 33071,
    QUALITY = 90,
    VIEWS = 5
};
static const double ORIGIN_STEP_M = 1000;

typedef struct gltf {
    const td_cloud *mesh;
    const td_gltf_texture *texture;
    double origin[3];
    float *position, *normal, *uv; /* (count, 3), (count, 3), (count, 2) */
    uint8_t *jpeg;
    size_t jpeg_size;
    size_t at[VIEWS +
              1]; /* where each view begins in the bytes: positions, normals, uv, indices, texture, end */
} gltf;

static size_t padded(size_t size)
{
    return (size + 3) / 4 * 4;
}

/* ---- numbers ---- */

static void find_origin(gltf *g)
{
    for (int k = 0; k < 3; k++) {
        double low = INFINITY, high = -INFINITY;
        for (size_t i = 0; i < g->mesh->count; i++) {
            low = fmin(low, g->mesh->point[i].p[k]);
            high = fmax(high, g->mesh->point[i].p[k]);
        }
        g->origin[k] = ORIGIN_STEP_M * round((low + high) / 2 / ORIGIN_STEP_M);
    }
}

/* z up to y up. */
static void turn(float out[3], const double v[3])
{
    out[0] = (float)v[0];
    out[1] = (float)v[2];
    out[2] = (float)-v[1];
}

/* Sums of the triangles' normals, each as long as its triangle is large. */
static bool sum_normals(double (*sum)[3], const td_cloud *mesh)
{
    for (size_t i = 0; i < mesh->triangle_count; i++) {
        const uint32_t *t = mesh->triangle[i];
        double a[3], b[3];
        if (t[0] >= mesh->count || t[1] >= mesh->count || t[2] >= mesh->count) return false;
        for (int k = 0; k < 3; k++) {
            a[k] = mesh->point[t[1]].p[k] - mesh->point[t[0]].p[k];
            b[k] = mesh->point[t[2]].p[k] - mesh->point[t[0]].p[k];
        }
        for (int c = 0; c < 3; c++)
            for (int k = 0; k < 3; k++)
                sum[t[c]][k] += a[(k + 1) % 3] * b[(k + 2) % 3] - a[(k + 2) % 3] * b[(k + 1) % 3];
    }
    return true;
}

static void fill(gltf *g, double (*normal)[3])
{
    const td_gltf_texture *t = g->texture;
    for (size_t i = 0; i < g->mesh->count; i++) {
        const double *p = g->mesh->point[i].p, *n = normal[i];
        const double length = sqrt(n[0] * n[0] + n[1] * n[1] + n[2] * n[2]);
        const double moved[3] = {p[0] - g->origin[0], p[1] - g->origin[1], p[2] - g->origin[2]};
        const double up[3] = {0, 0, 1}, one[3] = {n[0] / length, n[1] / length, n[2] / length};
        turn(g->position + 3 * i, moved);
        turn(g->normal + 3 * i, length > 0 ? one : up);
        g->uv[2 * i] = (float)((p[0] - t->low[0]) / (t->high[0] - t->low[0]));
        g->uv[2 * i + 1] = (float)((t->high[1] - p[1]) / (t->high[1] - t->low[1]));
    }
}

static td_status make(gltf *g, const char *path, td_error *error)
{
    const size_t n = g->mesh->count;
    for (size_t i = 0; i < n; i++)
        for (int k = 0; k < 3; k++)
            if (!isfinite(g->mesh->point[i].p[k]))
                return td_fail(error, TD_ERROR_ARGUMENT, "%s: vertex %zu is not finite", path, i);
    double(*normal)[3] = calloc(n + 1, sizeof *normal);
    g->position = malloc((n + 1) * 3 * sizeof *g->position);
    g->normal = malloc((n + 1) * 3 * sizeof *g->normal);
    g->uv = malloc((n + 1) * 2 * sizeof *g->uv);
    td_status status = TD_OK;
    if (!normal || !g->position || !g->normal || !g->uv)
        status = td_fail(error, TD_ERROR_MEMORY, "%s: no memory for %zu vertices", path, n);
    else if (!sum_normals(normal, g->mesh))
        status = td_fail(error, TD_ERROR_ARGUMENT, "%s: a triangle has a corner that is no vertex", path);
    if (status == TD_OK) {
        find_origin(g);
        fill(g, normal);
        status = td_image_encode_jpeg(&g->jpeg, &g->jpeg_size, g->texture->image, QUALITY, error);
    }
    free(normal);
    const size_t size[VIEWS] = {12 * n, 12 * n, 8 * n, 12 * g->mesh->triangle_count, g->jpeg_size};
    for (int i = 0; i < VIEWS; i++) g->at[i + 1] = g->at[i] + padded(size[i]);
    return status;
}

/* ---- JSON ---- */

static json_t *view_json(const gltf *g, int index, int target)
{
    const size_t size = index == VIEWS - 1 ? g->jpeg_size : g->at[index + 1] - g->at[index];
    json_t *o = json_pack("{s:i, s:I, s:I}", "buffer", 0, "byteOffset", (json_int_t)g->at[index],
                          "byteLength", (json_int_t)size);
    if (target) json_object_set_new(o, "target", json_integer(target));
    return o;
}

static json_t *accessor_json(int view, int type, size_t count, const char *shape)
{
    return json_pack("{s:i, s:i, s:I, s:s}", "bufferView", view, "componentType", type, "count",
                     (json_int_t)count, "type", shape);
}

/* The format asks for the positions' bounds. */
static json_t *positions_json(const gltf *g)
{
    json_t *o = accessor_json(0, FLOAT, g->mesh->count, "VEC3"), *least = json_array(), *most = json_array();
    for (size_t k = 0; k < 3; k++) {
        float low = INFINITY, high = -INFINITY;
        for (size_t i = 0; i < g->mesh->count; i++) {
            low = fminf(low, g->position[3 * i + k]);
            high = fmaxf(high, g->position[3 * i + k]);
        }
        json_array_append_new(least, json_real((double)low));
        json_array_append_new(most, json_real((double)high));
    }
    json_object_set_new(o, "min", least);
    json_object_set_new(o, "max", most);
    return o;
}

static json_t *extras_json(const gltf *g)
{
    json_t *o = json_pack("{s:s, s:[f,f,f], s:s}", "frame", g->texture->frame, "origin_m", g->origin[0],
                          g->origin[1], g->origin[2], "axes",
                          "here (X, Y, Z) is (x - ox, z - oz, -(y - oy)) of the frame, whose z is up");
    if (g->texture->crs) json_object_set_new(o, "crs", json_string(g->texture->crs));
    return o;
}

static json_t *document(const gltf *g)
{
    return json_pack(
        "{s:{s:s, s:s}, s:i, s:[{s:[i]}], s:[{s:s, s:i, s:o}],"
        " s:[{s:[{s:{s:i, s:i, s:i}, s:i, s:i}]}],"
        " s:[{s:s, s:{s:{s:i}, s:i, s:i}, s:b}], s:[{s:i, s:i}], s:[{s:i, s:i}], s:[{s:i, s:s}],"
        " s:[o, o, o, o], s:[o, o, o, o, o], s:[{s:I}]}",
        "asset", "version", "2.0", "generator", "Teledimos", "scene", 0, "scenes", "nodes", 0, "nodes",
        "name", "site", "mesh", 0, "extras", extras_json(g), "meshes", "primitives", "attributes", "POSITION",
        0, "NORMAL", 1, "TEXCOORD_0", 2, "indices", 3, "material", 0, "materials", "name", "orthophoto",
        "pbrMetallicRoughness", "baseColorTexture", "index", 0, "metallicFactor", 0, "roughnessFactor", 1,
        "doubleSided", 1, "textures", "sampler", 0, "source", 0, "samplers", "wrapS", CLAMP, "wrapT", CLAMP,
        "images", "bufferView", 4, "mimeType", "image/jpeg", "accessors", positions_json(g),
        accessor_json(1, FLOAT, g->mesh->count, "VEC3"), accessor_json(2, FLOAT, g->mesh->count, "VEC2"),
        accessor_json(3, UINT, 3 * g->mesh->triangle_count, "SCALAR"), "bufferViews",
        view_json(g, 0, ARRAY_BUFFER), view_json(g, 1, ARRAY_BUFFER), view_json(g, 2, ARRAY_BUFFER),
        view_json(g, 3, INDEX_BUFFER), view_json(g, 4, 0), "buffers", "byteLength", (json_int_t)g->at[VIEWS]);
}

/* ---- bytes ---- */

static void put_floats(unsigned char **at, const float *value, size_t count)
{
    for (size_t i = 0; i < count; i++) td_put_float(at, value[i]);
}

static td_status write(const gltf *g, const char *json, const char *path, td_error *error)
{
    const size_t text = strlen(json), n = g->mesh->count;
    const size_t size = 12 + 8 + padded(text) + 8 + g->at[VIEWS];
    unsigned char *bytes = size <= UINT32_MAX ? calloc(size, 1) : NULL, *at = bytes;
    if (!bytes)
        return td_fail(error, TD_ERROR_MEMORY, "%s: %zu bytes are more than memory or the format has", path,
                       size);
    td_put(&at, MAGIC, 4);
    td_put(&at, 2, 4);
    td_put(&at, size, 4);
    td_put(&at, padded(text), 4);
    td_put(&at, JSON_CHUNK, 4);
    memset(at, ' ', padded(text));
    memcpy(at, json, text);
    at += padded(text);
    td_put(&at, g->at[VIEWS], 4);
    td_put(&at, BIN_CHUNK, 4);
    put_floats(&at, g->position, 3 * n);
    put_floats(&at, g->normal, 3 * n);
    put_floats(&at, g->uv, 2 * n);
    for (size_t i = 0; i < g->mesh->triangle_count; i++)
        for (int k = 0; k < 3; k++) td_put(&at, g->mesh->triangle[i][k], 4);
    memcpy(at, g->jpeg, g->jpeg_size);
    td_status status = td_file_write(path, bytes, size, error);
    free(bytes);
    return status;
}

td_status td_mesh_write_gltf(const td_cloud *mesh, const td_gltf_texture *texture, const char *path,
                             td_error *error)
{
    gltf g = {.mesh = mesh, .texture = texture};
    if (mesh->triangle_count == 0)
        return td_fail(error, TD_ERROR_ARGUMENT, "%s: the mesh has no triangle", path);
    if (!(texture->high[0] > texture->low[0] && texture->high[1] > texture->low[1]))
        return td_fail(error, TD_ERROR_ARGUMENT, "%s: the texture has no extent", path);
    td_status status = make(&g, path, error);
    if (status == TD_OK) {
        json_t *root = document(&g);
        char *json = root ? json_dumps(root, JSON_COMPACT) : NULL;
        status = json ? write(&g, json, path, error) : td_fail(error, TD_ERROR_MEMORY, "%s: no memory", path);
        free(json);
        json_decref(root);
    }
    free(g.position);
    free(g.normal);
    free(g.uv);
    free(g.jpeg);
    return status;
}
