#include "apps/panel_page.h"

#include <stdio.h>
#include <string.h>

/* How to connect by other programs; and in the page's place where that is not installed. */
static td_status add_page_of_text(panel_files *files, const char *path, const char *url, bool locked,
                                  bool installed, td_error *error)
{
    char page[1600];
    snprintf(
        page, sizeof page,
        "<!doctype html><html lang=en><meta charset=utf-8><title>teledimos panel</title>\n"
        "<h1>teledimos panel</h1>\n"
        "<p>A machine's session in real time, by the Foxglove WebSocket protocol.%s\n"
        "<p>In Foxglove choose <i>Open connection, Foxglove WebSocket</i>, and give <code>%s</code>%s.\n"
        "Its 3D panel shows <code>/tf</code>, <code>/machine</code> and <code>/terrain</code>; plots take\n"
        "<code>/joints.joints[:]{name==\"boom\"}.position</code>. Its Service Call panel leads the session:\n"
        "TakeControl, StartSim, Pause, Resume, UserStop, Prepare, Reinit.\n"
        "<p>A page of another origin is let in where <code>--origin</code> names it, as\n"
        "<code>--origin https://app.foxglove.dev</code>.\n",
        installed ? "" : " (The operator's page is not installed: share/teledimos/panel.)", url,
        locked ? "?token=… with the token's text" : "");
    return panel_files_add(files, path, "text/html; charset=utf-8", page, strlen(page), error);
}

td_status panel_page_begin(panel_files *files, const char *url, bool locked, td_error *error)
{
    char folder[1100];
    if (panel_files_place(folder, sizeof folder)) TD_TRY(panel_files_read(files, folder, error));
    const bool installed = panel_files_find(files, "/") != NULL;
    TD_TRY(add_page_of_text(files, "/connect", url, locked, installed, error));
    return installed ? TD_OK : add_page_of_text(files, "/", url, locked, false, error);
}

/* Nothing from elsewhere is loaded, framed or sent to; the token, which may stand in the address, is told to
 * nobody. */
static int add_headers(struct lws *wsi, const panel_file *f, bool packed, unsigned char **at,
                       unsigned char *end)
{
    const struct {
        const char *name, *value;
    } rows[] = {
        {"cache-control:", "no-cache"},
        {"etag:", f->tag},
        {"vary:", "accept-encoding"},
        {"content-security-policy:",
         "default-src 'none'; script-src 'self'; style-src 'self'; img-src 'self' data: blob:; connect-src "
         "'self'; base-uri 'none'; form-action 'none'; frame-ancestors 'none'"},
        {"x-content-type-options:", "nosniff"},
        {"referrer-policy:", "no-referrer"},
        {"content-encoding:", packed ? "gzip" : NULL},
    };
    for (size_t i = 0; i < sizeof rows / sizeof *rows; i++)
        if (rows[i].value && lws_add_http_header_by_name(wsi, (const unsigned char *)rows[i].name,
                                                         (const unsigned char *)rows[i].value,
                                                         (int)strlen(rows[i].value), at, end))
            return 1;
    return 0;
}

static bool header_holds(struct lws *wsi, enum lws_token_indexes header, const char *word)
{
    char text[300] = "";
    return lws_hdr_copy(wsi, text, sizeof text, header) > 0 && strstr(text, word) != NULL;
}

int panel_page_send(struct lws *wsi, transfer *t, const panel_file *f)
{
    unsigned char head[LWS_PRE + 2048], *begin = head + LWS_PRE, *at = begin, *end = head + sizeof head - 1;
    const bool known = header_holds(wsi, WSI_TOKEN_HTTP_IF_NONE_MATCH, f->tag);
    const bool packed = f->packed && header_holds(wsi, WSI_TOKEN_HTTP_ACCEPT_ENCODING, "gzip");
    *t = (transfer){packed ? f->packed : f->data, packed ? f->packed_size : f->size, 0};
    if (known) t->size = 0;
    if (lws_add_http_common_headers(wsi, known ? HTTP_STATUS_NOT_MODIFIED : HTTP_STATUS_OK, f->type, t->size,
                                    &at, end) ||
        add_headers(wsi, f, packed, &at, end) || lws_finalize_write_http_header(wsi, begin, &at, end))
        return 1;
    if (t->size == 0) return lws_http_transaction_completed(wsi) ? -1 : 0;
    lws_callback_on_writable(wsi);
    return 0;
}

int panel_page_send_more(struct lws *wsi, transfer *t, unsigned char *piece, size_t room)
{
    if (!t || t->given >= t->size) return 0;
    const size_t left = t->size - t->given, size = left < room ? left : room;
    memcpy(piece, t->data + t->given, size);
    t->given += size;
    if (lws_write(wsi, piece, size, size == left ? LWS_WRITE_HTTP_FINAL : LWS_WRITE_HTTP) < (int)size)
        return 1;
    if (size == left) return lws_http_transaction_completed(wsi) ? -1 : 0;
    lws_callback_on_writable(wsi);
    return 0;
}
