/* Reading PLY (Turk 1994): a header that declares elements and their properties, then the values, as text or
 * in either byte order. Nothing the header says is believed beyond the bytes that are there. */
#include <ctype.h>
#include <math.h>
#include <stdbool.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "core/cloud.h"
#include "core/file.h"
#include "core/number.h"
#include "core/text_internal.h"

enum { MAX_ELEMENTS = 16, MAX_PROPERTIES = 128, MAX_LINE = 1024, TOKEN = 64 };
static const size_t MAX_BYTES = (size_t)1 << 33;

typedef enum kind { INT8, UINT8, INT16, UINT16, INT32, UINT32, FLOAT32, FLOAT64, KINDS } kind;

static const struct {
    const char *name, *other;
    int size;
} kinds[KINDS] = {{"char", "int8", 1},     {"uchar", "uint8", 1},   {"short", "int16", 2},
                  {"ushort", "uint16", 2}, {"int", "int32", 4},     {"uint", "uint32", 4},
                  {"float", "float32", 4}, {"double", "float64", 8}};

/* What a property is to a cloud. */
typedef enum role { NONE, X, Y, Z, RED, GREEN, BLUE, SIGMA, CORNERS } role;

typedef struct property {
    kind kind, length; /* length: of a list's count */
    bool list;
    role role;
} property;

typedef struct element {
    char name[TOKEN];
    size_t count;
    int first, properties; /* in ply.property */
} element;

typedef enum layout { ASCII, LITTLE, BIG } layout;

typedef struct ply {
    const char *path;
    const unsigned char *at, *end;
    size_t line; /* of the header, and of ASCII values */
    layout layout;
    int elements, properties;
    element element[MAX_ELEMENTS];
    property property[MAX_PROPERTIES];
} ply;

/* ---- the header ---- */

static td_status header_fails(const ply *f, td_error *error, const char *what, const char *seen)
{
    char shown[TD_SHOWN_SIZE];
    return td_fail(error, TD_ERROR_FORMAT, "%s:%zu: %s: '%s'", f->path, f->line, what,
                   td_text_shown(shown, seen));
}

/* The next line of the header without its end; false: there is none, or it is too long. */
static bool next_line(char line[MAX_LINE], ply *f)
{
    size_t length = 0;
    f->line++;
    while (f->at < f->end && *f->at != '\n' && length < MAX_LINE - 1) line[length++] = (char)*f->at++;
    if (f->at == f->end || *f->at != '\n') return false;
    f->at++;
    if (length && line[length - 1] == '\r') length--;
    line[length] = 0;
    return strlen(line) == length;
}

static bool kind_named(kind *found, const char *name)
{
    for (int i = 0; i < KINDS; i++)
        if (!strcmp(name, kinds[i].name) || !strcmp(name, kinds[i].other)) {
            *found = (kind)i;
            return true;
        }
    return false;
}

static role role_of(const element *e, const property *p, const char *name)
{
    static const struct {
        const char *name;
        role role;
    } roles[] = {{"x", X},
                 {"y", Y},
                 {"z", Z},
                 {"red", RED},
                 {"green", GREEN},
                 {"blue", BLUE},
                 {"r", RED},
                 {"g", GREEN},
                 {"b", BLUE},
                 {"diffuse_red", RED},
                 {"diffuse_green", GREEN},
                 {"diffuse_blue", BLUE},
                 {"sigma", SIGMA}};
    if (!strcmp(e->name, "face") && p->list)
        return !strcmp(name, "vertex_indices") || !strcmp(name, "vertex_index") ? CORNERS : NONE;
    for (size_t i = 0; !strcmp(e->name, "vertex") && !p->list && i < sizeof roles / sizeof *roles; i++)
        if (!strcmp(name, roles[i].name)) return roles[i].role;
    return NONE;
}

