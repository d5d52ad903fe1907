/* Keys as they are pressed, without waiting for Enter. */
#ifndef TELEDIMOS_APPS_KEYS_H
#define TELEDIMOS_APPS_KEYS_H

#include <stdbool.h>

/* The terminal behind standard input gives single keys, unseen, until keys_close or the end of the program;
 * also after Ctrl-Z and fg. False: it is no terminal. */
bool keys_open(void);
void keys_close(void);
/* The next key, waiting up to wait_s; 0: none, -1: there will be no more. Escape sequences are one key: 27.
 */
int keys_next(double wait_s);

#endif
