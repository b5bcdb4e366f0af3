"""Names that every report and message uses."""

BACKENDS = {"cpp": "C++", "glsl": "GLSL"}
FILES = {"cpp": "shading.cpp", "glsl": "shading.glsl"}


def listed(names: list[str]) -> str:
    """a, b and c"""
    return names[0] if len(names) == 1 else ", ".join(names[:-1]) + " and " + names[-1]
