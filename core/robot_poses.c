#include "core/robot_poses.h"

#include <dirent.h>
#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <strings.h>
#include <sys/stat.h>

#include "core/file.h"
#include "core/number.h"
#include "core/robot_poses_internal.h"
#include "core/source_internal.h"
#include "core/text_internal.h"

static const double FARTHEST_M = 1e5;

void td_robot_poses_free(td_robot_poses **poses)
{
    if (!poses || !*poses) return;
    free((*poses)->pose);
    free(*poses);
    *poses = NULL;
}

td_status td_pose_list_add(td_pose_list *list, const td_robot_pose *pose, const char *name, td_error *error)
{
    td_robot_poses *p = list->poses;
    if (p->count == TD_POSES_MAX)
        return td_fail(error, TD_ERROR_FORMAT, "%s: more than %d poses", name, TD_POSES_MAX);
    if (p->count == list->capacity) {
        size_t wanted = list->capacity ? 2 * list->capacity : 64;
        td_robot_pose *grown = realloc(p->pose, wanted * sizeof *grown);
        if (!grown) return td_fail(error, TD_ERROR_MEMORY, "%s: no memory for its poses", name);
        p->pose = grown;
        list->capacity = wanted;
    }
    p->pose[p->count++] = *pose;
    return TD_OK;
}

/* ---- from text ---- */

/* The first line that says something, without its end. */
static size_t first_line(const char **line, const char *text, size_t size)
{
    const char *at = text, *end = text + size;
    if (size >= 3 && !memcmp(text, "\xEF\xBB\xBF", 3)) at += 3;
    while (at < end) {
        const char *stop = at;
        while (stop < end && *stop != '\n' && *stop != '\r') stop++;
        const char *begin = at;
        while (begin < stop && (*begin == ' ' || *begin == '\t')) begin++;
        if (begin < stop && *begin != '#') {
            *line = begin;
            return (size_t)(stop - begin);
        }
        at = stop + 1;
    }
    *line = end;
    return 0;
}

static bool ends_with(const char *text, const char *end)
{
    size_t n = strlen(text), m = strlen(end);
    return n >= m && !strcmp(text + n - m, end);
}

static bool is_yaml_name(const char *name)
{
    return ends_with(name, ".yaml") || ends_with(name, ".yml");
}

/* "nan", "-inf": said where a number belongs, to be refused there. */
static bool is_no_number(const char *token)
{
    token += strspn(token, "+-.");
    return !strncasecmp(token, "nan", 3) || !strncasecmp(token, "inf", 3);
}

/* By the first line: numbers only are rows (8 or 7 of them ETH's), names between commas a table; a name that
 * ends in .yaml or "rows:" is ViSP's. */
static td_pose_convention look(const char *text, size_t size, const char *name)
{
    const char *line;
    size_t length = first_line(&line, text, size), numbers = 0;
    if (is_yaml_name(name) || (length >= 5 && !memcmp(line, "rows:", 5))) return TD_POSES_VISP;
    for (size_t i = 0; i < length;) {
        char token[64];
        size_t n = 0;
        while (i < length && strchr(" \t,;", line[i])) i++;
        while (i < length && !strchr(" \t,;", line[i]) && n < sizeof token - 1) token[n++] = line[i++];
        token[n] = 0;
        double value;
        if (n && !td_number_real(&value, token) && !is_no_number(token)) return TD_POSES_CSV;
        numbers += n > 0;
    }
    return numbers == 7 || numbers == 8 ? TD_POSES_ETHZ : TD_POSES_MATRIX;
}

static td_status options_complete(td_robot_poses_options *out, const td_robot_poses_options *in,
                                  td_error *error)
{
    *out = in ? *in : (td_robot_poses_options){.convention = TD_POSES_AUTO};
    if (out->metres == 0) out->metres = 1;
    if (out->radians == 0) out->radians = 1;
    if (out->convention >= TD_POSES_CONVENTION_COUNT)
        return td_fail(error, TD_ERROR_ARGUMENT, "robot poses: convention %d does not exist",
                       (int)out->convention);
    if (!(out->metres > 0 && out->metres <= 1e3))
        return td_fail(error, TD_ERROR_ARGUMENT, "robot poses: metres is %g, but lies in (0, 1000]",
                       out->metres);
    if (!(out->radians > 0 && out->radians <= 10))
        return td_fail(error, TD_ERROR_ARGUMENT, "robot poses: radians is %g, but lies in (0, 10]",
                       out->radians);
    return TD_OK;
}

