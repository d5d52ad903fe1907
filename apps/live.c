/* The live page: one thread serves a page and pushes what it shows over a WebSocket.
 *
 * The caller puts a copy of the view into `pending`; the thread takes it when a browser is there, encodes it
 * once for all browsers (a packet of text, and one for each picture) and sends it to each as fast as that one
 * takes it: a slow browser skips views, and nobody waits for it. */
#include "apps/live.h"

#include <jansson.h>
#include <libwebsockets.h>
#include <math.h>
#include <pthread.h>
#include <signal.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "apps/live_page.h"
#include "core/document.h"

enum {
    PICTURES = 2,
    PACKETS = 1 + PICTURES,
    PRESSES = 16,
    WORD_SIZE = 16,
    LARGEST_WIDTH = 1600, /* px; larger pictures are halved */
    QUALITY = 80,
    PERIOD_US = 1000000 / 15
};

static const char SOCKET_PROTOCOL[] = "teledimos-live";
static const char *const words[] = {"freeze", "store", "done", "skip", NULL};

/* A copy of a live_view. */
typedef struct view {
    int count;
    td_image *image[PICTURES];
    live_mark *mark[PICTURES];
    size_t mark_count[PICTURES];
    char *label[PICTURES], *headline, *facts, *buttons;
    double done;
    bool frozen;
} view;

typedef struct packet {
    size_t size; /* without the room in front that lws_write needs */
    bool binary;
    unsigned char *data; /* LWS_PRE + size */
} packet;

/* An encoded view, held by the page and by the browsers that are being sent it. Only the thread touches it.
 */
typedef struct snapshot {
    unsigned long number; /* from 1 */
    int holders, count;
    packet packet[PACKETS];
} snapshot;

/* One browser, by lws' hand: zeroed when it comes. */
typedef struct client {
    snapshot *sending; /* NULL: has had all of the newest */
    int next;
    unsigned long had; /* number of the last that it has all of */
} client;

struct live {
    struct lws_context *context;
    struct lws_vhost *host;
    lws_sorted_usec_list_t timer;
    pthread_t thread;
    char url[64];
    /* Shared, under the lock: */
    pthread_mutex_t lock;
    bool stop;
    view *pending;
    const char *press[PRESSES];
    size_t press_count;
    /* The thread's own: */
    snapshot *latest;
    int clients;
    bool timer_set;
    lws_usec_t encoded_us;
};

/* ---- views ---- */

static void view_free(view *v)
{
    if (!v) return;
    for (int i = 0; i < PICTURES; i++) {
        td_image_free(&v->image[i]);
        free(v->mark[i]);
        free(v->label[i]);
    }
    free(v->headline);
    free(v->facts);
    free(v->buttons);
    free(v);
}

static bool copy_text(char **copy, const char *text)
{
    *copy = text ? strdup(text) : NULL;
    return !text || *copy;
}

/* A copy small enough for a browser. */
static td_status copy_image(td_image **copy, const td_image *image, td_error *error)
{
    int times = 0;
    *copy = NULL;
    if (!image) return TD_OK;
    while (image->width >> times > LARGEST_WIDTH) times++;
    return td_image_shrink(copy, image, times, error);
}

static td_status copy_picture(view *v, const live_view *from, int i, td_error *error)
{
    const size_t count = from->mark[i] ? from->mark_count[i] : 0;
    TD_TRY(copy_image(&v->image[i], from->image[i], error));
    v->mark[i] = malloc((count + 1) * sizeof *v->mark[i]);
    if (!v->mark[i] || !copy_text(&v->label[i], from->label[i]))
        return td_fail(error, TD_ERROR_MEMORY, "no memory for the live picture");
    if (count) memcpy(v->mark[i], from->mark[i], count * sizeof *v->mark[i]);
    v->mark_count[i] = count;
    /* Marks are told in pixels of the image as it was given. */
    if (v->image[i]) {
        const float scale = (float)v->image[i]->width / (float)from->image[i]->width;
        for (size_t k = 0; k < count && scale < 1; k++) {
            live_mark *m = &v->mark[i][k];
            m->x *= scale, m->y *= scale, m->x2 *= scale, m->y2 *= scale;
        }
    }
    return TD_OK;
}

static td_status view_copy(view **copy, const live_view *from, td_error *error)
{
    view *v = calloc(1, sizeof *v);
    if (!v) return td_fail(error, TD_ERROR_MEMORY, "no memory for the live picture");
    v->count = from->count < 0 ? 0 : from->count > PICTURES ? PICTURES : from->count;
    v->done = from->done;
    v->frozen = from->frozen;
    td_status status = TD_OK;
    for (int i = 0; i < v->count && status == TD_OK; i++) status = copy_picture(v, from, i, error);
    if (status == TD_OK && !(copy_text(&v->headline, from->headline) && copy_text(&v->facts, from->facts) &&
                             copy_text(&v->buttons, from->buttons)))
        status = td_fail(error, TD_ERROR_MEMORY, "no memory for the live picture");
    if (status == TD_OK)
        *copy = v;
    else
        view_free(v);
    return status;
}

