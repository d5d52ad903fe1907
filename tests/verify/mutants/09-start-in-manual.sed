# StartSim is taken in manual.
s/(\[TD_PHASE_MANUAL\] = \{)(\[)/\1[TD_EVENT_START] = TD_PHASE_SIMULATING, \2/
