#include "apps/job.h"

#include <stdlib.h>
#include <string.h>

#include "core/document.h"
#include "core/file.h"
#include "core/linalg.h"

int job_begin(job *j, cli_command *command, const cli_common *common, const td_schema_row *schema,
              size_t schema_count, bool need_output, int argc, char **argv)
{
    *j = (job){.command = command, .common = common, .schema = schema, .schema_count = schema_count};
    int status = cli_parse(command, argc, argv);
    if (status >= 0) return status;
    if (common->schema) {
        char *text = td_schema_describe(schema, schema_count);
        if (text) fputs(text, stdout);
        free(text);
        return EXIT_DONE;
    }
    if (need_output && (!common->output || !*common->output)) {
        cli_complain(command->name, "-o DIR is missing (usage: teledimos %s %s)", command->name,
                     command->usage);
        return EXIT_USAGE;
    }
    terminal_catch_signals();
    td_linalg_single_thread();
    terminal_init(&j->term, common->quiet, common->verbose);
    j->term.log_file = open_memstream(&j->log_text, &j->log_size);
    if (!j->term.log_file) {
        cli_complain(command->name, "out of memory");
        return EXIT_FAILED;
    }
    j->log = terminal_log(&j->term);
    j->progress = terminal_progress(&j->term);
    return -1;
}

char *job_path(job *j, const char *name)
{
    char *path = td_path_join(j->common->output, name);
    if (!path) td_fail(&j->error, TD_ERROR_MEMORY, "no memory for a path");
    return path;
}

static td_status write_text(job *j, const char *name, const char *text, size_t size)
{
    char *path = job_path(j, name);
    if (!path) return TD_ERROR_MEMORY;
    td_status status = td_file_write(path, text, size, &j->error);
    free(path);
    return status;
}

static td_status write_report(job *j, const job_output *output)
{
    if (!output->report) return TD_OK;
    char *path = job_path(j, "report.html");
    if (!path) return TD_ERROR_MEMORY;
    td_status status = output->report(output->data, path, &j->error);
    free(path);
    return status;
}

static td_status write_products(job *j, const json_t *result, const job_output *output)
{
    char *yaml = NULL;
    TD_TRY(td_folder_make(j->common->output, &j->error));
    TD_TRY(write_report(j, output));
    fflush(j->term.log_file);
    TD_TRY(write_text(j, "log.jsonl", j->log_text, j->log_size));
    TD_TRY(td_document_to_yaml(&yaml, result, 15, &j->error));
    td_status status = write_text(j, "result.yaml", yaml, strlen(yaml));
    free(yaml);
    return status;
}

static td_status print(job *j, const json_t *result, const job_output *output)
{
    if (j->common->json) {
        char *text = NULL;
        TD_TRY(td_document_to_json(&text, result, 15, &j->error));
        fputs(text, stdout);
        free(text);
    } else {
        if (output->table) output->table(output->data);
        if (output->report && j->common->output) printf("\nreport: %s/report.html\n", j->common->output);
    }
    if (fflush(stdout) != 0 || ferror(stdout))
        return td_fail(&j->error, TD_ERROR_IO, "standard output cannot be written");
    return TD_OK;
}

td_status job_finish(job *j, json_t *result, const job_output *output)
{
    terminal_clear(&j->term);
    td_status status = td_schema_check(result, j->schema, j->schema_count, &j->error);
    if (status == TD_OK && terminal_interrupted())
        status = td_fail(&j->error, TD_ERROR_CANCELLED, "interrupted");
    if (status == TD_OK && j->common->output) status = write_products(j, result, output);
    if (status == TD_OK) status = print(j, result, output);
    json_decref(result);
    return status;
}

int job_end(job *j, td_status status, bool refused)
{
    terminal_clear(&j->term);
    /* Libraries know only that they were told to stop. */
    if (status == TD_ERROR_CANCELLED && !strstr(j->error.message, "interrupted"))
        td_error_prefix(&j->error, status, "interrupted");
    if (status != TD_OK)
        cli_complain(j->command->name, "%s", j->error.message[0] ? j->error.message : td_status_text(status));
    if (j->term.log_file) fclose(j->term.log_file);
    free(j->log_text);
    if (status != TD_OK) return status == TD_ERROR_ARGUMENT ? EXIT_USAGE : EXIT_FAILED;
    return refused ? EXIT_REFUSED : EXIT_DONE;
}
