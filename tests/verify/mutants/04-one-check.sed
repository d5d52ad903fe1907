# One passed check is enough.
s/in->links_open && in->parameters_read\)/(in->links_open || in->parameters_read))/