static td_status read_property(ply *f, const char *line, td_error *error)
{
    char word[4][TOKEN];
    property p = {0};
    if (f->elements == 0) return header_fails(f, error, "a property before any element", line);
    if (f->properties == MAX_PROPERTIES)
        return header_fails(f, error, "more properties than the 128 that are accepted", line);
    const int words = sscanf(line, "property %63s %63s %63s %63s", word[0], word[1], word[2], word[3]);
    p.list = words == 4 && !strcmp(word[0], "list");
    if (!p.list && words != 2) return header_fails(f, error, "not a property", line);
    if (p.list ? !kind_named(&p.length, word[1]) || !kind_named(&p.kind, word[2]) || p.length >= FLOAT32
               : !kind_named(&p.kind, word[0]))
        return header_fails(f, error, "no type of PLY (char, uchar, …, double)", line);
    element *e = &f->element[f->elements - 1];
    p.role = role_of(e, &p, word[p.list ? 3 : 1]);
    for (int i = e->first; p.role && i < f->properties; i++)
        if (f->property[i].role == p.role)
            return header_fails(f, error, "a property for the second time", line);
    if (p.role == CORNERS && p.kind >= FLOAT32)
        return header_fails(f, error, "corners must be whole numbers", line);
    f->property[f->properties++] = p;
    e->properties++;
    return TD_OK;
}

static td_status read_element(ply *f, const char *line, td_error *error)
{
    char name[TOKEN], digits[TOKEN];
    long long count;
    double unused;
    if (f->elements == MAX_ELEMENTS)
        return header_fails(f, error, "more elements than the 16 that are accepted", line);
    if (sscanf(line, "element %63s %63s", name, digits) != 2 ||
        td_number_parse(&count, &unused, digits) != TD_NUMBER_INTEGER || count < 0)
        return header_fails(f, error, "an element needs a name and a count", line);
    for (int i = 0; i < f->elements; i++)
        if (!strcmp(f->element[i].name, name))
            return header_fails(f, error, "an element for the second time", line);
    element *e = &f->element[f->elements++];
    *e = (element){.count = (size_t)count, .first = f->properties};
    strcpy(e->name, name);
    return TD_OK;
}

static bool begins(const char *line, const char *word)
{
    const size_t length = strlen(word);
    return !strncmp(line, word, length) && (!line[length] || line[length] == ' ');
}

static td_status read_layout(ply *f, const char *line, td_error *error)
{
    static const char *const formats[] = {"format ascii 1.0", "format binary_little_endian 1.0",
                                          "format binary_big_endian 1.0"};
    for (int i = 0; i < 3; i++)
        if (!strcmp(line, formats[i])) {
            f->layout = (layout)i;
            return TD_OK;
        }
    return header_fails(f, error, "the second line of a PLY must be its format, 1.0", line);
}

static td_status read_header(ply *f, td_error *error)
{
    char line[MAX_LINE];
    if (!next_line(line, f) || strcmp(line, "ply"))
        return td_fail(error, TD_ERROR_FORMAT, "%s: is not a PLY file: does not begin with 'ply'", f->path);
    if (!next_line(line, f)) line[0] = 0;
    TD_TRY(read_layout(f, line, error));
    while (next_line(line, f)) {
        if (!strcmp(line, "end_header")) {
            f->line++;
            return TD_OK;
        }
        if (begins(line, "comment") || begins(line, "obj_info")) continue;
        if (begins(line, "element"))
            TD_TRY(read_element(f, line, error));
        else if (begins(line, "property"))
            TD_TRY(read_property(f, line, error));
        else
            return header_fails(f, error, "not a line of a PLY's header", line);
    }
    return td_fail(error, TD_ERROR_FORMAT,
                   "%s:%zu: the header ends before 'end_header', or a line is too long", f->path, f->line);
}

/* ---- values ---- */

static double from_bits(uint64_t bits, kind k)
{
    float f;
    double d;
    const uint32_t low = (uint32_t)bits;
    switch (k) {
    case INT8:
        return (int8_t)bits;
    case UINT8:
        return (uint8_t)bits;
    case INT16:
        return (int16_t)bits;
    case UINT16:
        return (uint16_t)bits;
    case INT32:
        return (int32_t)bits;
    case UINT32:
        return low;
    case FLOAT32:
        memcpy(&f, &low, sizeof f);
        return (double)f;
    default:
        memcpy(&d, &bits, sizeof d);
        return d;
    }
}

