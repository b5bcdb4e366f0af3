"""A check in words for the reports that other programs show: harmless, and cut to a sane length."""

from shadelab.report import wording
from shadelab.result import Check, Result
from shadelab.words import BACKENDS, listed, number_short, plain, points

LINE, COMMAND, MESSAGE, PRINTED = 300, 2000, 4096, 4096  # in characters


def cut(text: str, length: int) -> str:
    """Cut before it is made harmless: a program may have printed megabytes."""
    kept = plain(text[:length]).strip("\n")
    return kept if len(text) <= length else f"{kept}\n… {len(text) - length} more characters"


def line(text: str, length: int = LINE) -> str:
    """In one line."""
    flat = " ".join(plain(text[: 4 * length]).split())
    return flat if len(flat) <= length else flat[: length - 1].rstrip() + "…"


def name(*group: Check) -> str:
    """half_vector (C++), image teapot (GLSL), build (C++); half_vector (C++ and GLSL) of what both languages have alike."""
    check = group[0]
    kind = "" if check.kind in ("build", "function") else f"{check.kind} "
    return f"{kind}{line(wording.label(check))} ({listed([BACKENDS[c.backend] for c in group])})"


def score(check: Check) -> str:
    return f"{points(check.score)} of {points(check.max_score)} points" if check.max_score else "no points"


def waits_for(check: Check, result: Result) -> list[str]:
    """As the other reports have it, but without the ids of hidden checks."""
    hidden = {plain(c.id) for c in result.checks if c.hidden}
    return [id for id in wording.waits_for(check, result) if id not in hidden]


def error(check: Check) -> str:
    """The error, its limit, and the noise floor beside it."""
    value, limit = number_short(check.error.value), number_short(check.error.limit)
    floor = check.error.floor
    beside = "" if floor is None else f" (rounding alone gives {number_short(floor)})"
    return f"Error ({line(check.error.name)}): {value}, limit {limit}{beside}"


def worst(check: Check) -> list[str]:
    """The input or pixel that is farthest off, what was expected there, and what came."""
    return [line(text, COMMAND) for text in wording.worst_lines(check)]


def first_step(result: Result) -> str:
    """What to do first, as far as public checks tell it. Says nothing of hidden ones but that there are some."""
    public = [c.model_copy(update={"message": c.message[:MESSAGE]}) for c in result.checks if not c.hidden]
    step, check = wording.first_step(result.model_copy(update={"checks": public}))
    if check is None and len(public) < len(result.checks):
        return "Nothing to mend in the checks whose details are shown."
    return line(step, 2 * LINE)
