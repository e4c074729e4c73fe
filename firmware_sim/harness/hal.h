/* All that the harness asks of a board: three functions. */
#ifndef SERVOGEN_HAL_H
#define SERVOGEN_HAL_H

#include <stddef.h>

void hal_init(void);
void hal_write(const char *text, size_t length);
void hal_exit(int code); /* does not return; `code` becomes the emulator's or the process's exit code */

#endif
