# After a lost link Reinit waits for the link, which only Reinit opens.
s/(if \(event == TD_EVENT_START && in->task == 0\))/if (event == TD_EVENT_REINIT \&\& s->fault == TD_FAULT_LINK_LOST \&\& !in->links_open) return TD_ANSWER_FAILED;\n        \1/
