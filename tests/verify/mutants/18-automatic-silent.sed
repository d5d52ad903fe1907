# Leaving manual drops the motion without a stop.
/if \(event == TD_EVENT_AUTOMATIC\) out->drive/d
