"""The generator's version, which every generated file names."""

VERSION = "0.1.0"
