# Cortex-M0, the BBC micro:bit.
set(CMAKE_SYSTEM_PROCESSOR cortex-m0)
set(SERVOGEN_CPU_FLAGS "-mcpu=cortex-m0")
set(SERVOGEN_MACHINE microbit)
include("${CMAKE_CURRENT_LIST_DIR}/../arm/toolchain.cmake")
