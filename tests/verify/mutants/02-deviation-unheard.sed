# A deviation is not among the faults.
s/\{TD_EVENT_DEVIATION, TD_FAULT_DEVIATION\}, *//
