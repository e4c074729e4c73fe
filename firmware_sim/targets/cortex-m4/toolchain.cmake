# Cortex-M4F, QEMU's MPS2 board with image AN386.
set(CMAKE_SYSTEM_PROCESSOR cortex-m4)
set(SERVOGEN_CPU_FLAGS "-mcpu=cortex-m4 -mfloat-abi=hard -mfpu=fpv4-sp-d16")
set(SERVOGEN_MACHINE mps2-an386)
include("${CMAKE_CURRENT_LIST_DIR}/../arm/toolchain.cmake")
