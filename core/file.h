/* Files whole or not at all. */
#ifndef TELEDIMOS_CORE_FILE_H
#define TELEDIMOS_CORE_FILE_H

#include <stddef.h>
#include <stdio.h>

#include "status.h"

#ifdef __cplusplus
extern "C" {
#endif

/* Reads a regular file, or one inside a zip archive ("set.zip/folder/name"), of at most `limit` bytes; *bytes
 * is to be freed with free() and has a 0 behind its end. A missing, unreadable, too large or special file is
 * refused with a sentence that names it. */
TD_API td_status td_file_read(char **bytes, size_t *size, const char *path, size_t limit, td_error *error);

/* Writes under a temporary name in the same folder, fsyncs, renames, fsyncs the folder: after a crash or kill
 * the path holds the old content or the new, whole. */
TD_API td_status td_file_write(const char *path, const void *bytes, size_t size, td_error *error);

/* The same for what is too large for memory: `part` lends the next bytes each time it is called, none at the
 * end, or fails. */
typedef td_status (*td_file_part)(const void **bytes, size_t *size, void *user, td_error *error);
TD_API td_status td_file_write_parts(const char *path, td_file_part part, void *user, td_error *error);

/* Opens a regular file to be read piece by piece, without ever waiting; anything else is refused with a
 * sentence that names it. To be closed with fclose(). */
TD_API td_status td_file_stream(FILE **file, const char *path, td_error *error);

/* Makes a folder and its parents; an existing folder is fine. */
TD_API td_status td_folder_make(const char *path, td_error *error);

/* "folder/name", or name itself when it is absolute; to be freed with free(). NULL: out of memory. */
TD_API char *td_path_join(const char *folder, const char *name);
/* The folder part of a path ("." when there is none); to be freed with free(). */
TD_API char *td_path_folder(const char *path);

#ifdef __cplusplus
}
#endif
#endif
