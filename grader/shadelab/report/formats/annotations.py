"""Compile errors as annotations: lines that a step prints, and that GitHub shows beside the student's code."""

import re

from shadelab.report.formats import short
from shadelab.report.wording import in_order
from shadelab.result import Result
from shadelab.words import BACKENDS, FILES

MOST = 10  # of one kind in one step; GitHub drops the others


def annotations(result: Result, folder: str = "") -> list[str]:
    """One workflow command for each error of a build. `folder`: where the submission lies in the repository."""
    out = []
    for check in in_order(result, "failed"):
        if check.kind != "build" or check.hidden:
            continue
        file = FILES[check.backend]
        # What belongs to an error follows it in lines of another shape: the line of code, and a caret below it.
        place = re.compile(rf"^{re.escape(file)}:(?:(?P<line>\d+):(?:(?P<col>\d+):)?)? (?P<text>.*)$", re.MULTILINE)
        for found in place.finditer(short.cut(check.message, short.MESSAGE)):
            properties = {"file": f"{folder.rstrip('/')}/{file}" if folder else file}
            properties |= {key: found[key] for key in ("line", "col") if found[key]}
            properties["title"] = f"{BACKENDS[check.backend]} does not compile"
            joined = ",".join(f"{key}={_property(value)}" for key, value in properties.items())
            out.append(f"::error {joined}::{_data(short.line(found['text'], short.COMMAND))}")
    return out[:MOST]


def _data(text: str) -> str:
    return text.replace("%", "%25").replace("\r", "%0D").replace("\n", "%0A")


def _property(text: str) -> str:
    return _data(text).replace(":", "%3A").replace(",", "%2C")
