/* Where a machine listens, as a master's command line has it. */
#ifndef TELEDIMOS_APPS_MACHINE_ADDRESS_H
#define TELEDIMOS_APPS_MACHINE_ADDRESS_H

#include "core/link.h"

typedef struct machine_address {
    const char *at;        /* HOST:PORT; NULL: no machine */
    const char *token;     /* file */
    const char *authority; /* PEM; NULL: any certificate, where tls */
    bool tls, plain;       /* plain: without TLS beyond this computer, too */
    double period_s;       /* of the heartbeat */
} machine_address;

/* A master's timeout is longer than the machine's: whether the machine is safe is the machine's to judge. The
 * options lend the token, which lies in `token`. */
td_status machine_address_options(td_link_options *options, uint8_t token[TD_LINK_TOKEN_MAX],
                                  const machine_address *address, td_error *error);
/* The same for the images of that session. */
td_link_options machine_address_images(const td_link_options *options,
                                       const uint8_t session[TD_LINK_SESSION_SIZE]);

/* Of a command's option table. */
#define MACHINE_ADDRESS_OPTIONS(address)                                                                      \
    {CLI_STRING, "machine", 0,   &(address).at, "HOST:PORT", "where a machine listens (teledimos machine)",   \
     0,          0,         NULL},                                                                            \
        {CLI_STRING, "machine-token-file", 0, &(address).token, "FILE", "the token that it holds, too", 0, 0, \
         NULL},                                                                                               \
        {CLI_FLAG, "machine-tls",                                                                             \
         0,        &(address).tls,                                                                            \
         NULL,     "TLS, with any certificate: the token alone says who is there",                            \
         0,        0,                                                                                         \
         NULL},                                                                                               \
        {CLI_STRING, "machine-ca",                                                                            \
         0,          &(address).authority,                                                                    \
         "FILE",     "TLS, and its certificate must be believed by this one, PEM",                            \
         0,          0,                                                                                       \
         NULL},                                                                                               \
        {CLI_FLAG, "machine-plain", 0, &(address).plain, NULL, "without TLS beyond this computer, too", 0, 0, \
         NULL},                                                                                               \
    {                                                                                                         \
        CLI_REAL, "machine-period", 0, &(address).period_s, "S",                                              \
            "of the heartbeat, as the machine has it: who is not heard for three of them is lost", 0.02, 10,  \
            NULL                                                                                              \
    }

#endif
