# Cortex-M3, QEMU's MPS2 board with image AN385.
set(CMAKE_SYSTEM_PROCESSOR cortex-m3)
set(SERVOGEN_CPU_FLAGS "-mcpu=cortex-m3")
set(SERVOGEN_MACHINE mps2-an385)
include("${CMAKE_CURRENT_LIST_DIR}/../arm/toolchain.cmake")
