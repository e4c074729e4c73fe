"""The control half as a typed sequence of steps between the kernels of a scene."""
