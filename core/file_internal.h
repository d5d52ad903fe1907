/* What file.c shares with the rooms of core that read files in pieces. */
#ifndef TELEDIMOS_CORE_FILE_INTERNAL_H
#define TELEDIMOS_CORE_FILE_INTERNAL_H

#include "status.h"

/* Opens a regular file for reading without ever waiting; anything else is refused with a sentence that names
 * it. *fd is to be closed with close(). */
td_status td_file_open(int *fd, const char *path, td_error *error);

#endif
