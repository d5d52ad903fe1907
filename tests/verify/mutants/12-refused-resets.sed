# StartSim that is refused for want of a task forgets the missed deadlines.
s/^    outputs->phase = state->phase;/    if (outputs->messages == 0 \&\& came(inputs, TD_EVENT_START) \&\& !inputs->task) state->deadlines = 0;\n&/
