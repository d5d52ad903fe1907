# What is ready can be executed.
s/(\[TD_PHASE_READY\] = \{)(\[)/\1[TD_EVENT_EXECUTE] = TD_PHASE_EXECUTING, \2/
