/* Files inside zip archives, as data sets come. */
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/stat.h>

#include <zip.h>

#include "core/file_internal.h"

/* Where the archive's name ends; 0: the path names no archive. */
static size_t archive_length(const char *path)
{
    for (const char *at = strstr(path, ".zip/"); at; at = strstr(at + 1, ".zip/")) {
        size_t length = (size_t)(at - path) + 4;
        char *archive = strndup(path, length);
        struct stat status;
        bool is_file = archive && stat(archive, &status) == 0 && S_ISREG(status.st_mode);
        free(archive);
        if (is_file) return length;
    }
    return 0;
}

bool td_archive_has(const char *path)
{
    return archive_length(path) > 0;
}

static td_status read_member(char **bytes, size_t *size, zip_t *archive, const char *path, const char *member,
                             size_t limit, td_error *error)
{
    zip_stat_t about;
    if (zip_stat(archive, member, 0, &about) != 0 || !(about.valid & ZIP_STAT_SIZE))
        return td_fail(error, TD_ERROR_IO, "%s: the archive holds no such file", path);
    if (about.size > limit)
        return td_fail(error, TD_ERROR_IO, "%s: is larger than the %zu bytes that are accepted", path, limit);
    zip_file_t *file = zip_fopen(archive, member, 0);
    char *data = file ? malloc((size_t)about.size + 1) : NULL;
    zip_int64_t got = data ? zip_fread(file, data, about.size) : -1;
    if (file) zip_fclose(file);
    if (got < 0 || (zip_uint64_t)got != about.size) {
        free(data);
        return td_fail(error, TD_ERROR_IO, "%s: cannot be read out of the archive", path);
    }
    data[about.size] = 0;
    *bytes = data;
    *size = (size_t)about.size;
    return TD_OK;
}

td_status td_archive_read(char **bytes, size_t *size, const char *path, size_t limit, td_error *error)
{
    size_t length = archive_length(path);
    char *name = strndup(path, length);
    int cause;
    zip_t *archive = name ? zip_open(name, ZIP_RDONLY, &cause) : NULL;
    free(name);
    if (!archive) return td_fail(error, TD_ERROR_FORMAT, "%.*s: is no zip archive", (int)length, path);
    td_status status = read_member(bytes, size, archive, path, path + length + 1, limit, error);
    zip_discard(archive);
    return status;
}
