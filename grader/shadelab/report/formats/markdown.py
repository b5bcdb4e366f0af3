"""Markdown: a job's summary on GitHub, and what Gradescope shows of a check.

Whatever a student controls stands in a fence that is longer than any run of backticks in it, or is escaped. Of hidden
checks a summary has the name, the status and the points, and nothing else: it is public to the student at once.
"""

import re

from shadelab.report.formats import short
from shadelab.report.wording import (
    OUR_FAULT,
    STATUS,
    SYMBOLS,
    beside_the_score,
    findings,
    in_order,
    label,
    not_begun,
    told,
    warned,
)
from shadelab.result import Check, Result
from shadelab.words import BACKENDS, points

LIMIT = 1_000_000  # bytes. GitHub drops a step's summary beyond 1 MiB; the rest is for what else the step writes
CUT = "\n**This summary was cut here**, because GitHub drops what is longer than 1 MiB. The HTML report has the rest.\n"


def summary(result: Result) -> str:
    """The whole result, to be appended to $GITHUB_STEP_SUMMARY."""
    score, most = points(result.score), points(result.max_score)
    # A block is never cut in two, so that no fence stays open.
    blocks = [f"# {inline(result.assignment)}: {score} of {most} points\n"]
    if note := beside_the_score(result):
        blocks.append(f"\n{inline(note)}\n")
    if not result.complete:
        blocks.append("\n**Grading was cut off before its end.** This is what was earned until then.\n")
    blocks += [f"\n{note}\n" for note in _notes(result)]
    blocks += _table(result)
    shown = [c for c in in_order(result, "failed", "error") if not c.hidden]
    if findings(shown):
        blocks.append("\n## What to mend, in this order\n")
    for group in findings(shown):
        check = group[0]
        # Of what is told once: the message with both languages' shares, and the points of both.
        both = check.model_copy(update={
            "message": told(group), "score": sum(c.score for c in group), "max_score": sum(c.max_score for c in group)
        })  # fmt: skip
        cost = f", {short.score(both)}" if both.max_score else ""
        title = f"\n### {SYMBOLS[check.status]} {inline(short.name(*group))}: {STATUS[check.status]}{cost}\n"
        blocks.append(f"{title}\n{details(both, result)}\n")
    for check in warned(result):
        blocks.append(f"\n## {inline(short.name(check))} passes; the compiler warns of\n\n{details(check, result)}\n")
    version = result.environment.get("version", "")
    blocks.append(f"\nGraded by Shadelab {inline(version)}, submission {code(result.submission)}\n")
    return _limited(blocks)


def details(check: Check, result: Result) -> str:
    """All that is known of one check, its name and points apart."""
    if not check.begun:
        return fenced(short.cut(check.message, short.MESSAGE))
    parts = []
    if check.status == "error":
        parts.append(f"**{OUR_FAULT}**")
    if check.status == "skipped" and (waiting := short.waits_for(check, result)):
        parts.append(f"Waits for {', '.join(map(code, waiting))}.")
    if check.mistake:
        parts.append(f"**This looks like a known mistake:** {inline(check.mistake.hint, short.MESSAGE)}")
    if check.message:
        parts.append(fenced(short.cut(check.message, short.MESSAGE)))
    if check.error:
        parts.append(f"{inline(short.error(check))}.")
    if check.worst and check.status != "passed":
        where = "The worst pixel:" if check.kind == "image" else "The worst input:"
        parts += [where, fenced("\n".join(short.worst(check)))]
        if check.worst.replay:
            parts += ["See it again:", fenced(short.line(check.worst.replay, short.COMMAND))]
    if check.printed:
        parts += ["Your code printed:", fenced(short.cut(check.printed, short.PRINTED))]
    return "\n\n".join(parts)


# --- Pieces ---


def fenced(text: str) -> str:
    fence = "`" * max(3, _longest_run(text) + 1)
    return f"{fence}\n{text}\n{fence}"


def code(text: str) -> str:
    """In a line or a cell. The spaces keep a backtick at either end from joining the delimiter."""
    text = short.line(text).replace("|", "\\|")
    run = _longest_run(text)
    return f"{'`' * (run + 1)} {text} {'`' * (run + 1)}" if run else f"`{text or ' '}`"


def inline(text: str, length: int = 2 * short.LINE) -> str:
    """In one line, with nothing in it that Markdown or HTML would act on."""
    return re.sub(r"([\\`*_\[\]<>&|~$!#])", r"\\\1", short.line(text, length))


def _longest_run(text: str) -> int:
    return max(map(len, re.findall("`+", text)), default=0)


def _notes(result: Result) -> list[str]:
    notes = [inline(short.first_step(result)), *map(inline, not_begun(result))]
    ours = sum(c.status == "error" for c in result.checks)
    if ours:
        notes.append(f"**Grader errors: {ours}.** {OUR_FAULT}")
    if any(c.hidden for c in result.checks):
        notes.append("Of hidden checks only the points are shown.")
    return notes


def _table(result: Result) -> list[str]:
    """By row, so that a long one can be cut: a thing that is checked, and how it went in each language."""
    if not result.checks:
        return []
    backends = [b for b in BACKENDS if any(c.backend == b for c in result.checks)]
    rows: dict[tuple[str, str], dict[str, Check]] = {}
    for check in in_order(result, *STATUS):
        rows.setdefault((check.kind, label(check)), {})[check.backend] = check
    out = [f"\n| check | {' | '.join(BACKENDS[b] for b in backends)} |\n|---|{'---|' * len(backends)}\n"]
    for (kind, what), checks in rows.items():
        name = code(what) if kind in ("build", "function") else f"{kind} {code(what)}"
        hidden = " (hidden)" if any(c.hidden for c in checks.values()) else ""
        out.append(f"| {name}{hidden} | {' | '.join(_cell(checks.get(b)) for b in backends)} |\n")
    return out


def _cell(check: Check | None) -> str:
    if check is None:
        return ""
    judged = check.max_score and check.status in ("passed", "failed")
    text = f"{points(check.score)} / {points(check.max_score)}" if judged else STATUS[check.status]
    return f"{SYMBOLS[check.status]} {text}"


def _limited(blocks: list[str]) -> str:
    kept, room = [], LIMIT - len(CUT.encode())
    for block in blocks:
        room -= len(block.encode())
        if room < 0:
            return "".join(kept) + CUT
        kept.append(block)
    return "".join(kept)
