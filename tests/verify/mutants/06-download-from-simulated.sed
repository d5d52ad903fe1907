# What is simulated can be downloaded.
s/(\[TD_PHASE_SIMULATED\] = \{)(\[)/\1[TD_EVENT_DOWNLOAD] = TD_PHASE_DOWNLOADING, \2/
