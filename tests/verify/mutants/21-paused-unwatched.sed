# A paused execution is not watched.
s/(\[TD_PHASE_EXECUTION_PAUSED\] = \{TD_DRIVE_HOLD, true, true, true, true, )true/\1false/
