/* The ground of a scenario: what it says, and the map that comes of it. */
#include <errno.h>
#include <fcntl.h>
#include <limits.h>
#include <math.h>
#include <spawn.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/stat.h>
#include <sys/wait.h>
#include <unistd.h>

#include "apps/station.h"
#include "core/document.h"
#include "core/file.h"

extern char **environ;

/* ---- read ---- */

static td_status real(double *value, const td_field *parent, const char *key, double low, double high,
                      td_error *error)
{
    const td_field field = td_field_get(parent, key);
    return field.value ? td_field_real(value, &field, low, high, error) : TD_OK;
}

static td_status path_of(char path[STATION_PATH], const td_field *field, const char *folder, td_error *error)
{
    const char *name = NULL;
    if (!field->value) return TD_OK;
    TD_TRY(td_field_string(&name, field, error));
    char *joined = td_path_join(folder, name);
    if (!joined) return td_fail(error, TD_ERROR_MEMORY, "no memory for a path");
    const int length = snprintf(path, STATION_PATH, "%s", joined);
    free(joined);
    return length < STATION_PATH ? TD_OK : td_field_fail(field, error, "the path is too long");
}

static td_status read_stone(td_world_stone *stone, const td_field *field, td_error *error)
{
    static const char *const keys[] = {"at_m", "radius_m", "density_kg_m3", "friction", NULL};
    const td_field at = td_field_get(field, "at_m"), radius = td_field_get(field, "radius_m");
    TD_TRY(td_field_check_keys(field, keys, error));
    *stone = (td_world_stone){.shape = {.kind = TD_PRIMITIVE_SPHERE, .link_from_shape = td_pose_identity()},
                              .density = 2600,
                              .friction = 0.6};
    TD_TRY(td_field_reals(stone->shape.link_from_shape.t, 3, &at, -1e5, 1e5, error));
    TD_TRY(td_field_real(stone->shape.size, &radius, 0.01, 5, error));
    TD_TRY(real(&stone->density, field, "density_kg_m3", 100, 1e4, error));
    return real(&stone->friction, field, "friction", 0, 10, error);
}

static td_status read_stones(station_ground *g, const td_field *field, td_error *error)
{
    const td_field list = td_field_get(field, "stones");
    size_t count = 0;
    if (!list.value) return TD_OK;
    TD_TRY(td_field_count(&count, &list, 0, STATION_MAX_STONES, error));
    for (size_t i = 0; i < count; i++) {
        char index[TD_FIELD_INDEX_SIZE];
        const td_field stone = td_field_at(&list, i, index);
        TD_TRY(read_stone(g->stone + g->stone_count++, &stone, error));
    }
    return TD_OK;
}

static td_status read_site(station_ground *g, const td_field *field, td_error *error)
{
    const td_field frames = td_field_get(field, "frames"), region = td_field_get(field, "region_m");
    const char *text = NULL;
    if (g->map[0] && (frames.value || region.value || td_field_get(field, "cell_m").value))
        return td_field_fail(field, error, "frames, cell_m and region_m go with a site, not with a map");
    if (frames.value) {
        TD_TRY(td_field_string(&text, &frames, error));
        if (snprintf(g->frames, sizeof g->frames, "%s", text) >= (int)sizeof g->frames)
            return td_field_fail(&frames, error, "'%s' is no range such as 1..3", text);
    }
    TD_TRY(real(&g->cell_m, field, "cell_m", 0.01, 1, error));
    if (!region.value) return TD_OK;
    g->has_region = true;
    return td_field_reals(g->region, 4, &region, -1e6, 1e6, error);
}

td_status station_ground_read(station_ground *g, const td_field *field, const char *folder, td_error *error)
{
    static const char *const keys[] = {"map",  "site",    "frames",       "cell_m", "region_m",
                                       "soil", "sigma_m", "unseen_top_m", "stones", NULL};
    const td_field map = td_field_get(field, "map"), site = td_field_get(field, "site"),
                   soil = td_field_get(field, "soil");
    *g = (station_ground){.cell_m = 0.06, .sigma_m = 0.03, .unseen_top_m = NAN};
    TD_TRY(td_field_check_keys(field, keys, error));
    TD_TRY(path_of(g->map, &map, folder, error));
    TD_TRY(path_of(g->site, &site, folder, error));
    if (!map.value == !site.value)
        return td_field_fail(field, error,
                             "there is no map: give one of map (a GeoTIFF of heights) and site (a scene)");
    TD_TRY(read_site(g, field, error));
    TD_TRY(real(&g->sigma_m, field, "sigma_m", 1e-4, 10, error));
    TD_TRY(real(&g->unseen_top_m, field, "unseen_top_m", -1e4, 1e4, error));
    if (soil.value) {
        TD_TRY(path_of(g->soil_path, &soil, folder, error));
        TD_TRY(td_soil_preset_read(&g->soil, g->soil_path, error));
        g->has_soil = true;
    }
    return read_stones(g, field, error);
}

/* ---- rendered and reconstructed ---- */

enum { LISTENED = 4096 };

/* The program NAME beside this one. */
static bool beside(char path[PATH_MAX], const char *name)
{
    char self[PATH_MAX];
    const ssize_t length = readlink("/proc/self/exe", self, sizeof self - 1);
    if (length <= 0) return false;
    self[length] = 0;
    char *slash = strrchr(self, '/');
    if (!slash) return false;
    *slash = 0;
    return snprintf(path, PATH_MAX, "%s/%s", self, name) < PATH_MAX;
}

