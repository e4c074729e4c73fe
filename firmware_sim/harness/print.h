/* Text without printf: images stay free of newlib's stdio and of its heap. */
#ifndef SERVOGEN_PRINT_H
#define SERVOGEN_PRINT_H

#include <stdint.h>

void print_text(const char *text);
void print_count(const char *key, uint32_t value);
void print_number(const char *key, int value);
void print_hex(uint64_t value, int digits);
void print_flush(void);

#endif
