/* What file.c shares with the rooms of core that read files in pieces. */
#ifndef TELEDIMOS_CORE_FILE_INTERNAL_H
#define TELEDIMOS_CORE_FILE_INTERNAL_H

#include <stdbool.h>
#include <stddef.h>

#include "status.h"

/* Opens a regular file for reading without ever waiting; anything else is refused with a sentence that names
 * it. *fd is to be closed with close(). */
td_status td_file_open(int *fd, const char *path, td_error *error);

/* A file that grows under the name `part` until it is whole: begun anew, held against other processes that
 * would write it, added to, and put in the place of `path`. td_file_part_finish closes it, on failure too. */
td_status td_file_part_begin(int *fd, const char *part, const char *path, td_error *error);
td_status td_file_part_add(int fd, const char *path, const void *bytes, size_t size, td_error *error);
td_status td_file_part_finish(int fd, const char *part, const char *path, td_error *error);

/* "set.zip/folder/name" names a file inside an archive (archive.c). */
bool td_archive_has(const char *path);
td_status td_archive_read(char **bytes, size_t *size, const char *path, size_t limit, td_error *error);

#endif
