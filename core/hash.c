#include "core/hash.h"

#include <errno.h>
#include <openssl/evp.h>
#include <stdbool.h>
#include <stdlib.h>
#include <string.h>
#include <unistd.h>

#include "core/file_internal.h"

struct td_hash {
    EVP_MD_CTX *context;
    bool failed;
};

td_status td_hash_new(td_hash **hash, td_error *error)
{
    td_hash *made = calloc(1, sizeof *made);
    if (made) made->context = EVP_MD_CTX_new();
    if (!made || !made->context) {
        td_hash_free(&made);
        return td_fail(error, TD_ERROR_MEMORY, "no memory for a hash");
    }
    if (EVP_DigestInit_ex(made->context, EVP_sha256(), NULL) != 1) {
        td_hash_free(&made);
        return td_fail(error, TD_ERROR_EXTERNAL, "OpenSSL's libcrypto offers no SHA-256 here");
    }
    *hash = made;
    return TD_OK;
}

void td_hash_free(td_hash **hash)
{
    if (!hash || !*hash) return;
    EVP_MD_CTX_free((*hash)->context);
    free(*hash);
    *hash = NULL;
}

void td_hash_add(td_hash *hash, const void *bytes, size_t size)
{
    if (EVP_DigestUpdate(hash->context, bytes, size) != 1) hash->failed = true;
}

td_status td_hash_finish(char hex[TD_HASH_HEX_SIZE], td_hash **hash, td_error *error)
{
    unsigned char digest[EVP_MAX_MD_SIZE];
    unsigned size = 0;
    bool failed = (*hash)->failed || EVP_DigestFinal_ex((*hash)->context, digest, &size) != 1;
    td_hash_free(hash);
    if (failed || size != (TD_HASH_HEX_SIZE - 1) / 2)
        return td_fail(error, TD_ERROR_EXTERNAL, "OpenSSL's libcrypto failed to compute a SHA-256");
    for (unsigned i = 0; i < size; i++) {
        hex[2 * i] = "0123456789abcdef"[digest[i] >> 4];
        hex[2 * i + 1] = "0123456789abcdef"[digest[i] & 15];
    }
    hex[TD_HASH_HEX_SIZE - 1] = 0;
    return TD_OK;
}

td_status td_hash_make(char hex[TD_HASH_HEX_SIZE], td_hash_part add, const void *user, td_error *error)
{
    td_hash *hash = NULL;
    TD_TRY(td_hash_new(&hash, error));
    const td_status status = add(hash, user, error);
    if (status == TD_OK) return td_hash_finish(hex, &hash, error);
    td_hash_free(&hash);
    return status;
}

td_status td_hash_bytes(char hex[TD_HASH_HEX_SIZE], const void *bytes, size_t size, td_error *error)
{
    td_hash *hash = NULL;
    TD_TRY(td_hash_new(&hash, error));
    td_hash_add(hash, bytes, size);
    return td_hash_finish(hex, &hash, error);
}

static td_status add_file(td_hash *hash, int fd, const char *path, td_error *error)
{
    char block[65536];
    for (;;) {
        ssize_t got = read(fd, block, sizeof block);
        if (got < 0 && errno == EINTR) continue;
        if (got < 0) return td_fail(error, TD_ERROR_IO, "%s: cannot be read: %s", path, strerror(errno));
        if (got == 0) return TD_OK;
        td_hash_add(hash, block, (size_t)got);
    }
}

td_status td_hash_file(char hex[TD_HASH_HEX_SIZE], const char *path, td_error *error)
{
    int fd = -1;
    TD_TRY(td_file_open(&fd, path, error));
    td_hash *hash = NULL;
    td_status status = td_hash_new(&hash, error);
    if (status == TD_OK) status = add_file(hash, fd, path, error);
    if (status == TD_OK) status = td_hash_finish(hex, &hash, error);
    td_hash_free(&hash);
    close(fd);
    return status;
}
