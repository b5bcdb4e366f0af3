"""The result as one HTML file that needs nothing else: no network, and without its script it only lacks the viewers."""

import base64
import hashlib
import re
from pathlib import Path
from typing import Any

import jinja2
from markupsafe import Markup

from shadelab.files import write_whole
from shadelab.grading.pictures import Pictures
from shadelab.report.html.illustrations import illustrate
from shadelab.report.html.pictures import RAMP
from shadelab.report.html.plot import plots
from shadelab.report.wording import (
    STATUS,
    SYMBOLS,
    beside_the_score,
    compared,
    components,
    findings,
    first_step,
    in_order,
    kinds_of,
    label,
    not_begun,
    told,
    waits_for,
)
from shadelab.result import Check, Result
from shadelab.words import BACKENDS, FILES, listed, number, number_short, plain, points

PRINTED = 4096  # of what the code printed, in characters
MESSAGE = 16384
VALUE = 200


def write_html(
    result: Result, pictures: dict[str, Pictures], file: Path, title: str, hidden_details: bool = False
) -> None:
    """`pictures` by the id of the image check. Of hidden checks only name, status and points, unless `hidden_details`."""
    if not hidden_details:
        result = _without_hidden(result)
        pictures = {c.id: pictures[c.id] for c in result.checks if c.id in pictures and not c.hidden}
    here = Path(__file__).parent
    ids = {check.id: _anchor(index, check) for index, check in enumerate(result.checks)}
    step, first = first_step(result)
    shown = findings([c for c in in_order(result, "failed", "error") if hidden_details or not c.hidden])
    # Of a finding that both languages have alike the first is shown; of what was not begun there is nothing to see.
    silent = {c.id for c in result.checks if not c.begun} | {c.id for group in shown for c in group[1:]}
    illustrated = illustrate(result, {id: p for id, p in pictures.items() if id not in silent}, ids)
    script = (here / "report.js").read_text(encoding="utf-8")
    environment = jinja2.Environment(
        loader=jinja2.FileSystemLoader(here),
        autoescape=True,
        undefined=jinja2.StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    environment.filters |= {"plain": plain, "points": points, "number": number, "number_short": number_short}
    environment.filters |= {"cut": _cut, "listed": listed, "label": label, "error_text": _error_text}
    page = environment.get_template("report.html.j2").render(
        title=title,
        result=result,
        css=Markup((here / "report.css").read_text(encoding="utf-8")),
        script=Markup(script),
        # With its hash in the page's policy, nothing that a student wrote could ever run.
        script_hash=base64.b64encode(hashlib.sha256(script.encode()).digest()).decode(),
        backend_names=BACKENDS,
        symbols=SYMBOLS,
        statuses=STATUS,
        waits_for=waits_for,
        anchors=ids,
        step=step,
        first=first,
        bar=_bar(result),
        backends=_backends(result),
        failed=shown,
        detailed=[c for group in shown for c in group],
        not_begun=not_begun(result),
        beside_the_score=beside_the_score(result),
        told=told,
        hidden_details=hidden_details,
        illustrated=illustrated,
        floors=any(c.error and c.error.floor is not None for c in result.checks),
        plots=plots(result),
        comparison=_comparison,
        named_values=_named_values,
        ramp=RAMP,
        data={"checks": illustrated.viewers, "scenes": illustrated.scenes, "ramp": RAMP},
        limits={"printed": PRINTED, "message": MESSAGE, "value": VALUE},
    )
    write_whole(file, page.lstrip())


def _without_hidden(result: Result) -> Result:
    """With name, status and points of the hidden checks, and nothing else of them: nothing else can leak."""
    kept = {"id", "kind", "backend", "status", "score", "max_score", "hidden"}
    checks = [Check(**c.model_dump(include=kept)) if c.hidden else c for c in result.checks]
    return result.model_copy(update={"checks": checks})


# --- Words ---


def _anchor(index: int, check: Check) -> str:
    return f"check-{index}-" + re.sub(r"[^a-z0-9]+", "-", check.id.lower()).strip("-")


def _error_text(check: Check) -> str:
    return f"{number_short(check.error.value)} / {number_short(check.error.limit)}" if check.error else ""


def _cut(text: str, length: int) -> str:
    text = plain(text)
    return text if len(text) <= length else f"{text[:length]}\n… {len(text) - length} more characters"


def _bar(result: Result) -> list[dict[str, Any]]:
    """Where the points went: earned, lost, waiting, owed to the grader, not reached."""
    missing = {status: sum(c.max_score for c in result.checks if c.status == status) for status in ("skipped", "error")}
    checked = sum(c.max_score for c in result.checks)
    earned = result.score - sum(c.score for c in result.checks if c.status in missing)
    lost = checked - sum(missing.values()) - earned
    unseen = max(0.0, result.max_score - checked)
    parts = [
        ("passed", "earned", result.score), ("failed", "lost", lost), ("skipped", "skipped", missing["skipped"]),
        ("error", "open: grader error", missing["error"]), ("unseen", "not reached", unseen),
    ]  # fmt: skip
    total = max(result.max_score, checked) or 1.0
    return [{"kind": k, "name": n, "points": p, "percent": 100 * p / total} for k, n, p in parts if p > 1e-6]


def _backends(result: Result) -> list[dict[str, Any]]:
    out = []
    for backend, name in BACKENDS.items():
        checks = [c for c in in_order(result, *STATUS) if c.backend == backend]
        if checks:
            groups = [(title, [c for c in checks if c.kind == kind]) for kind, title in kinds_of(result).items()]
            out.append({
                "id": backend, "name": name, "file": FILES[backend], "groups": [g for g in groups if g[1]],
                "passed": [c for c in checks if c.status == "passed"],
                "score": sum(c.score for c in checks), "max_score": sum(c.max_score for c in checks),
            })  # fmt: skip
    return out


def _named_values(inputs: dict[str, Any]) -> list[tuple[str, list[str]]]:
    """Named vectors, at most four numbers a row."""
    rows = []
    for name, value in inputs.items():
        if isinstance(value, dict):
            rows += _named_values({f"{name}.{key}": item for key, item in value.items()})
            continue
        numbers = [number(v) for _, v in components(value, "")]
        rows += [(name if k == 0 else "", numbers[k : k + 4]) for k in range(0, len(numbers), 4)]
    return rows


def _comparison(check: Check) -> list[dict[str, Any]]:
    return [{"name": n, "expected": e, "actual": a, "wrong": w} for n, e, a, w in compared(check)]
