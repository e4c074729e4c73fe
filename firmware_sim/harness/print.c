#include "print.h"

#include <stddef.h>

#include "hal.h"

/* A write to the board is a trap into the emulator, far dearer than a byte: collect. */
static char buffer[2048];
static size_t used;

static void put(char c)
{
    if (used == sizeof buffer) {
        print_flush();
    }
    buffer[used++] = c;
}

void print_flush(void)
{
    hal_write(buffer, used);
    used = 0;
}

void print_text(const char *text)
{
    while (*text != '\0') {
        put(*text++);
    }
}

static void put_decimal(uint32_t value)
{
    char digits[10];
    int n = 0;
    do {
        digits[n++] = (char)('0' + (int)(value % 10u));
        value /= 10u;
    } while (value != 0u);
    while (n > 0) {
        put(digits[--n]);
    }
}

void print_count(const char *key, uint32_t value)
{
    print_text(key);
    put_decimal(value);
}

void print_number(const char *key, int value)
{
    print_text(key);
    if (value < 0) {
        put('-');
    }
    put_decimal(value < 0 ? 0u - (uint32_t)value : (uint32_t)value);
}

void print_hex(uint64_t value, int digits)
{
    while (digits > 0) {
        --digits;
        put("0123456789abcdef"[(value >> (4 * digits)) & 15u]);
    }
}
