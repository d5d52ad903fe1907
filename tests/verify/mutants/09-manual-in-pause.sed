# Manual can be chosen while a simulation is paused.
s/(\[TD_PHASE_SIMULATION_PAUSED\] = \{)(\[)/\1[TD_EVENT_MANUAL] = TD_PHASE_MANUAL, \2/
