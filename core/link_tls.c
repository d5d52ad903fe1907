/* TLS as a filter of bytes: OpenSSL reads from memory and writes to it. */
#include <arpa/inet.h>
#include <openssl/bio.h>
#include <openssl/err.h>
#include <openssl/ssl.h>
#include <openssl/x509v3.h>
#include <stdio.h>

#include "core/link_internal.h"

static const char *reason(void)
{
    const char *text = ERR_reason_error_string(ERR_peek_last_error());
    return text ? text : "no reason given";
}

void link_tls_context_free(SSL_CTX **context)
{
    SSL_CTX_free(*context);
    *context = NULL;
}

static td_status begin(SSL_CTX **context, const SSL_METHOD *method, td_error *error)
{
    ERR_clear_error();
    *context = SSL_CTX_new(method);
    if (*context && SSL_CTX_set_min_proto_version(*context, TLS1_3_VERSION) == 1) return TD_OK;
    link_tls_context_free(context);
    return td_fail(error, TD_ERROR_EXTERNAL, "OpenSSL offers no TLS 1.3 here: %s", reason());
}

td_status link_tls_server(SSL_CTX **context, const td_link_options *o, td_error *error)
{
    const char *wrong = NULL;
    TD_TRY(begin(context, TLS_server_method(), error));
    SSL_CTX_set_num_tickets(*context, 0);
    if (SSL_CTX_use_certificate_chain_file(*context, o->certificate) != 1)
        wrong = o->certificate;
    else if (SSL_CTX_use_PrivateKey_file(*context, o->key, SSL_FILETYPE_PEM) != 1 ||
             SSL_CTX_check_private_key(*context) != 1)
        wrong = o->key;
    if (!wrong) return TD_OK;
    td_fail(error, TD_ERROR_DATA, "%s: is no %s in PEM that can be used here: %s", wrong,
            wrong == o->key ? "key of the certificate," : "certificate", reason());
    link_tls_context_free(context);
    return TD_ERROR_DATA;
}

td_status link_tls_client(SSL_CTX **context, const td_link_options *o, td_error *error)
{
    TD_TRY(begin(context, TLS_client_method(), error));
    if (!o->authority) return TD_OK;
    SSL_CTX_set_verify(*context, SSL_VERIFY_PEER, NULL);
    if (SSL_CTX_load_verify_locations(*context, o->authority, NULL) == 1) return TD_OK;
    td_fail(error, TD_ERROR_DATA, "%s: is no certificate in PEM: %s", o->authority, reason());
    link_tls_context_free(context);
    return TD_ERROR_DATA;
}

static bool name_host(SSL *tls, const char *host)
{
    unsigned char address[16];
    const bool number = inet_pton(AF_INET, host, address) == 1 || inet_pton(AF_INET6, host, address) == 1;
    if (number) return X509_VERIFY_PARAM_set1_ip_asc(SSL_get0_param(tls), host) == 1;
    return SSL_set_tlsext_host_name(tls, host) == 1 && SSL_set1_host(tls, host) == 1;
}

td_status link_tls_begin(td_link *link, SSL_CTX *context, const char *host, td_error *error)
{
    SSL *tls = SSL_new(context);
    BIO *in = BIO_new(BIO_s_mem()), *out = BIO_new(BIO_s_mem());
    if (!tls || !in || !out || (host && !name_host(tls, host))) {
        SSL_free(tls);
        BIO_free(in);
        BIO_free(out);
        return td_fail(error, TD_ERROR_EXTERNAL, "OpenSSL cannot begin TLS: %s", reason());
    }
    BIO_set_mem_eof_return(in, -1);
    BIO_set_mem_eof_return(out, -1);
    SSL_set_bio(tls, in, out);
    if (link->server)
        SSL_set_accept_state(tls);
    else
        SSL_set_connect_state(tls);
    link->tls = tls;
    return TD_OK;
}

void link_tls_end(td_link *link)
{
    SSL_free(link->tls);
    link->tls = NULL;
}

/* What OpenSSL has written, on its way. */
static void drain(td_link *link)
{
    uint8_t bytes[16384];
    int n;
    while ((n = BIO_read(SSL_get_wbio(link->tls), bytes, sizeof bytes)) > 0)
        if (!link_bytes_add(&link->out, bytes, (size_t)n)) link_fail(link, "no memory for a link");
}

/* Whether to go on later. */
static bool is_waiting(td_link *link, int result)
{
    const int code = SSL_get_error(link->tls, result);
    if (code == SSL_ERROR_WANT_READ || code == SSL_ERROR_WANT_WRITE) return true;
    const long verified = SSL_get_verify_result(link->tls);
    if (code == SSL_ERROR_ZERO_RETURN)
        link_fail(link, "the other end ended TLS");
    else if (link->o.authority && verified != X509_V_OK)
        link_fail(link, "the other end's certificate is not believed: %s",
                  X509_verify_cert_error_string(verified));
    else
        link_fail(link, "TLS: %s; do both sides speak TLS?", reason());
    return false;
}

static void shake_hands(td_link *link)
{
    static const char LABEL[] = "EXPORTER-teledimos-link";
    const int result = SSL_do_handshake(link->tls);
    if (result != 1) {
        is_waiting(link, result);
        return;
    }
    if (SSL_export_keying_material(link->tls, link->binding, sizeof link->binding, LABEL, sizeof LABEL - 1,
                                   NULL, 0, 0) != 1) {
        link_fail(link, "TLS: %s", reason());
        return;
    }
    link_say_hello(link);
}

void link_tls_take(td_link *link, const void *bytes, size_t size)
{
    uint8_t plain[16384];
    ERR_clear_error();
    if (size && BIO_write(SSL_get_rbio(link->tls), bytes, (int)size) != (int)size)
        link_fail(link, "no memory for a link");
    if (link->state == TD_LINK_CONNECTING) shake_hands(link);
    while (link->state > TD_LINK_CONNECTING && link->state < TD_LINK_CLOSED) {
        const int n = SSL_read(link->tls, plain, sizeof plain);
        if (n <= 0) {
            is_waiting(link, n);
            break;
        }
        if (!link_bytes_add(&link->in, plain, (size_t)n)) link_fail(link, "no memory for a link");
    }
    drain(link);
}

void link_tls_write(td_link *link, const void *bytes, size_t size)
{
    ERR_clear_error();
    const int n = SSL_write(link->tls, bytes, (int)size);
    if (n != (int)size) link_fail(link, "TLS: %s", reason());
    drain(link);
}