/* ---- packets ---- */

static bool packet_fill(packet *p, const void *bytes, size_t size, int index)
{
    const size_t prefix = index >= 0;
    p->data = malloc(LWS_PRE + prefix + size);
    if (!p->data) return false;
    if (prefix) p->data[LWS_PRE] = (unsigned char)index;
    memcpy(p->data + LWS_PRE + prefix, bytes, size);
    p->size = prefix + size;
    p->binary = prefix != 0;
    return true;
}

static json_t *marks_json(const view *v, int i)
{
    json_t *marks = json_array();
    for (size_t k = 0; k < v->mark_count[i]; k++) {
        const live_mark *m = &v->mark[i][k];
        json_t *row = json_array();
        json_array_append_new(row, json_integer(m->kind));
        json_array_append_new(row, td_json_real((double)m->x));
        json_array_append_new(row, td_json_real((double)m->y));
        if (m->kind != LIVE_POINT) {
            json_array_append_new(row, td_json_real((double)m->x2));
            json_array_append_new(row, td_json_real((double)m->y2));
        }
        json_array_append_new(marks, row);
    }
    return marks;
}

/* All but the pixels. Texts that are not UTF-8 become null. */
static char *view_json(const view *v)
{
    json_t *root = json_object(), *pictures = json_array();
    for (int i = 0; i < v->count; i++) {
        json_t *p = json_object();
        json_object_set_new(p, "label", v->label[i] ? json_string(v->label[i]) : NULL);
        json_object_set_new(p, "width", json_integer(v->image[i] ? v->image[i]->width : 0));
        json_object_set_new(p, "height", json_integer(v->image[i] ? v->image[i]->height : 0));
        json_object_set_new(p, "marks", marks_json(v, i));
        json_array_append_new(pictures, p);
    }
    json_object_set_new(root, "pictures", pictures);
    json_object_set_new(root, "headline", v->headline ? json_string(v->headline) : NULL);
    json_object_set_new(root, "facts", v->facts ? json_string(v->facts) : NULL);
    json_object_set_new(root, "buttons", v->buttons ? json_string(v->buttons) : NULL);
    json_object_set_new(root, "done", td_json_real(v->done));
    json_object_set_new(root, "frozen", json_boolean(v->frozen));
    char *text = json_dumps(root, JSON_COMPACT | JSON_REAL_PRECISION(6));
    json_decref(root);
    return text;
}

static void snapshot_release(snapshot **s)
{
    if (*s && --(*s)->holders == 0) {
        for (int i = 0; i < (*s)->count; i++) free((*s)->packet[i].data);
        free(*s);
    }
    *s = NULL;
}

/* A picture that cannot be encoded is left out, and the page told that there is none. */
static snapshot *snapshot_make(view *v)
{
    snapshot *s = calloc(1, sizeof *s);
    if (!s) return NULL;
    s->holders = s->count = 1;
    for (int i = 0; i < v->count; i++) {
        uint8_t *bytes = NULL;
        size_t size = 0;
        if (!v->image[i]) continue;
        if (td_image_encode_jpeg(&bytes, &size, v->image[i], QUALITY, NULL) == TD_OK &&
            packet_fill(&s->packet[s->count], bytes, size, i))
            s->count++;
        else
            td_image_free(&v->image[i]);
        free(bytes);
    }
    char *text = view_json(v);
    if (!text || !packet_fill(&s->packet[0], text, strlen(text), -1)) snapshot_release(&s);
    free(text);
    return s;
}

/* ---- the thread ---- */

static void on_timer(lws_sorted_usec_list_t *timer);

/* Encodes what is pending, when somebody is there to see it and the last was long enough ago. */
static void refresh(live *page)
{
    if (page->clients == 0) return;
    const lws_usec_t since = lws_now_usecs() - page->encoded_us;
    if (since < PERIOD_US) {
        if (!page->timer_set) lws_sul_schedule(page->context, 0, &page->timer, on_timer, PERIOD_US - since);
        page->timer_set = true;
        return;
    }
    pthread_mutex_lock(&page->lock);
    view *v = page->pending;
    page->pending = NULL;
    pthread_mutex_unlock(&page->lock);
    if (!v) return;
    snapshot *made = snapshot_make(v);
    view_free(v);
    if (!made) return;
    made->number = page->latest ? page->latest->number + 1 : 1;
    snapshot_release(&page->latest);
    page->latest = made;
    page->encoded_us = lws_now_usecs();
    lws_callback_on_writable_all_protocol_vhost(page->host,
                                                lws_vhost_name_to_protocol(page->host, SOCKET_PROTOCOL));
}

