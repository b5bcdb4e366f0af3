"""JUnit's XML, as Jenkins, GitLab and the others read it: a suite for each language, a case for each check.

A failure is judged wrong, an error is the grader's fault, skipped is skipped. Of hidden checks a case has name, status
and points.
"""

import re
import xml.etree.ElementTree as ET

from shadelab.report.formats import short
from shadelab.report.wording import OUR_FAULT, STATUS, in_order, label
from shadelab.result import Check, Result
from shadelab.words import BACKENDS, plain

_illegal = re.compile("[^\t\n\r\u0020-\ud7ff\ue000-\ufffd\U00010000-\U0010ffff]")  # in XML 1.0, escaped or not


def junit(result: Result) -> str:
    root = ET.Element("testsuites", name=_clean(result.assignment))
    for backend, name in BACKENDS.items():
        checks = [c for c in in_order(result, *STATUS) if c.backend == backend]
        if checks:
            _suite(root, f"{result.assignment}, {name}", [_case(check, result) for check in checks])
    if not result.complete:
        # Without it a run that ended early would look as if everything had passed.
        case = ET.Element("testcase", classname=_clean(result.assignment), name="grading", time="0.000")
        text = "Grading was cut off before its end: this is what was earned until then."
        ET.SubElement(case, "error", type="cut off", message=text)
        _suite(root, f"{result.assignment}, grading", [case])
    for key in ("tests", "failures", "errors"):
        root.set(key, str(sum(int(suite.get(key)) for suite in root)))
    root.set("time", f"{sum(c.seconds for c in result.checks):.3f}")
    ET.indent(root)
    return '<?xml version="1.0" encoding="UTF-8"?>\n' + ET.tostring(root, encoding="unicode") + "\n"


def _suite(root: ET.Element, name: str, cases: list[ET.Element]) -> None:
    suite = ET.SubElement(root, "testsuite", name=_clean(name), tests=str(len(cases)))
    for key, tag in (("failures", "failure"), ("errors", "error"), ("skipped", "skipped")):
        suite.set(key, str(sum(case.find(tag) is not None for case in cases)))
    suite.set("time", f"{sum(float(case.get('time')) for case in cases):.3f}")
    suite.extend(cases)


def _case(check: Check, result: Result) -> ET.Element:
    classname = f"{result.assignment}.{check.backend}.{check.kind}"
    case = ET.Element("testcase", classname=_clean(classname), name=_clean(label(check)))
    case.set("time", f"{check.seconds:.3f}")
    if check.status != "passed":
        tag = {"failed": "failure", "error": "error", "skipped": "skipped"}[check.status]
        body, lines = ET.SubElement(case, tag, type=check.status), [] if check.hidden else _lines(check, result)
        body.set("message", _clean(short.line(lines[0] if lines else f"{STATUS[check.status]} (hidden)")))
        body.text = _clean("\n".join(lines))
    printed = "" if check.hidden or not check.printed else "\n" + short.cut(check.printed, short.PRINTED)
    warnings = "\n" + short.cut(check.message, short.MESSAGE) if check.status == "passed" and check.message else ""
    ET.SubElement(case, "system-out").text = _clean(short.score(check) + ("" if check.hidden else warnings) + printed)
    return case


def _lines(check: Check, result: Result) -> list[str]:
    """What is wrong; the first line stands for the others. Never empty."""
    lines = []
    if check.status == "error":
        lines.append(OUR_FAULT)
    if check.status == "skipped" and (waiting := short.waits_for(check, result)):
        lines.append("waits for " + ", ".join(waiting))
    if check.message:
        lines.append(short.cut(check.message, short.MESSAGE))
    if check.mistake:
        lines.append("This looks like a known mistake: " + short.line(check.mistake.hint, short.MESSAGE))
    if check.error:
        lines.append(short.error(check))
    if check.worst and check.begun:
        lines += short.worst(check)
        if check.worst.replay:
            lines.append(short.line(check.worst.replay, short.COMMAND))
    return lines or [STATUS[check.status]]


def _clean(text: str) -> str:
    return _illegal.sub("\ufffd", plain(text))
