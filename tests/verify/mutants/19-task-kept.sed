# An aborted task stays at hand.
/if \(!phases\[phase\].task\) s->task = 0;/d
