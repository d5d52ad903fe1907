#include "apps/keys.h"

#include <errno.h>
#include <poll.h>
#include <stdlib.h>
#include <termios.h>
#include <unistd.h>

static struct termios before;
static bool opened;

void keys_close(void)
{
    if (opened) tcsetattr(STDIN_FILENO, TCSANOW, &before);
    opened = false;
}

bool keys_open(void)
{
    if (opened) return true;
    if (tcgetattr(STDIN_FILENO, &before) != 0) return false;
    struct termios raw = before;
    raw.c_lflag &= ~(tcflag_t)(ICANON | ECHO);
    raw.c_cc[VMIN] = 1;
    raw.c_cc[VTIME] = 0;
    if (tcsetattr(STDIN_FILENO, TCSANOW, &raw) != 0) return false;
    static bool registered;
    if (!registered) atexit(keys_close);
    registered = true;
    return opened = true;
}

static bool ready(double wait_s)
{
    struct pollfd input = {.fd = STDIN_FILENO, .events = POLLIN};
    return poll(&input, 1, (int)(1000 * wait_s)) > 0;
}

int keys_next(double wait_s)
{
    unsigned char byte;
    if (!ready(wait_s)) return 0;
    ssize_t got = read(STDIN_FILENO, &byte, 1);
    if (got < 0) return errno == EINTR ? 0 : -1;
    if (got == 0) return -1;
    unsigned char rest;
    for (int i = 0; byte == 27 && i < 8 && ready(0.01); i++)
        if (read(STDIN_FILENO, &rest, 1) != 1) break;
    return byte;
}
