/* The closed loop of one scene on a target: every row as the hexadecimal of its bits, then why the run ended. */
#include "hal.h"
#include "print.h"
#include SERVOGEN_PROGRAM_HEADER

static void show_reals(const real *values, int count)
{
    for (int k = 0; k < count; ++k) {
        real_bits bits;
        memcpy(&bits, &values[k], sizeof bits);
        print_hex(bits, REAL_HEX_DIGITS);
        print_text(",");
    }
}

static void show(void *user, const sim_row *row)
{
    (void)user;
    print_text("row bits=");
    show_reals(&row->t, 1);
    show_reals(row->q, LOOP_Q);
    show_reals(row->u, LOOP_U);
    show_reals(row->tau, LOOP_TAU);
    show_reals(row->constraint, LOOP_CONSTRAINT);
    show_reals(&row->sigma_min, 1);
    print_number(" status=", row->status);
    print_number(" rank=", row->rank);
    print_number(" limited=", (int)row->limited);
    print_text("\n");
}

int main(void)
{
    static loop_run run;
    sim_stop stop = {SIM_RUNNING, 0, 0};
    hal_init();
    (void)loop_begin(&run, &loop_setup, show, NULL);
    while (loop_advance(&run, 1000, show, NULL, &stop) == SIM_RUNNING) {
    }
    print_number("stop reason=", stop.reason);
    print_number(" detail=", stop.detail);
    print_text(" bits=");
    show_reals(&stop.t, 1);
    print_text("\n");
    print_flush();
    hal_exit(0);
    return 1;
}