/* What holds of every pose, whatever file it is from. */
static td_status finish(td_robot_poses *poses, const char *name, bool inverted, td_error *error)
{
    if (!poses->count) return td_fail(error, TD_ERROR_FORMAT, "%s: holds no pose", name);
    for (size_t i = 0; i < poses->count; i++) {
        td_robot_pose *p = &poses->pose[i];
        if (!(td_pose_distance(&p->base_from_hand) <= FARTHEST_M))
            return td_fail(error, TD_ERROR_FORMAT,
                           "%s: pose %zu lies %.3g m from the base; is its unit of length another?", name,
                           i + 1, td_pose_distance(&p->base_from_hand));
        if (inverted) p->base_from_hand = td_pose_inverse(&p->base_from_hand);
    }
    return TD_OK;
}

td_status td_robot_poses_parse(td_robot_poses **poses, const char *text, size_t size, const char *name,
                               const td_robot_poses_options *options, td_error *error)
{
    td_robot_poses_options o;
    *poses = NULL;
    TD_TRY(options_complete(&o, options, error));
    if (size > TD_POSES_MAX_BYTES) return td_fail(error, TD_ERROR_FORMAT, "%s: is larger than 64 MiB", name);
    td_pose_list list = {.poses = calloc(1, sizeof *list.poses)};
    if (!list.poses) return td_fail(error, TD_ERROR_MEMORY, "%s: no memory", name);
    if (o.convention == TD_POSES_AUTO) o.convention = look(text, size, name);
    td_status status = o.convention == TD_POSES_CSV ? td_robot_poses_csv(&list, text, size, name, &o, error)
                       : o.convention == TD_POSES_VISP
                           ? td_robot_poses_visp(&list, text, size, name, &o, error)
                           : td_robot_poses_rows(&list, text, size, name, &o, error);
    if (status == TD_OK) status = finish(list.poses, name, o.inverted, error);
    if (status != TD_OK) td_robot_poses_free(&list.poses);
    *poses = list.poses;
    return status;
}

/* ---- from files ---- */

static td_status read_one(td_robot_poses **poses, const char *path, const td_robot_poses_options *options,
                          td_error *error)
{
    char *text;
    size_t size;
    TD_TRY(td_file_read(&text, &size, path, TD_POSES_MAX_BYTES, error));
    td_status status = td_robot_poses_parse(poses, text, size, path, options, error);
    free(text);
    return status;
}

/* A folder's files: those of a pattern, or the .yaml ones. */
typedef struct file_list {
    char **name;
    size_t count, capacity;
} file_list;

static void file_list_free(file_list *list)
{
    for (size_t i = 0; i < list->count; i++) free(list->name[i]);
    free(list->name);
}

/* The directive of a pattern, "%d" or "%0Nd": its place and length; false if there is none. */
static bool directive(const char **at, size_t *length, const char *pattern)
{
    const char *p = strchr(pattern, '%');
    if (!p) return false;
    size_t n = 1;
    n += strspn(p + n, "0123456789");
    if (p[n] != 'd' || n > 3 || (n > 1 && p[1] != '0') || strchr(p + n, '%')) return false;
    *at = p;
    *length = n + 1;
    return true;
}

/* Whether a file's name is the pattern with digits in place of its directive. */
static bool matches(const char *name, const char *pattern)
{
    const char *at;
    size_t length;
    if (!pattern) return name[0] != '.' && is_yaml_name(name);
    if (!directive(&at, &length, pattern)) return false;
    size_t before = (size_t)(at - pattern), after = strlen(at + length), all = strlen(name);
    if (all <= before + after || strncmp(name, pattern, before) != 0) return false;
    if (strcmp(name + all - after, at + length) != 0) return false;
    size_t digits = all - before - after, width = length == 4 ? (size_t)(at[2] - '0') : 1;
    return strspn(name + before, "0123456789") >= digits && digits >= width && digits <= 9;
}

static int by_nature(const void *a, const void *b)
{
    return td_natural_compare(*(char *const *)a, *(char *const *)b);
}

static td_status list_files(file_list *list, const char *folder, const char *pattern, td_error *error)
{
    DIR *stream = opendir(folder);
    if (!stream) return td_fail(error, TD_ERROR_IO, "%s: the folder cannot be read", folder);
    td_status status = TD_OK;
    for (struct dirent *entry; status == TD_OK && (entry = readdir(stream));) {
        if (!matches(entry->d_name, pattern)) continue;
        if (list->count == list->capacity) {
            size_t wanted = list->capacity ? 2 * list->capacity : 64;
            char **grown = realloc(list->name, wanted * sizeof *grown);
            if (!grown) {
                status = td_fail(error, TD_ERROR_MEMORY, "%s: no memory for its list of files", folder);
                break;
            }
            list->name = grown;
            list->capacity = wanted;
        }
        list->name[list->count] = strdup(entry->d_name);
        if (!list->name[list->count])
            status = td_fail(error, TD_ERROR_MEMORY, "%s: no memory for its list of files", folder);
        else
            list->count++;
    }
    closedir(stream);
    if (list->count) qsort(list->name, list->count, sizeof *list->name, by_nature);
    return status;
}

