"""The reports that other programs read, by name: each is a function of the result alone."""

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

from shadelab.errors import UserError
from shadelab.files import write_whole
from shadelab.report.formats.classroom50 import classroom50
from shadelab.report.formats.gradescope import results
from shadelab.report.formats.junit import junit
from shadelab.report.formats.markdown import summary
from shadelab.result import Result


@dataclass(frozen=True)
class Format:
    file: str  # its name below the --out folder
    text: Callable[[Result], str]


FORMATS = {
    "gradescope": Format("results.json", results),
    "classroom50": Format("classroom50.json", classroom50),
    "junit": Format("junit.xml", junit),
    "markdown": Format("summary.md", summary),
}


def check_formats(names: list[str] | None) -> None:
    """Raises UserError for a format that there is not."""
    for name in names or []:
        if name not in FORMATS:
            raise UserError(f"--format {name}: there is {', '.join(FORMATS)}")


def write_format(format: str, result: Result, folder: Path) -> Path:
    """A platform that ends the run early finds what was earned until then."""
    if format not in FORMATS:
        raise UserError(f"the format {format} is not known: choose {', '.join(FORMATS)}")
    file = folder / FORMATS[format].file
    write_whole(file, FORMATS[format].text(result))
    return file
