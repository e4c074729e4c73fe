"""The spacecraft with y = -tau, which damps the chatter of y = 0: Bajodah et al. (2004), Eq. (54), Figures 13-21."""

from servogen.scenes.spacecraft import stabilisation, stabilisation_run

scene = stabilisation("spacecraft_smooth", smooth=True)
simulation = stabilisation_run(scene, duration=10.0, step=5e-4)
