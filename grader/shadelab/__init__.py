"""Shadelab's grader: it builds, runs and judges shading functions written in C++ and GLSL."""

__version__ = "0.1.0"
