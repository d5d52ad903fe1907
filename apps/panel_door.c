#include "apps/panel_door.h"

#include <arpa/inet.h>
#include <openssl/crypto.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "core/file.h"

static const char CHARACTERS[] = "ABCDEFGHIJKLMNOPQRSTUVWXYZabcdefghijklmnopqrstuvwxyz0123456789-._~";

td_status panel_door_token(panel_door *door, const char *path, td_error *error)
{
    char *text = NULL;
    size_t size = 0;
    TD_TRY(td_file_read(&text, &size, path, 4096, error));
    const size_t length = strspn(text, CHARACTERS);
    td_status status = TD_OK;
    if (length < 16 || length > 128 || (text[length] && text[length] != '\n' && text[length] != '\r'))
        status = td_fail(error, TD_ERROR_FORMAT,
                         "%s: its first line is no token: 16 to 128 letters, digits and -._~ (openssl rand "
                         "-hex 32 makes one)",
                         path);
    else
        status = td_hash_bytes(door->token, text, length, error);
    OPENSSL_cleanse(text, size);
    free(text);
    door->locked = status == TD_OK;
    return status;
}

bool panel_door_knows(const panel_door *door, const char *token)
{
    char hash[TD_HASH_HEX_SIZE];
    unsigned char different = 0;
    if (!door->locked) return true;
    if (!token || td_hash_bytes(hash, token, strlen(token), NULL) != TD_OK) return false;
    for (int i = 0; i < TD_HASH_HEX_SIZE; i++) different |= (unsigned char)(hash[i] ^ door->token[i]);
    return different == 0;
}

bool panel_door_takes_origin(const panel_door *door, const char *origin, const char *host)
{
    static const char *const own[] = {"http://127.0.0.1", "http://localhost", "https://127.0.0.1",
                                      "https://localhost"};
    if (!*origin) return true;
    for (size_t i = 0; i < door->origin_count; i++)
        if (strcmp(origin, door->origin[i]) == 0) return true;
    for (size_t i = 0; door->local && i < sizeof own / sizeof *own; i++) {
        const size_t n = strlen(own[i]);
        if (strncmp(origin, own[i], n) == 0 && (origin[n] == 0 || origin[n] == ':')) return true;
    }
    const char *at = strstr(origin, "://");
    return !door->local && at && *host && strcmp(at + 3, host) == 0;
}

td_status panel_door_address(char *host, size_t size, int *port, const char *text, td_error *error)
{
    struct in_addr address;
    const char *colon = strrchr(text, ':');
    char *end = NULL;
    const long number = colon && colon[1] ? strtol(colon + 1, &end, 10) : -1;
    if (colon) snprintf(host, size, "%.*s", (int)(colon - text), text);
    if (colon && strcmp(host, "localhost") == 0) snprintf(host, size, "127.0.0.1");
    if (!colon || number < 0 || *end || number > 65535 || inet_pton(AF_INET, host, &address) != 1)
        return td_fail(error, TD_ERROR_ARGUMENT,
                       "--listen %s: it is an IPv4 address of this machine and a port, as 192.168.1.10:8765 "
                       "(0.0.0.0: all of its addresses)",
                       text);
    *port = (int)number;
    return TD_OK;
}

bool panel_door_is_local(const char *host)
{
    return strncmp(host, "127.", 4) == 0;
}
