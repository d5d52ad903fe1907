# The paused execution is driven on.
s/(\[TD_PHASE_EXECUTION_PAUSED\] = \{)TD_DRIVE_HOLD/\1TD_DRIVE_EXECUTE/