static void on_timer(lws_sorted_usec_list_t *timer)
{
    live *page = lws_container_of(timer, live, timer);
    page->timer_set = false;
    refresh(page);
}

/* Sends this browser's next packet. Once it has all of one view, it goes on with the newest. */
static int send_next(live *page, struct lws *wsi, client *c)
{
    if (!c->sending && page->latest && page->latest->number != c->had) {
        c->sending = page->latest;
        c->sending->holders++;
        c->next = 0;
    }
    if (!c->sending) return 0;
    const packet *p = &c->sending->packet[c->next++];
    const int wrote =
        lws_write(wsi, p->data + LWS_PRE, p->size, p->binary ? LWS_WRITE_BINARY : LWS_WRITE_TEXT);
    if (c->next == c->sending->count) {
        c->had = c->sending->number;
        snapshot_release(&c->sending);
    }
    if (wrote < (int)p->size) return -1;
    if (c->sending || page->latest->number != c->had) lws_callback_on_writable(wsi);
    return 0;
}

static void keep_press(live *page, const char *text, size_t size)
{
    pthread_mutex_lock(&page->lock);
    for (int i = 0; words[i] && page->press_count < PRESSES; i++)
        if (strlen(words[i]) == size && !memcmp(words[i], text, size))
            page->press[page->press_count++] = words[i];
    pthread_mutex_unlock(&page->lock);
}

/* A page of another site could open a WebSocket to this machine: its browser says where it comes from. */
static bool is_own_origin(struct lws *wsi)
{
    static const char *const own[] = {"http://127.0.0.1", "http://localhost", "http://[::1]"};
    char origin[128];
    const int length = lws_hdr_total_length(wsi, WSI_TOKEN_ORIGIN);
    if (length <= 0) return true; /* no browser */
    if (lws_hdr_copy(wsi, origin, sizeof origin, WSI_TOKEN_ORIGIN) < 0) return false;
    for (size_t i = 0; i < sizeof own / sizeof *own; i++) {
        const size_t n = strlen(own[i]);
        if (!strncmp(origin, own[i], n) && (origin[n] == 0 || origin[n] == ':')) return true;
    }
    return false;
}

static int on_socket(struct lws *wsi, enum lws_callback_reasons reason, void *user, void *in, size_t size)
{
    client *c = user;
    live *page = lws_context_user(lws_get_context(wsi));
    switch (reason) {
    case LWS_CALLBACK_FILTER_PROTOCOL_CONNECTION:
        return is_own_origin(wsi) ? 0 : -1;
    case LWS_CALLBACK_ESTABLISHED:
        page->clients++;
        refresh(page);
        lws_callback_on_writable(wsi);
        return 0;
    case LWS_CALLBACK_CLOSED:
        page->clients--;
        snapshot_release(&c->sending);
        return 0;
    case LWS_CALLBACK_SERVER_WRITEABLE:
        return send_next(page, wsi, c);
    case LWS_CALLBACK_RECEIVE:
        if (size < WORD_SIZE) keep_press(page, in, size);
        return 0;
    default:
        return 0;
    }
}

static int send_page(struct lws *wsi)
{
    static const size_t size = sizeof live_page_html - 1;
    unsigned char head[LWS_PRE + 1024], *begin = head + LWS_PRE, *at = begin, *end = head + sizeof head - 1;
    static const char no_store[] = "no-store";
    if (lws_add_http_common_headers(wsi, HTTP_STATUS_OK, "text/html; charset=utf-8", size, &at, end) ||
        lws_add_http_header_by_token(wsi, WSI_TOKEN_HTTP_CACHE_CONTROL, (const unsigned char *)no_store,
                                     (int)strlen(no_store), &at, end) ||
        lws_finalize_write_http_header(wsi, begin, &at, end))
        return 1;
    lws_callback_on_writable(wsi);
    return 0;
}

/* How much of the page was sent. */
typedef struct request {
    size_t sent;
} request;

static int send_body(struct lws *wsi, request *r)
{
    enum { PIECE = 4096 };
    static const size_t size = sizeof live_page_html - 1;
    unsigned char piece[LWS_PRE + PIECE];
    const size_t left = size - r->sent, now = left < PIECE ? left : PIECE;
    memcpy(piece + LWS_PRE, live_page_html + r->sent, now);
    r->sent += now;
    const bool last = r->sent == size;
    if (lws_write(wsi, piece + LWS_PRE, now, last ? LWS_WRITE_HTTP_FINAL : LWS_WRITE_HTTP) < (int)now)
        return 1;
    if (!last) {
        lws_callback_on_writable(wsi);
        return 0;
    }
    r->sent = 0;
    return lws_http_transaction_completed(wsi) ? -1 : 0;
}

