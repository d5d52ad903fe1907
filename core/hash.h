/* SHA-256 (FIPS 180-4): what a product says of the bytes that made it. */
#ifndef TELEDIMOS_CORE_HASH_H
#define TELEDIMOS_CORE_HASH_H

#include <stddef.h>

#include "status.h"

#ifdef __cplusplus
extern "C" {
#endif

enum { TD_HASH_HEX_SIZE = 65 };

/* Hashes of several parts, given one after another; the same as that of the parts in one piece. */
typedef struct td_hash td_hash;

TD_API td_status td_hash_new(td_hash **hash, td_error *error);
TD_API void td_hash_free(td_hash **hash);
/* A failure is kept, and returned by td_hash_finish. */
TD_API void td_hash_add(td_hash *hash, const void *bytes, size_t size);
/* 64 lower-case hexadecimal digits and a 0. Frees the hash, on failure too. */
TD_API td_status td_hash_finish(char hex[TD_HASH_HEX_SIZE], td_hash **hash, td_error *error);

/* Of what `add` adds; what it fails with is returned. */
typedef td_status (*td_hash_part)(td_hash *hash, const void *user, td_error *error);
TD_API td_status td_hash_make(char hex[TD_HASH_HEX_SIZE], td_hash_part add, const void *user,
                              td_error *error);

TD_API td_status td_hash_bytes(char hex[TD_HASH_HEX_SIZE], const void *bytes, size_t size, td_error *error);
/* Of a regular file of any size; others are refused as in file.h. */
TD_API td_status td_hash_file(char hex[TD_HASH_HEX_SIZE], const char *path, td_error *error);

#ifdef __cplusplus
}
#endif
#endif
