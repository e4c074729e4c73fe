# What every Arm board does: its own linker script beside the common sections, and the clock that counts instructions.
#
#   servogen_arm_board(<linker script> <frequency of the emulator's SysTick, in Hz>)
function(servogen_arm_board script clock)
  set(common "${CMAKE_CURRENT_FUNCTION_LIST_DIR}")
  add_library(servogen_target OBJECT "${common}/startup.c" "${common}/hal.c" "${common}/counter.c" "${common}/stack.c")
  target_compile_definitions(servogen_target PRIVATE BOARD_CLOCK_HZ=${clock}u)
  target_link_options(servogen_target INTERFACE
    -nostartfiles "-L${common}" "-T${CMAKE_CURRENT_SOURCE_DIR}/${script}" -Wl,--gc-sections)
  if(CMAKE_SYSTEM_PROCESSOR MATCHES "cortex-m(3|4|33)$") # float64 by libgcc's ieee754-df.S
    target_sources(servogen_target PRIVATE "${common}/dadd.c")
    target_link_options(servogen_target INTERFACE -Wl,--wrap=__aeabi_dadd,--wrap=__aeabi_dsub)
  endif()
  set_target_properties(servogen_target PROPERTIES
    INTERFACE_LINK_DEPENDS "${CMAKE_CURRENT_SOURCE_DIR}/${script};${common}/sections.ld")
endfunction()
