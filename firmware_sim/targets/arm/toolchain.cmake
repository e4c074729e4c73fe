# The common part of every Arm board's toolchain file, which sets before it:
#   SERVOGEN_CPU_FLAGS  the core and its floating-point unit
#   SERVOGEN_MACHINE    QEMU's name of the board
set(CMAKE_SYSTEM_NAME Generic)
set(CMAKE_C_COMPILER arm-none-eabi-gcc)
set(CMAKE_C_FLAGS_INIT "${SERVOGEN_CPU_FLAGS} -mthumb -ffunction-sections -fdata-sections")
set(CMAKE_TRY_COMPILE_TARGET_TYPE STATIC_LIBRARY) # there is no start-up code yet when CMake tries the compiler

# -icount shift=0: one instruction is one nanosecond of the board's time, so that SysTick counts instructions.
# sleep=off: a core that waits is woken at its next timer at once, not by the clock of a machine that may be busy.
set(CMAKE_CROSSCOMPILING_EMULATOR
    qemu-system-arm -M ${SERVOGEN_MACHINE} -display none -monitor none -serial none -icount shift=0,sleep=off
    -semihosting-config enable=on,target=native -kernel
    CACHE STRING "the command an image is run with")
