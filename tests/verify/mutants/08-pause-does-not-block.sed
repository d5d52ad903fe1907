# StartSim that comes with a refused Pause starts.
/if \(e == TD_EVENT_PAUSE\) break;/d
