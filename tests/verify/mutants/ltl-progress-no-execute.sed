# Execute sends the task again, for ever.
s/(\[TD_EVENT_EXECUTE\] = )TD_PHASE_EXECUTING/\1TD_PHASE_DOWNLOADING/
