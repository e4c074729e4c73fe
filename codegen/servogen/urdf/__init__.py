"""Robots from URDF files: `sg.urdf.load(path) -> Robot`."""

from servogen.urdf.base import quaternion_rotation
from servogen.urdf.robot import Robot, load

__all__ = ["Robot", "load", "quaternion_rotation"]
