#include "apps/machine_address.h"

#include <math.h>
#include <string.h>

#include "core/machine_messages.h"

static const double PATIENT_PERIODS = 10, IMAGES_TIMES = 10;

td_status machine_address_options(td_link_options *options, uint8_t token[TD_LINK_TOKEN_MAX],
                                  const machine_address *address, td_error *error)
{
    size_t size = 0;
    if (!address->token)
        return td_fail(error, TD_ERROR_ARGUMENT,
                       "--machine-token-file is missing: a file of the token that the machine holds, too");
    TD_TRY(td_link_token_read(token, &size, address->token, error));
    *options = td_link_options_default();
    options->token = token;
    options->token_size = size;
    options->period_s = address->period_s;
    options->timeout_s = PATIENT_PERIODS * address->period_s;
    options->handshake_s = fmax(options->handshake_s, 2 * options->timeout_s);
    options->tls = address->tls || address->authority;
    options->authority = address->authority;
    options->plain_anywhere = address->plain;
    return TD_OK;
}

td_link_options machine_address_images(const td_link_options *options,
                                       const uint8_t session[TD_LINK_SESSION_SIZE])
{
    td_link_options o = *options;
    o.channel = TD_MACHINE_IMAGES;
    memcpy(o.session, session, sizeof o.session);
    o.frame_max = (size_t)TD_MACHINE_MAX_IMAGE + 4096;
    o.bytes_per_s = 64 << 20;
    o.timeout_s *= IMAGES_TIMES;
    return o;
}
