"""Robots from URDF files: `sg.urdf.load(path) -> Robot`."""

from servogen.urdf.robot import Robot, load

__all__ = ["Robot", "load"]
