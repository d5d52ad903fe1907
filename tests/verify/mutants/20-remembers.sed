# The function remembers between calls.
s/^(    memset\(outputs, 0, sizeof \*outputs\);)/    static uint32_t calls;\n\1\n    if (++calls % 2) outputs->messages = 1;/
