# Cortex-M33 with float32 in hardware, in secure state, QEMU's MPS2 board with image AN505.
set(CMAKE_SYSTEM_PROCESSOR cortex-m33)
set(SERVOGEN_CPU_FLAGS "-mcpu=cortex-m33 -mfloat-abi=hard -mfpu=fpv5-sp-d16")
set(SERVOGEN_MACHINE mps2-an505)
include("${CMAKE_CURRENT_LIST_DIR}/../arm/toolchain.cmake")
