# Manual does not look at the links.
s/(\[TD_PHASE_MANUAL\] = \{TD_DRIVE_HOLD, )true/\1false/
