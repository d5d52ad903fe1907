# What was executed can be executed again, from where it ended.
s/(\[TD_PHASE_MONITORING\] = \{)(\[)/\1[TD_EVENT_EXECUTE] = TD_PHASE_EXECUTING, \2/
