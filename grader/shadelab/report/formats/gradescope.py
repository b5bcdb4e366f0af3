"""Gradescope's results.json (github.com/gradescope/autograder_samples, docs/specs.md).

Visibility is decided test by test. A public check is `visible`. A hidden one is `after_due_date`: until then a student
sees nothing of it, neither name nor points, and afterwards all of it, because a mistake that is never explained teaches
nothing. The price is Gradescope's rule that a student sees no total while any test is concealed. So the output on top,
which is always visible, says what the public checks gave, and nothing that depends on what came of the hidden ones.
(`hidden` would conceal for ever where points went. Next year's package needs a new seed instead.) What the grader
prints stays with the instructors, for the same reason.

Gradescope knows passed and failed. What was skipped or ended in an error of ours is failed where it costs points, or is
an error, and says why.
"""

import json
from collections import Counter
from typing import Any

from shadelab.report.formats import short
from shadelab.report.formats.markdown import details, inline
from shadelab.report.wording import OUR_FAULT, STATUS, in_order, kinds_of
from shadelab.result import Check, Result
from shadelab.words import points


def results(result: Result) -> str:
    kinds, counts = list(kinds_of(result)), Counter()
    tests = []
    for check in in_order(result, *STATUS):
        counts[check.kind] += 1
        tests.append(_test(check, result, f"{kinds.index(check.kind) + 1}.{counts[check.kind]}"))
    whole = {
        "score": round(result.score, 6),
        "execution_time": round(sum(c.seconds for c in result.checks), 3),
        "output": _output(result),
        "output_format": "md",
        "stdout_visibility": "hidden",
        "extra_data": {
            "schema": result.schema_,
            "version": result.environment.get("version", ""),
            "seed_digest": result.environment.get("seed_digest", ""),
        },
        "tests": tests,
    }
    return json.dumps(whole, indent=1, allow_nan=False) + "\n"


def _test(check: Check, result: Result, number: str) -> dict[str, Any]:
    passed = check.status == "passed" or (check.status == "skipped" and not check.max_score)
    remark = "" if check.status in ("passed", "failed") else f": {STATUS[check.status]}"
    return {
        "score": round(check.score, 6),
        "max_score": round(check.max_score, 6),
        "status": "passed" if passed else "failed",
        "name": short.name(check) + remark,
        "number": number,
        "output": details(check, result),
        "output_format": "md",
        "tags": [check.backend, check.kind],
        "visibility": "after_due_date" if check.hidden else "visible",
    }


def _output(result: Result) -> str:
    """For the student, at once: so nothing in it may depend on a hidden check."""
    public = [c for c in result.checks if not c.hidden]
    hidden = len(result.checks) - len(public)
    parts = []
    if not result.complete:
        parts.append("**Grading was cut off before its end.** This is what was earned until then: submit again.")
    if hidden:
        earned, most = points(sum(c.score for c in public)), points(sum(c.max_score for c in public))
        parts.append(f"**{earned} of {most} points** in the checks that are shown.")
        are = "check stays" if hidden == 1 else "checks stay"
        parts.append(f"{hidden} {are} hidden until the due date, and with it the total.")
    else:
        parts.append(f"**{points(result.score)} of {points(result.max_score)} points.**")
    ours = sum(c.status == "error" for c in public)
    if ours:
        parts.append(f"**Grader errors: {ours}.** {OUR_FAULT}")
    parts.append(inline(short.first_step(result)))
    return "\n\n".join(parts)
