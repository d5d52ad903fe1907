# A session that failed once cannot be prepared again.
/^static void end_session/,/^}/ s/enter\(s, TD_PHASE_IDLE\);/const td_fault fault = s->fault; & s->fault = fault;/
s/(if \(event == TD_EVENT_START && in->task == 0\))/if (event == TD_EVENT_PREPARE \&\& s->fault) return TD_ANSWER_FAILED;\n        \1/
