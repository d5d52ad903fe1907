# Abort waits for the motion's end, when both come together.
s/\} else if \(came\(in, TD_EVENT_ABORT\)\) \{/} else if (came(in, TD_EVENT_ABORT) \&\& !came(in, TD_EVENT_ENDED)) {/
