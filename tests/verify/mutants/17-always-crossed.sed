# Singularities are crossed whatever the options say.
s/ && s->options.singularity == TD_SINGULARITY_CROSS//
