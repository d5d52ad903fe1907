# Missed deadlines are counted over all runs.
s/if \(out->begin \|\| event == TD_EVENT_MANUAL \|\| /if (/
