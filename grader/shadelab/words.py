"""Names and numbers as every report and message writes them, and text of a student made harmless."""

import codecs
import unicodedata
from typing import Any

BACKENDS = {"cpp": "C++", "glsl": "GLSL"}
FILES = {"cpp": "shading.cpp", "glsl": "shading.glsl"}


def listed(names: list[str]) -> str:
    """a, b and c"""
    return names[0] if len(names) == 1 else ", ".join(names[:-1]) + " and " + names[-1]


def number(value: Any, digits: int = 6) -> str:
    """None stands for what is not finite."""
    if value is None:
        return "not finite"
    return f"{value:.{digits}g}" if isinstance(value, float) else plain(value)


def points(value: float) -> str:
    return f"{round(value, 2):.10g}"


def number_short(value: float | None) -> str:
    return "not finite" if value is None else f"{value:.3g}"


def plain(text: object) -> str:
    """Text that a student controls, made harmless: what would steer a terminal or reorder the page becomes visible."""
    return "".join(map(_visible, str(text).replace("\r\n", "\n")))


def _visible(character: str) -> str:
    if character in "\n\t":
        return character
    category = unicodedata.category(character)
    if category == "Cc":
        return chr(0x2400 + ord(character)) if ord(character) < 32 else "␡" if ord(character) == 127 else "\ufffd"
    if category in ("Zl", "Zp"):
        return "\n"
    return "\ufffd" if category in ("Cf", "Cs") else character


def has_mark(data: bytes) -> bool:
    """Whether a byte order mark says which encoding it is."""
    return data.startswith((codecs.BOM_UTF8, codecs.BOM_UTF16_LE, codecs.BOM_UTF16_BE))


def decoded(data: bytes) -> str:
    """UTF-8, with or without a mark, or UTF-16 with one. What is neither is marked and not lost: no file fails to be read."""
    utf16 = data.startswith((codecs.BOM_UTF16_LE, codecs.BOM_UTF16_BE))
    return data.decode("utf-16" if utf16 else "utf-8-sig", errors="replace")
