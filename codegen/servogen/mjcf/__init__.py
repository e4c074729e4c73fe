"""Robots from MJCF files, MuJoCo's format: `sg.mjcf.load(path) -> Robot`."""

from servogen.mjcf.mjcf import load

__all__ = ["load"]
