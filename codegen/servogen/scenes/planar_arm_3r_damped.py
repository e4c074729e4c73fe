"""The planar arm with y = -3 omega, which damps the motion that the end does not see."""

from servogen.scenes.planar_arm_3r import arm, arm_run

scene = arm("planar_arm_3r_damped", damping=3.0)
simulation = arm_run(scene)