static bool next_text(double *value, ply *f)
{
    char word[TOKEN];
    size_t length = 0;
    for (; f->at < f->end && isspace(*f->at); f->at++) f->line += *f->at == '\n';
    while (f->at < f->end && !isspace(*f->at) && length < TOKEN - 1) word[length++] = (char)*f->at++;
    word[length] = 0;
    if (!strcmp(word, "nan") || !strcmp(word, "-nan") || !strcmp(word, "NaN")) {
        *value = NAN;
        return true;
    }
    return td_number_real(value, word);
}

static bool next_value(double *value, ply *f, kind k)
{
    const int size = kinds[k].size;
    uint64_t bits = 0;
    if (f->layout == ASCII) return next_text(value, f);
    if (f->end - f->at < size) return false;
    for (int i = 0; i < size; i++) bits |= (uint64_t)f->at[f->layout == LITTLE ? i : size - 1 - i] << (8 * i);
    f->at += size;
    *value = from_bits(bits, k);
    return true;
}

static td_status value_fails(const ply *f, const element *e, size_t index, td_error *error, const char *what)
{
    if (f->layout == ASCII)
        return td_fail(error, TD_ERROR_FORMAT, "%s:%zu: %s %zu: %s", f->path, f->line, e->name, index, what);
    return td_fail(error, TD_ERROR_FORMAT, "%s: %s %zu: %s", f->path, e->name, index, what);
}

static uint8_t colour(double value, kind k)
{
    if (k == FLOAT32 || k == FLOAT64) value *= 255;
    if (k == UINT16) value /= 257;
    return (uint8_t)(value > 0 ? fmin(value + 0.5, 255) : 0); /* NaN: 0 */
}

static void set_vertex(td_cloud_point *point, const property *p, double value)
{
    if (p->role >= X && p->role <= Z) point->p[p->role - X] = value;
    if (p->role >= RED && p->role <= BLUE) point->rgb[p->role - RED] = colour(value, p->kind);
    if (p->role == SIGMA) point->sigma = (float)value;
}

/* Triangles that grow: polygons of many corners become several. */
typedef struct faces {
    uint32_t (*triangle)[3];
    size_t count, capacity;
} faces;

static bool add_triangle(faces *t, uint32_t a, uint32_t b, uint32_t c)
{
    if (t->count == t->capacity) {
        const size_t wanted = t->capacity ? 2 * t->capacity : 1024;
        void *larger = realloc(t->triangle, wanted * sizeof *t->triangle);
        if (!larger) return false;
        t->triangle = larger;
        t->capacity = wanted;
    }
    t->triangle[t->count][0] = a;
    t->triangle[t->count][1] = b;
    t->triangle[t->count++][2] = c;
    return true;
}

/* A list: the corners of a face, cut into a fan of triangles, or something to pass over. */
static td_status read_list(faces *t, ply *f, const element *e, size_t index, const property *p,
                           size_t vertices, td_error *error)
{
    double length, value;
    uint32_t first = 0, last = 0;
    if (!next_value(&length, f, p->length) || !(length >= 0) || length != floor(length))
        return value_fails(f, e, index, error, "the length of a list is missing or none");
    if (p->role == CORNERS && length < 3)
        return value_fails(f, e, index, error, "a face needs three corners");
    for (double i = 0; i < length; i++) {
        if (!next_value(&value, f, p->kind))
            return value_fails(f, e, index, error, "the file ends, or a value is no number");
        if (p->role != CORNERS) continue;
        if (!(value >= 0 && value < (double)vertices) || value != floor(value))
            return value_fails(f, e, index, error, "a corner is no vertex");
        const uint32_t corner = (uint32_t)value;
        if (i == 0) first = corner;
        if (i >= 2 && !add_triangle(t, first, last, corner))
            return td_fail(error, TD_ERROR_MEMORY, "%s: no memory for its faces", f->path);
        last = corner;
    }
    return TD_OK;
}

