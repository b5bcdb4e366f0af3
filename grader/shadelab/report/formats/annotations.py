"""What a compiler says as annotations: lines that a step prints, and that GitHub shows beside the student's code."""

import re

from shadelab.report.formats import short
from shadelab.report.wording import in_order, warned
from shadelab.result import Result
from shadelab.words import BACKENDS, FILES

MOST = 10  # of one kind in one step; GitHub drops the others


def annotations(result: Result, folder: str = "") -> list[str]:
    """One workflow command for each error of a build, or each warning. `folder`: where the submission lies in the repository."""
    out = []
    failed = [c for c in in_order(result, "failed") if c.kind == "build"]
    for check in [*failed, *warned(result)]:
        level, what = ("error", "does not compile") if check in failed else ("warning", "compiles with a warning")
        file = FILES[check.backend]
        # What belongs to an error follows it in lines of another shape: the line of code, and a caret below it.
        place = re.compile(rf"^{re.escape(file)}:(?:(?P<line>\d+):(?:(?P<col>\d+):)?)? (?P<text>.*)$", re.MULTILINE)
        for found in place.finditer(short.cut(check.message, short.MESSAGE)):
            properties = {"file": f"{folder.rstrip('/')}/{file}" if folder else file}
            properties |= {key: found[key] for key in ("line", "col") if found[key]}
            properties["title"] = f"{BACKENDS[check.backend]} {what}"
            joined = ",".join(f"{key}={_property(value)}" for key, value in properties.items())
            out.append(f"::{level} {joined}::{_data(short.line(found['text'], short.COMMAND))}")
    return out[:MOST]


def _data(text: str) -> str:
    return text.replace("%", "%25").replace("\r", "%0D").replace("\n", "%0A")


def _property(text: str) -> str:
    return _data(text).replace(":", "%3A").replace(",", "%2C")