static int on_http(struct lws *wsi, enum lws_callback_reasons reason, void *user, void *in, size_t size)
{
    live *page = lws_context_user(lws_get_context(wsi));
    switch (reason) {
    case LWS_CALLBACK_HTTP:
        ((request *)user)->sent = 0;
        if (!strcmp(in, "/")) return send_page(wsi);
        if (lws_return_http_status(wsi, HTTP_STATUS_NOT_FOUND, NULL)) return -1;
        return lws_http_transaction_completed(wsi) ? -1 : 0;
    case LWS_CALLBACK_HTTP_WRITEABLE:
        return send_body(wsi, user);
    case LWS_CALLBACK_EVENT_WAIT_CANCELLED:
        if (page) refresh(page);
        return 0;
    default:
        return lws_callback_http_dummy(wsi, reason, user, in, size);
    }
}

static const struct lws_protocols protocols[] = {
    {"http", on_http, sizeof(request), 0, 0, NULL, 0},
    {SOCKET_PROTOCOL, on_socket, sizeof(client), 256, 0, NULL, 0},
    {NULL, NULL, 0, 0, 0, NULL, 0},
};

static bool is_stopped(live *page)
{
    pthread_mutex_lock(&page->lock);
    const bool stop = page->stop;
    pthread_mutex_unlock(&page->lock);
    return stop;
}

static void *serve(void *user)
{
    live *page = user;
    while (!is_stopped(page) && lws_service(page->context, 0) >= 0) {
    }
    return NULL;
}

/* ---- what others call ---- */

static void discard(live *page)
{
    if (page->context) lws_context_destroy(page->context);
    snapshot_release(&page->latest);
    view_free(page->pending);
    pthread_mutex_destroy(&page->lock);
    free(page);
}

static td_status listen_on(live *page, int port, td_error *error)
{
    struct lws_context_creation_info info = {0};
    info.port = port;
    info.iface = "127.0.0.1";
    info.protocols = protocols;
    info.user = page;
    info.gid = (gid_t)-1;
    info.uid = (uid_t)-1;
    info.options = LWS_SERVER_OPTION_EXPLICIT_VHOSTS | LWS_SERVER_OPTION_DISABLE_IPV6 |
                   LWS_SERVER_OPTION_FAIL_UPON_UNABLE_TO_BIND;
    lws_set_log_level(0, NULL);
    page->context = lws_create_context(&info);
    if (!page->context) return td_fail(error, TD_ERROR_EXTERNAL, "the live page's server cannot be made");
    page->host = lws_create_vhost(page->context, &info);
    if (!page->host)
        return td_fail(error, TD_ERROR_IO,
                       "the live page cannot be served at 127.0.0.1:%d; is another program using this port? "
                       "Give another by --port",
                       port);
    snprintf(page->url, sizeof page->url, "http://127.0.0.1:%d/", lws_get_vhost_listen_port(page->host));
    return TD_OK;
}

td_status live_open(live **page, int port, td_error *error)
{
    *page = NULL;
    live *made = calloc(1, sizeof *made);
    if (!made) return td_fail(error, TD_ERROR_MEMORY, "no memory for the live page");
    pthread_mutex_init(&made->lock, NULL);
    td_status status = listen_on(made, port, error);
    /* Signals are the main thread's. */
    sigset_t all, before;
    sigfillset(&all);
    pthread_sigmask(SIG_SETMASK, &all, &before);
    if (status == TD_OK && pthread_create(&made->thread, NULL, serve, made) != 0)
        status = td_fail(error, TD_ERROR_EXTERNAL, "the live page's thread cannot be started");
    pthread_sigmask(SIG_SETMASK, &before, NULL);
    if (status == TD_OK)
        *page = made;
    else
        discard(made);
    return status;
}

void live_close(live **page)
{
    if (!page || !*page) return;
    live *p = *page;
    pthread_mutex_lock(&p->lock);
    p->stop = true;
    pthread_mutex_unlock(&p->lock);
    lws_cancel_service(p->context);
    pthread_join(p->thread, NULL);
    discard(p);
    *page = NULL;
}

const char *live_url(const live *page)
{
    return page->url;
}

td_status live_show(live *page, const live_view *from, td_error *error)
{
    view *copy = NULL;
    TD_TRY(view_copy(&copy, from, error));
    pthread_mutex_lock(&page->lock);
    view *before = page->pending;
    page->pending = copy;
    pthread_mutex_unlock(&page->lock);
    view_free(before);
    lws_cancel_service(page->context);
    return TD_OK;
}

const char *live_pressed(live *page)
{
    const char *word = NULL;
    pthread_mutex_lock(&page->lock);
    if (page->press_count > 0) {
        word = page->press[0];
        memmove(page->press, page->press + 1, --page->press_count * sizeof *page->press);
    }
    pthread_mutex_unlock(&page->lock);
    return word;
}
