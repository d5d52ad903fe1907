/* The calibration wizard: from a person with a board and a camera to a dataset that can be calibrated.
 *
 * It asks where pictures come from and what the target is, looks at each picture as it comes, says which one
 * to take next, and when more of them no longer help. All it knows stands in the folder of the results at any
 * time (wizard.yaml: the answers; dataset.yaml, frames.csv, images/: the dataset), so that it can be ended
 * or killed and gone on with. */
#ifndef TELEDIMOS_APPS_WIZARD_H
#define TELEDIMOS_APPS_WIZARD_H

#include "apps/cli.h"
#include "apps/terminal.h"
#include "core/status.h"

/* What was given on the command line; NULL or 0: ask. */
typedef struct wizard_setup {
    const char *folder;
    const cli_list *sources;
    const char *target, *model, *live;
    bool resume;
    int threads;
} wizard_setup;

/* *folder (to be freed with free()) holds the dataset when the person has finished. TD_ERROR_CANCELLED: left,
 * to be resumed. */
td_status wizard_run(char **folder, const wizard_setup *setup, terminal *term, td_error *error);

#endif
