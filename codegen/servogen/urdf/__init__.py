"""Robots from URDF files: `sg.urdf.load(path) -> Robot`."""

from servogen.urdf.base import quaternion_rotation
from servogen.urdf.limits import JointLimits
from servogen.urdf.load import load
from servogen.urdf.payload import Payload
from servogen.urdf.robot import Robot

__all__ = ["JointLimits", "Payload", "Robot", "load", "quaternion_rotation"]
