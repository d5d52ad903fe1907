# One deadline more is forgiven.
s/s->deadlines < s->options.deadlines_forgiven/s->deadlines <= s->options.deadlines_forgiven/
