# A task that changes after it was validated stays validated.
s/\} else if \(task_changed\(s, in\)\) \{/} else if (s->phase == TD_PHASE_SIMULATED \&\& task_changed(s, in)) {/
s/(\[TD_PHASE_DOWNLOADING\] = \{TD_DRIVE_REST, true, )true/\1false/
