"""Rivals of a whole scene: another model of the same robot, another library, another code generator."""
