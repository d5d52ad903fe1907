/* A folder of a test's own, for the files it writes; removed with everything in it at the end.
 *
 *   cmocka_unit_test_setup_teardown(test_something, scratch_make, scratch_remove)
 *   static void test_something(void **state) { const char *folder = *state; … } */
#ifndef TELEDIMOS_TESTS_SCRATCH_H
#define TELEDIMOS_TESTS_SCRATCH_H

#include <dirent.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "core/file.h"

static inline int scratch_make(void **state)
{
    char *path = td_path_join(TD_BINARY_DIR, "scratch-XXXXXX");
    if (!path || !mkdtemp(path)) return -1;
    *state = path;
    return 0;
}

static inline void scratch_remove_tree(const char *path)
{
    DIR *stream = opendir(path);
    if (stream) {
        for (struct dirent *entry; (entry = readdir(stream));) {
            if (!strcmp(entry->d_name, ".") || !strcmp(entry->d_name, "..")) continue;
            char *inner = td_path_join(path, entry->d_name);
            scratch_remove_tree(inner);
            free(inner);
        }
        closedir(stream);
    }
    remove(path);
}

static inline int scratch_remove(void **state)
{
    scratch_remove_tree(*state);
    free(*state);
    return 0;
}

#endif
