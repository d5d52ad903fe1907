# What the machine holds is not looked at.
s/ \|\| \(held && in->machine_task != s->task\)//
