/* The vectors of one package, in a translation unit of their own so that a linker script can place them. */
#include SERVOGEN_VECTORS_HEADER

const harness_table *harness_vectors(void)
{
    return &vector_table;
}