/* The poses of one file, named after it. */
static td_status append(td_pose_list *list, const char *folder, const char *file,
                        const td_robot_poses_options *options, td_error *error)
{
    char *path = td_path_join(folder, file);
    if (!path) return td_fail(error, TD_ERROR_MEMORY, "%s: no memory", file);
    td_robot_poses *one = NULL;
    td_status status = read_one(&one, path, options, error);
    const char *dot = strrchr(file, '.');
    size_t stem = dot ? (size_t)(dot - file) : strlen(file);
    if (status == TD_OK && one->count != 1)
        status = td_fail(error, TD_ERROR_FORMAT, "%s: holds %zu poses, but a file of a set holds one", path,
                         one->count);
    if (status == TD_OK && stem >= TD_NAME_SIZE)
        status =
            td_fail(error, TD_ERROR_FORMAT, "%s: its name is longer than %d bytes", path, TD_NAME_SIZE - 1);
    if (status == TD_OK) {
        if (!one->pose[0].name[0]) memcpy(one->pose[0].name, file, stem);
        one->pose[0].time_s = NAN; /* of single files there is no stream */
        status = td_pose_list_add(list, &one->pose[0], path, error);
    }
    td_robot_poses_free(&one);
    free(path);
    return status;
}

static td_status read_set(td_robot_poses **poses, const char *folder, const char *pattern, const char *path,
                          const td_robot_poses_options *options, td_error *error)
{
    file_list files = {0};
    td_pose_list list = {.poses = calloc(1, sizeof *list.poses)};
    td_status status = list.poses ? list_files(&files, folder, pattern, error)
                                  : td_fail(error, TD_ERROR_MEMORY, "%s: no memory", path);
    if (status == TD_OK && !files.count)
        status = td_fail(error, TD_ERROR_NOT_FOUND, "%s: %s", path,
                         pattern ? "no file of this pattern" : "the folder holds no .yaml file of a pose");
    for (size_t i = 0; i < files.count && status == TD_OK; i++)
        status = append(&list, folder, files.name[i], options, error);
    file_list_free(&files);
    if (status != TD_OK) td_robot_poses_free(&list.poses);
    *poses = list.poses;
    return status;
}

td_status td_robot_poses_read(td_robot_poses **poses, const char *path, const td_robot_poses_options *options,
                              td_error *error)
{
    struct stat state;
    *poses = NULL;
    if (stat(path, &state) == 0) {
        if (S_ISDIR(state.st_mode)) return read_set(poses, path, NULL, path, options, error);
        return read_one(poses, path, options, error);
    }
    const char *slash = strrchr(path, '/'), *pattern = slash ? slash + 1 : path, *at;
    size_t length;
    if (!directive(&at, &length, pattern)) return read_one(poses, path, options, error);
    char *folder = td_path_folder(path);
    if (!folder) return td_fail(error, TD_ERROR_MEMORY, "%s: no memory", path);
    td_status status = read_set(poses, folder, pattern, path, options, error);
    free(folder);
    return status;
}

/* ---- interpolation ---- */

td_pose td_pose_between(const td_pose *a, const td_pose *b, double share)
{
    double w[3], step[4];
    td_pose inverse = td_pose_inverse(a), between = td_pose_compose(&inverse, b), out = *a;
    td_rotation_log(w, between.q);
    for (int k = 0; k < 3; k++) {
        w[k] *= share;
        out.t[k] = a->t[k] + share * (b->t[k] - a->t[k]);
    }
    td_rotation_exp(step, w);
    td_pose turn = {.q = {step[0], step[1], step[2], step[3]}},
            from = {.q = {a->q[0], a->q[1], a->q[2], a->q[3]}};
    td_pose turned = td_pose_compose(&from, &turn);
    memcpy(out.q, turned.q, sizeof out.q);
    return out;
}

bool td_robot_poses_at(td_pose *base_from_hand, const td_robot_poses *poses, double time_s, double gap_s)
{
    size_t low = 0, high = poses->count;
    if (!high || !(time_s >= poses->pose[0].time_s && time_s <= poses->pose[high - 1].time_s)) return false;
    while (high - low > 1) { /* pose[low].time_s <= time_s, and < the next one's */
        size_t middle = low + (high - low) / 2;
        if (poses->pose[middle].time_s <= time_s)
            low = middle;
        else
            high = middle;
    }
    const td_robot_pose *a = &poses->pose[low];
    *base_from_hand = a->base_from_hand;
    if (a->time_s == time_s) return true;
    const td_robot_pose *b = a + 1;
    double gap = b->time_s - a->time_s;
    if (gap_s > 0 && gap > gap_s) return false;
    *base_from_hand = td_pose_between(&a->base_from_hand, &b->base_from_hand, (time_s - a->time_s) / gap);
    return true;
}
