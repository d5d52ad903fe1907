/* Any bytes as a client's message, text and binary: no crash; a sentence for what is refused, and what is
 * taken keeps its bounds and can be answered. */
#include <stdint.h>
#include <stdlib.h>
#include <string.h>

#include "apps/panel_protocol.h"

int LLVMFuzzerTestOneInput(const uint8_t *data, size_t size);

static void answer(const panel_request *r)
{
    panel_bytes all[] = {panel_failure(r->service, r->call, "no"),
                         panel_response(r->service, r->call, json_incref(r->arguments)),
                         panel_parameter_values(json_incref(r->parameters), r->id)};
    for (size_t i = 0; i < sizeof all / sizeof *all; i++) {
        if (all[i].data && all[i].size == 0) abort();
        free(all[i].data);
    }
}

int LLVMFuzzerTestOneInput(const uint8_t *data, size_t size)
{
    for (int binary = 0; binary < 2; binary++) {
        panel_request r;
        td_error error = {0};
        if (panel_request_parse(&r, data, size, binary, &error) == TD_OK) {
            if (r.count > PANEL_MAX_LIST || strlen(r.id) >= PANEL_ID_SIZE) abort();
            if (json_array_size(r.parameters) > PANEL_MAX_LIST) abort();
            if ((r.op == PANEL_CALL) != (binary == 1) || !panel_op_name(r.op)) abort();
            if (binary && !json_is_object(r.arguments)) abort();
            answer(&r);
        } else if (!error.message[0] || r.parameters || r.subscription || r.arguments)
            abort();
        panel_request_free(&r);
    }
    return 0;
}