/* The last of what is said that fits, to the end. */
static void listen_to(char said[LISTENED], int from)
{
    size_t size = 0;
    ssize_t got;
    while ((got = read(from, said + size, LISTENED - 1 - size)) > 0 || (got < 0 && errno == EINTR)) {
        if (got > 0) size += (size_t)got;
        if (size < LISTENED - 1) continue;
        memmove(said, said + LISTENED / 2, size - LISTENED / 2);
        size -= LISTENED / 2;
    }
    while (size > 0 && said[size - 1] == '\n') size--;
    said[size] = 0;
}

static int spawn(pid_t *child, const char *path, const char *const *argv, int errors)
{
    posix_spawn_file_actions_t files;
    if (posix_spawn_file_actions_init(&files) != 0) return ENOMEM;
    int fault = posix_spawn_file_actions_addopen(&files, STDIN_FILENO, "/dev/null", O_RDONLY, 0);
    if (!fault) fault = posix_spawn_file_actions_addopen(&files, STDOUT_FILENO, "/dev/null", O_WRONLY, 0);
    if (!fault) fault = posix_spawn_file_actions_adddup2(&files, errors, STDERR_FILENO);
    if (!fault) fault = posix_spawn(child, path, &files, NULL, (char *const *)argv, environ);
    posix_spawn_file_actions_destroy(&files);
    return fault;
}

/* posix_spawn changes no argument, though its type allows it. Waits for the command; its last sentence
 * becomes ours. */
static td_status run(const char *name, const char *const *argv, td_error *error)
{
    char path[PATH_MAX], said[LISTENED] = "";
    int channel[2], code = 0;
    pid_t child = 0;
    if (!beside(path, name) || pipe(channel) != 0)
        return td_fail(error, TD_ERROR_IO, "teledimos %s cannot be run", name);
    fcntl(channel[0], F_SETFD, FD_CLOEXEC);
    fcntl(channel[1], F_SETFD, FD_CLOEXEC);
    const int fault = spawn(&child, path, argv, channel[1]);
    close(channel[1]);
    if (!fault) listen_to(said, channel[0]);
    close(channel[0]);
    if (fault)
        return td_fail(error, TD_ERROR_IO, "%s cannot be run: %s; is the installation complete?", path,
                       strerror(fault));
    while (waitpid(child, &code, 0) < 0 && errno == EINTR) continue;
    if (WIFEXITED(code) && (WEXITSTATUS(code) == 0 || WEXITSTATUS(code) == 3)) return TD_OK;
    const char *last = strrchr(said, '\n');
    last = last ? last + 1 : said;
    if (strncmp(last, "teledimos ", 10) == 0 && strstr(last, ": ")) last = strstr(last, ": ") + 2;
    return td_fail(error, WIFSIGNALED(code) ? TD_ERROR_CANCELLED : TD_ERROR_DATA, "%s",
                   *last ? last : "a command that makes the map was ended from outside");
}

static td_status render(const station_ground *g, const char *site, const char *threads, td_error *error)
{
    char frames[sizeof g->frames], scene[STATION_PATH];
    const char *argv[] = {"render",    scene,   "-o",       site,   "--quiet",
                          "--threads", threads, "--frames", frames, NULL};
    snprintf(scene, sizeof scene, "%s", g->site);
    snprintf(frames, sizeof frames, "%s", g->frames);
    if (!frames[0]) argv[7] = NULL;
    return run("render", argv, error);
}

static td_status reconstruct(const station_ground *g, const char *site, const char *map, const char *threads,
                             td_error *error)
{
    char cell[32], region[160];
    const char *argv[] = {"reconstruct", site,    "-o",     map,  "--quiet",  "--accept", "--texels", "0",
                          "--threads",   threads, "--cell", cell, "--region", region,     NULL};
    snprintf(cell, sizeof cell, "%.17g", g->cell_m);
    snprintf(region, sizeof region, "%.17g,%.17g,%.17g,%.17g", g->region[0], g->region[1], g->region[2],
             g->region[3]);
    if (!g->has_region) argv[12] = NULL;
    return run("reconstruct", argv, error);
}

static td_status make_site(char tif[STATION_PATH], const station_ground *g, const char *output, int threads,
                           const td_progress *progress, td_error *error)
{
    char site[STATION_PATH], map[STATION_PATH], count[16];
    if (snprintf(site, sizeof site, "%s/site", output) >= STATION_PATH ||
        snprintf(map, sizeof map, "%s/map", output) >= STATION_PATH ||
        snprintf(tif, STATION_PATH, "%s/map/map.tif", output) >= STATION_PATH)
        return td_fail(error, TD_ERROR_ARGUMENT, "%s: the path is too long", output);
    snprintf(count, sizeof count, "%d", threads);
    TD_TRY(td_folder_make(output, error));
    td_progress_report(progress, "rendering the site", 0, 2);
    TD_TRY(render(g, site, count, error));
    if (!td_progress_report(progress, "reconstructing the map", 1, 2))
        return td_fail(error, TD_ERROR_CANCELLED, "interrupted");
    return reconstruct(g, site, map, count, error);
}

td_status station_ground_map(td_elevation **map, const station_ground *g, const char *output, int threads,
                             const td_progress *progress, td_error *error)
{
    char tif[STATION_PATH];
    *map = NULL;
    if (g->map[0])
        snprintf(tif, sizeof tif, "%s", g->map);
    else
        TD_TRY(make_site(tif, g, output, threads, progress, error));
    int columns = 0, rows = 0;
    TD_TRY(td_elevation_size(&columns, &rows, tif, error));
    if (columns > TD_SOIL_MAX_CELLS / rows)
        return td_fail(
            error, TD_ERROR_DATA,
            "%s: %d x %d cells are more than the %d that a ground may have; cut out the part around "
            "the machine, or take larger cells",
            tif, columns, rows, TD_SOIL_MAX_CELLS);
    return td_elevation_read(map, tif, error);
}
