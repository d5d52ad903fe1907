# A simulation that is paused can be validated.
s/(\[TD_PHASE_SIMULATION_PAUSED\] = \{)(\[)/\1[TD_EVENT_VALIDATE] = TD_PHASE_VALIDATED, \2/
