# A fault keeps the operator from ending the session.
s/if \(came\(in, TD_EVENT_USER_STOP\)\) \{/if (!fault \&\& came(in, TD_EVENT_USER_STOP)) {/
