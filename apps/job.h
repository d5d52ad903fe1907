/* What every job does around its own work: it parses and answers --schema, shows messages and progress, keeps
 * the log, writes result.yaml, report.html and log.jsonl, prints a table or JSON, and ends with the right
 * status. */
#ifndef TELEDIMOS_APPS_JOB_H
#define TELEDIMOS_APPS_JOB_H

#include <jansson.h>

#include "apps/cli.h"
#include "apps/gate.h"
#include "apps/terminal.h"
#include "core/schema.h"

typedef struct job {
    cli_command *command;
    const cli_common *common;
    const td_schema_row *schema;
    size_t schema_count;
    terminal term;
    td_log log;
    td_progress progress;
    char *log_text; /* log.jsonl so far */
    size_t log_size;
    td_error error;
} job;

/* Parses the command line and makes ready. -1: go on; else the exit status (of --help, --schema, wrong
 * usage). `need_output`: without -o it is wrong usage. */
int job_begin(job *j, cli_command *command, const cli_common *common, const td_schema_row *schema,
              size_t schema_count, bool need_output, int argc, char **argv);

/* How a job's own data become a report and a table on the terminal; each may be NULL. */
typedef struct job_output {
    td_status (*report)(const void *data, const char *path, td_error *error);
    void (*table)(const void *data);
    const void *data;
} job_output;

/* Checks the result against the schema, writes report.html, log.jsonl and result.yaml into -o (when given),
 * prints JSON or the table. Takes the reference to `result`. Nothing is written once interrupted. */
td_status job_finish(job *j, json_t *result, const job_output *output);

/* DIR/name; NULL (with the error filled) when out of memory. To be freed with free(). */
char *job_path(job *j, const char *name);

/* Complains of `status` if it is a failure, frees what the job holds, and says the exit status. */
int job_end(job *j, td_status status, bool refused);

#endif