static td_status read_values(td_cloud *cloud, faces *t, ply *f, const element *e, td_error *error)
{
    const bool vertices = !strcmp(e->name, "vertex");
    for (size_t i = 0; i < e->count; i++)
        for (int k = e->first; k < e->first + e->properties; k++) {
            const property *p = &f->property[k];
            double value;
            if (p->list) {
                TD_TRY(read_list(t, f, e, i, p, cloud->count, error));
                continue;
            }
            if (!next_value(&value, f, p->kind))
                return value_fails(f, e, i, error, "the file ends, or a value is no number");
            if (vertices) set_vertex(&cloud->point[i], p, value);
        }
    return TD_OK;
}

/* Fewer bytes than the counts need at least are refused before anything is allocated. A value is at least a
 * digit and a blank of text, a list at least its length. */
static td_status check_counts(const ply *f, const element **vertex, td_error *error)
{
    size_t left = (size_t)(f->end - f->at) + 1; /* the last blank may be missing */
    *vertex = NULL;
    for (int i = 0; i < f->elements; i++) {
        const element *e = &f->element[i];
        size_t size = 0;
        int coordinates = 0;
        for (int k = e->first; k < e->first + e->properties; k++) {
            const property *p = &f->property[k];
            size += f->layout == ASCII ? 2 : (size_t)kinds[p->list ? p->length : p->kind].size;
            coordinates += p->role >= X && p->role <= Z;
        }
        if (e->count && (size == 0 || e->count > left / size))
            return td_fail(error, TD_ERROR_FORMAT,
                           "%s: says that it has %zu of '%s', but is too short for them", f->path, e->count,
                           e->name);
        left -= e->count * size;
        if (strcmp(e->name, "vertex")) continue;
        if (coordinates != 3)
            return td_fail(error, TD_ERROR_FORMAT, "%s: its vertices have no x, y and z", f->path);
        *vertex = e;
    }
    if (!*vertex) return td_fail(error, TD_ERROR_FORMAT, "%s: has no element 'vertex'", f->path);
    return TD_OK;
}

static td_status read_body(td_cloud **cloud, ply *f, td_error *error)
{
    const element *vertex;
    faces t = {0};
    TD_TRY(check_counts(f, &vertex, error));
    td_status status = td_cloud_new(cloud, vertex->count, 0, error);
    if (status != TD_OK) return td_error_prefix(error, status, "%s", f->path);
    for (int i = 0; status == TD_OK && i < f->elements; i++)
        status = read_values(*cloud, &t, f, &f->element[i], error);
    if (status != TD_OK) {
        td_cloud_free(cloud);
        free(t.triangle);
        return status;
    }
    if (t.count) {
        free((*cloud)->triangle);
        (*cloud)->triangle = t.triangle;
        (*cloud)->triangle_count = t.count;
    }
    return TD_OK;
}

td_status td_cloud_parse_ply(td_cloud **cloud, const void *bytes, size_t size, const char *name,
                             td_error *error)
{
    ply *f = calloc(1, sizeof *f);
    *cloud = NULL;
    if (!f) return td_fail(error, TD_ERROR_MEMORY, "%s: no memory for it", name);
    f->path = name;
    f->at = bytes;
    f->end = f->at + size;
    td_status status = read_header(f, error);
    if (status == TD_OK) status = read_body(cloud, f, error);
    free(f);
    return status;
}

td_status td_cloud_read_ply(td_cloud **cloud, const char *path, td_error *error)
{
    char *bytes = NULL;
    size_t size = 0;
    *cloud = NULL;
    TD_TRY(td_file_read(&bytes, &size, path, MAX_BYTES, error));
    td_status status = td_cloud_parse_ply(cloud, bytes, size, path, error);
    free(bytes);
    return status;
}
