# Cortex-M7 with float64 in hardware, QEMU's MPS2 board with image AN500.
set(CMAKE_SYSTEM_PROCESSOR cortex-m7)
set(SERVOGEN_CPU_FLAGS "-mcpu=cortex-m7 -mfloat-abi=hard -mfpu=fpv5-d16")
set(SERVOGEN_MACHINE mps2-an500)
include("${CMAKE_CURRENT_LIST_DIR}/../arm/toolchain.cmake")
