/* Instructions of functions, one line each: the mean over states of calls repeated so often that the clock suffices. */
#include "hal.h"
#include "print.h"
#include SERVOGEN_PROGRAM_HEADER

#define TIMES 50u

int main(void)
{
    hal_init();
    bench_start();
    for (uint32_t c = 0; c < BENCH_CALLS; ++c) {
        uint64_t sum = 0;
        uint32_t worst = 0;
        for (uint32_t k = 0; k < BENCH_STATES; ++k) {
            uint32_t count;
            hal_count_start();
            for (uint32_t n = 0; n < TIMES; ++n) {
                bench_calls[c].call(k);
            }
            count = hal_count_stop();
            if (count == 0) { /* more than the clock can count */
                hal_exit(1);
            }
            sum += count;
            worst = count > worst ? count : worst;
        }
        print_text("count call=");
        print_text(bench_calls[c].name);
        print_count(" mean=", (uint32_t)(sum / TIMES / BENCH_STATES));
        print_count(" worst=", worst / TIMES);
        print_text("\n");
    }
    print_flush();
    hal_exit(0);
    return 1;
}
