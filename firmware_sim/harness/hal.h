/* All that the harness asks of a board: three functions, and two probes around a call. */
#ifndef SERVOGEN_HAL_H
#define SERVOGEN_HAL_H

#include <stddef.h>
#include <stdint.h>

void hal_init(void);
void hal_write(const char *text, size_t length);
void hal_exit(int code); /* does not return; `code` becomes the emulator's or the process's exit code */

/* Instructions between the two calls, to within two ticks of the board's clock; 0: too many, or not counted here. */
void hal_count_start(void);
uint32_t hal_count_stop(void);

/* Bytes of stack that what is called between the two takes below their caller's; 0: not measured here. What is deeper
   than the board paints counts as all of it. */
void hal_stack_paint(void);
uint32_t hal_stack_used(void);

#endif
