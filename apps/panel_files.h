/* The page's files, read once when the server starts: a table in memory, so that a request can name nothing
 * but what stands in it. */
#ifndef TELEDIMOS_APPS_PANEL_FILES_H
#define TELEDIMOS_APPS_PANEL_FILES_H

#include <stdbool.h>
#include <stddef.h>

#include "core/status.h"

enum { PANEL_MAX_FILES = 64, PANEL_MAX_FILE = 1 << 22, PANEL_PATH_SIZE = 80, PANEL_TAG_SIZE = 24 };

typedef struct panel_file {
    char path[PANEL_PATH_SIZE]; /* of the request: "/", "/main.js" */
    const char *type;
    char tag[PANEL_TAG_SIZE]; /* ETag: of its bytes */
    unsigned char *data, *packed;
    size_t size, packed_size; /* packed: by gzip; NULL where that is no smaller */
} panel_file;

typedef struct panel_files {
    size_t count;
    panel_file file[PANEL_MAX_FILES];
} panel_files;

/* Those of a folder, by name; index.html is "/". Others than a page's are left out. Without the folder: none.
 */
td_status panel_files_read(panel_files *files, const char *folder, td_error *error);
td_status panel_files_add(panel_files *files, const char *path, const char *type, const void *data,
                          size_t size, td_error *error);
/* NULL: there is none. */
const panel_file *panel_files_find(const panel_files *files, const char *path);
void panel_files_free(panel_files *files);
/* share/teledimos/panel beside the program's libexec/teledimos. False: the path is too long. */
bool panel_files_place(char *folder, size_t size);

#endif
