#include "apps/machine_model.h"

#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <unistd.h>

#include "core/file.h"

static td_status add_file(td_hash *hash, const char *path, td_error *error)
{
    char *bytes = NULL;
    size_t size = 0;
    TD_TRY(td_file_read(&bytes, &size, path, (size_t)16 << 20, error));
    td_hash_add(hash, bytes, size);
    free(bytes);
    return TD_OK;
}

static td_status add_all(td_hash *hash, const void *user, td_error *error)
{
    const scenario *s = user;
    char path[sizeof s->robot_path + 8], text[800];
    const td_machine_options *o = &s->options;
    TD_TRY(add_file(hash, s->robot_path, error));
    snprintf(path, sizeof path, "%s", s->robot_path);
    char *dot = strrchr(path, '.');
    if (dot && strcmp(dot, ".urdf") == 0) {
        memcpy(dot, ".yaml", 6);
        if (access(path, R_OK) == 0) TD_TRY(add_file(hash, path, error));
    }
    const int length =
        snprintf(text, sizeof text, "|%.17g|%.17g|%.17g|%.17g|%.17g|%.17g|%.17g|%.17g", s->period_s,
                 s->gain_1_s, s->duration_s, o->oil_n_m, o->oil_s, o->valve_s, o->pump_m3_s, o->suspension);
    td_hash_add(hash, text, (size_t)length);
    for (int k = 0; k < s->robot->joint_count; k++) {
        td_hash_add(hash, o->viscous + k, sizeof *o->viscous);
        td_hash_add(hash, o->coulomb + k, sizeof *o->coulomb);
    }
    return TD_OK;
}

td_status machine_model(char hex[TD_HASH_HEX_SIZE], const scenario *s, td_error *error)
{
    return td_hash_make(hex, add_all, s, error);
}
