# Manual moves without the jog key.
s/(\[TD_PHASE_MANUAL\] = \{)TD_DRIVE_HOLD/\1TD_DRIVE_JOG/
