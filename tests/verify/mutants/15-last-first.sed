# The least urgent order wins.
s/for \(td_event e = TD_EVENT_ENDED; e < TD_EVENT_COUNT; e\+\+\)/for (td_event e = TD_EVENT_COUNT - 1; e >= TD_EVENT_ENDED; e--)/
