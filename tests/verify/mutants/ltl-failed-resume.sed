# After a failure Resume goes on.
s/(\[TD_PHASE_FAILED\] = \{)(\[)/\1[TD_EVENT_RESUME] = TD_PHASE_SIMULATING, \2/
