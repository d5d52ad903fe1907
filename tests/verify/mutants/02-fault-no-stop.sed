# A fault in a pause fails, but holds instead of stopping.
/^static void fail/,/^}/ s/out->drive = TD_DRIVE_STOP;/if (out->drive != TD_DRIVE_HOLD) &/
