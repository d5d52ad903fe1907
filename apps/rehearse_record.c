/* The whole rehearsal as one recording, and what decides it read back: nothing of what happens depends on
 * anything but the files, the seed and the rig's covariance, so a recording replays. */
#include <math.h>
#include <stdarg.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "apps/rehearse_internal.h"
#include "core/file.h"
#include "core/number.h"

void rehearse_keep(rehearse *r, task_run *run, bool own, const char *format, ...)
{
    va_list list;
    if (r->part_count == REHEARSE_MAX_PARTS) {
        if (own) task_run_free(run);
        return;
    }
    rehearse_part *p = r->part + r->part_count++;
    *p = (rehearse_part){.run = run};
    va_start(list, format);
    vsnprintf(p->text, sizeof p->text, format, list);
    va_end(list);
    if (!own) return;
    p->own = *run;
    p->run = &p->own;
    *run = (task_run){0};
}

typedef struct source {
    const rehearse *r;
    const rehearse_setup *setup;
} source;

/* A scene is a file, or a folder with scene.yaml. */
static td_status add_scene(td_hash *hash, const char *path, td_error *error)
{
    if (task_hash_file(hash, path, NULL) == TD_OK) return TD_OK;
    char *inside = td_path_join(path, "scene.yaml");
    const td_status status = task_hash_file(hash, inside ? inside : path, error);
    free(inside);
    return status;
}

static td_status add_all(td_hash *hash, const void *user, td_error *error)
{
    const source *from = user;
    char hex[TD_HASH_HEX_SIZE];
    scenario s = from->r->scenario;
    s.map = NULL;
    TD_TRY(task_identity(hex, &s, error));
    td_hash_add(hash, hex, strlen(hex));
    TD_TRY(task_hash_file(hash, from->setup->path, error));
    TD_TRY(task_hash_file(hash, from->setup->rig_path, error));
    return add_scene(hash, s.ground.site, error);
}

/* The files that a rehearsal is made of. */
static td_status identify(char hex[TD_HASH_HEX_SIZE], const rehearse *r, const rehearse_setup *setup,
                          td_error *error)
{
    const source from = {.r = r, .setup = setup};
    return td_hash_make(hex, add_all, &from, error);
}

td_status rehearse_record(const rehearse *r, const char *folder, td_error *error)
{
    char identity[TD_HASH_HEX_SIZE];
    task_given given[2] = {{.kind = "seed"}, {.kind = "rig_covariance"}};
    scenario s = r->scenario;
    s.map = r->map;
    TD_TRY(identify(identity, r, r->setup, error));
    snprintf(given[0].text, sizeof given[0].text, "%llu", (unsigned long long)r->seed);
    td_number_format(given[1].text, r->setup->truth.rig_covariance, 0);
    task_part *part = calloc(r->part_count + 1, sizeof *part);
    char *path = part ? td_path_join(folder, "recording.mcap") : NULL;
    for (size_t i = 0; i < r->part_count && part; i++) {
        part[i].run = r->part[i].run;
        memcpy(part[i].text, r->part[i].text, sizeof part[i].text);
    }
    const td_status status = path
                                 ? task_record_parts(part, r->part_count, given, 2, &s, identity, path, error)
                                 : td_fail(error, TD_ERROR_MEMORY, "no memory for a recording");
    free(path);
    free(part);
    return status;
}

td_status rehearse_replay(rehearse *r, rehearse_setup *setup, const char *path, td_error *error)
{
    char identity[TD_HASH_HEX_SIZE];
    task_given given[2] = {{.kind = "seed"}, {.kind = "rig_covariance"}};
    double times;
    TD_TRY(identify(identity, r, setup, error));
    TD_TRY(task_given_read(given, 2, path, &r->scenario, identity, error));
    char *end = NULL;
    const unsigned long long seed = strtoull(given[0].text, &end, 10);
    if (*end || !td_number_real(&times, given[1].text) || !(times >= 0 && times <= 1e4))
        return td_fail(error, TD_ERROR_FORMAT, "%s: seed '%s' and covariance '%s' are none", path,
                       given[0].text, given[1].text);
    r->seed = seed;
    setup->truth.rig_covariance = times;
    return TD_OK;
}
