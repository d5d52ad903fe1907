# Abort while preparing stops nothing.
/^static void give_up/,/^}/ s/out->drive = TD_DRIVE_STOP;/if (!out->close_links) &/
