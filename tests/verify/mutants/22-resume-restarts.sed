# Resume begins the motion anew.
s/out->begin = event == TD_EVENT_START/& || event == TD_EVENT_RESUME/
