"""The planar arm with the inverse mass matrix as weight: tau = J^T Lambda (...), the operational-space solution."""

from servogen.scenes.planar_arm_3r import arm, arm_run

scene = arm("planar_arm_3r_weighted", inverse_mass_weight=True)
simulation = arm_run(scene)
