"""The spacecraft with y = -tau, which damps the chatter of y = 0: Bajodah et al. (2004), Eq. (54), Figures 13-21."""

from servogen.scenes.spacecraft import stabilisation

scene = stabilisation("spacecraft_smooth", smooth=True)
