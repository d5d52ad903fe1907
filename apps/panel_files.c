#include "apps/panel_files.h"

#include <dirent.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <unistd.h>
#include <zlib.h>

#include "core/file.h"
#include "core/hash.h"

static const struct {
    const char *ending, *type;
} types[] = {
    {".html", "text/html; charset=utf-8"},
    {".js", "text/javascript; charset=utf-8"},
    {".css", "text/css; charset=utf-8"},
    {".svg", "image/svg+xml"},
    {".png", "image/png"},
    {".txt", "text/plain; charset=utf-8"},
};

static const char *type_of(const char *name)
{
    const char *dot = strrchr(name, '.');
    for (size_t i = 0; dot && i < sizeof types / sizeof *types; i++)
        if (strcmp(dot, types[i].ending) == 0) return types[i].type;
    return NULL;
}

/* By gzip, the same bytes each time. Left out where it fails or does not pay. */
static void pack(panel_file *f)
{
    enum { GZIP = 15 + 16, MEMORY = 8 };
    z_stream z = {0};
    if (f->size == 0 || deflateInit2(&z, 6, Z_DEFLATED, GZIP, MEMORY, Z_DEFAULT_STRATEGY) != Z_OK) return;
    const size_t room = deflateBound(&z, f->size);
    f->packed = malloc(room);
    z.next_in = f->data, z.avail_in = (uInt)f->size;
    z.next_out = f->packed, z.avail_out = (uInt)room;
    const bool done = f->packed && deflate(&z, Z_FINISH) == Z_STREAM_END;
    f->packed_size = z.total_out;
    (void)deflateEnd(&z);
    if (done && f->packed_size < f->size) return;
    free(f->packed);
    f->packed = NULL;
    f->packed_size = 0;
}

td_status panel_files_add(panel_files *files, const char *path, const char *type, const void *data,
                          size_t size, td_error *error)
{
    char hash[TD_HASH_HEX_SIZE];
    if (files->count == PANEL_MAX_FILES || size > PANEL_MAX_FILE || strlen(path) >= PANEL_PATH_SIZE)
        return td_fail(error, TD_ERROR_DATA, "%s: too large for the page, or one of more than %d files", path,
                       (int)PANEL_MAX_FILES);
    TD_TRY(td_hash_bytes(hash, data, size, error));
    panel_file *f = files->file + files->count;
    *f = (panel_file){.type = type, .size = size, .data = malloc(size + 1)};
    if (!f->data) return td_fail(error, TD_ERROR_MEMORY, "no memory for the page");
    memcpy(f->data, data, size);
    snprintf(f->path, sizeof f->path, "%s", path);
    snprintf(f->tag, sizeof f->tag, "\"%.16s\"", hash);
    pack(f);
    files->count++;
    return TD_OK;
}

static td_status add_file(panel_files *files, const char *folder, const char *name, td_error *error)
{
    char path[PANEL_PATH_SIZE + 8], *file = td_path_join(folder, name), *text = NULL;
    size_t size = 0;
    if (!file) return td_fail(error, TD_ERROR_MEMORY, "no memory for a path");
    snprintf(path, sizeof path, "/%.80s", strcmp(name, "index.html") == 0 ? "" : name);
    td_status status = td_file_read(&text, &size, file, PANEL_MAX_FILE, error);
    if (status == TD_OK) status = panel_files_add(files, path, type_of(name), text, size, error);
    free(text);
    free(file);
    return status;
}

td_status panel_files_read(panel_files *files, const char *folder, td_error *error)
{
    DIR *d = opendir(folder);
    td_status status = TD_OK;
    if (!d) return TD_OK;
    for (struct dirent *e; status == TD_OK && (e = readdir(d));)
        if (e->d_name[0] != '.' && type_of(e->d_name)) status = add_file(files, folder, e->d_name, error);
    closedir(d);
    return status;
}

const panel_file *panel_files_find(const panel_files *files, const char *path)
{
    for (size_t i = 0; i < files->count; i++)
        if (strcmp(files->file[i].path, path) == 0) return files->file + i;
    return NULL;
}

void panel_files_free(panel_files *files)
{
    for (size_t i = 0; i < files->count; i++) {
        free(files->file[i].data);
        free(files->file[i].packed);
    }
    files->count = 0;
}

bool panel_files_place(char *folder, size_t size)
{
    char self[1024];
    const ssize_t length = readlink("/proc/self/exe", self, sizeof self - 1);
    if (length <= 0) return false;
    self[length] = 0;
    for (int i = 0; i < 3; i++) { /* PREFIX/libexec/teledimos/panel */
        char *slash = strrchr(self, '/');
        if (!slash) return false;
        *slash = 0;
    }
    return snprintf(folder, size, "%s/share/teledimos/panel", self) < (int)size;
}
