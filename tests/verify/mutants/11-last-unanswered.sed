# The list's last event gets no answer.
/^void td_behaviour_react/,/^}/ s/e < TD_EVENT_COUNT/e < TD_EVENT_COUNT - 1/
