/* Status codes and error messages: how every function of the library says that it failed, and why. */
#ifndef TELEDIMOS_CORE_STATUS_H
#define TELEDIMOS_CORE_STATUS_H

#if defined(__GNUC__)
#define TD_API __attribute__((visibility("default")))
#define TD_PRINTF(format_index, first_argument) __attribute__((format(printf, format_index, first_argument)))
#else
#define TD_API
#define TD_PRINTF(format_index, first_argument)
#endif

#ifdef __cplusplus
extern "C" {
#endif

/* The one list of codes: the enum, the texts and the test loop expand from it. */
#define TD_STATUS_LIST(X)                                                                                    \
    X(TD_OK, "success")                                                                                      \
    X(TD_ERROR_ARGUMENT, "an argument is missing or illegal")                                                \
    X(TD_ERROR_MEMORY, "out of memory")                                                                      \
    X(TD_ERROR_IO, "a file cannot be read or written")                                                       \
    X(TD_ERROR_FORMAT, "a file's content is not what it should be")                                          \
    X(TD_ERROR_NOT_FOUND, "what was looked for is not there")                                                \
    X(TD_ERROR_DATA, "the data do not determine the result")                                                 \
    X(TD_ERROR_CONVERGENCE, "an iteration did not converge")                                                 \
    X(TD_ERROR_CANCELLED, "cancelled")                                                                       \
    X(TD_ERROR_UNSUPPORTED, "not supported by this build")                                                   \
    X(TD_ERROR_EXTERNAL, "a library underneath failed")                                                      \
    X(TD_ERROR_DEADLINE, "a deadline was missed")

typedef enum td_status {
#define TD_STATUS_ENUM(code, text) code,
    TD_STATUS_LIST(TD_STATUS_ENUM)
#undef TD_STATUS_ENUM
        TD_STATUS_COUNT
} td_status;

/* What went wrong, for a person: names the file, the view or the field, and what to do next. */
typedef struct td_error {
    td_status status;
    char message[1024];
} td_error;

/* The general text of a code; "unknown status" for a number that is none. Never NULL. */
TD_API const char *td_status_text(td_status status);

/* Fills `error` (may be NULL) and returns `status`, so that a function can `return td_fail(...)`. */
TD_API td_status td_fail(td_error *error, td_status status, const char *format, ...) TD_PRINTF(3, 4);

/* Puts "WHERE: " before the message of an error on its way up. Returns the error's status. */
TD_API td_status td_error_prefix(td_error *error, td_status status, const char *format, ...) TD_PRINTF(3, 4);

/* Hands a failure on to the caller. For functions that own nothing that must be freed. */
#define TD_TRY(expression)                                                                                   \
    do {                                                                                                     \
        td_status try_status_ = (expression);                                                                \
        if (try_status_ != TD_OK) return try_status_;                                                        \
    } while (0)

#ifdef __cplusplus
}
#endif
#endif
