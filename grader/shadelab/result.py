"""result.json: the one record of a grading run. Reports are made from it."""

import json
from pathlib import Path
from typing import Any, Literal

from pydantic import BaseModel

from shadelab.errors import UserError
from shadelab.files import write_whole
from shadelab.paths import shown

SCHEMA = "shadelab/result/1"
FRAMES = 3  # of which a Render's time is the median


class Error(BaseModel):
    name: str
    value: float | None  # None when it is not finite
    limit: float
    floor: float | None = None


class Worst(BaseModel):
    """The input or pixel that is farthest off."""

    inputs: dict[str, Any]
    expected: list[Any]
    actual: list[Any]
    replay: str = ""


class Mistake(BaseModel):
    id: str
    hint: str
    margin: float  # how many times as many inputs the truth and every other mistake leave unexplained
    alike: list[str] = []  # declared mistakes that give the same numbers


class Render(BaseModel):
    """One render in the plot of error against run time."""

    series: str  # "yours", "solution, C++", ...
    rmse: float  # of the linear total, against the double reference
    seconds: float  # of one frame, without loading and compiling: the median of `frames`
    least: float = 0.0  # seconds
    most: float = 0.0
    frames: int = 1


class Check(BaseModel):
    id: str
    kind: str  # grading/kinds holds a module for each
    backend: Literal["cpp", "glsl"]
    status: Literal["passed", "failed", "skipped", "error"]
    score: float
    max_score: float
    error: Error | None = None
    seconds: float = 0.0
    message: str = ""
    begun: bool = True  # False: it failed because nothing but the starter's stubs is there
    printed: str = ""
    mistake: Mistake | None = None
    needs: list[str] = []
    because: list[str] = []  # ids of failed checks that explain this one
    worst: Worst | None = None
    hidden: bool = False  # students see neither the scene nor its picture; reports for them leave the details out
    runs: list[Render] = []  # of an image: this submission's and the solution's; reported, never graded


class Result(BaseModel):
    schema_: str = SCHEMA
    assignment: str
    submission: str
    score: float = 0.0
    max_score: float = 0.0
    complete: bool = False
    elsewhere: float | None = None  # in a release: the points of the checks that only the course's autograder has
    checks: list[Check] = []
    environment: dict[str, str] = {}

    def add(self, check: Check) -> None:
        self.checks.append(check)
        self.score = round(sum(c.score for c in self.checks), 6)

    def to_json(self) -> str:
        data = self.model_dump()
        data = {"schema": data.pop("schema_"), **data}
        return json.dumps(data, indent=1, allow_nan=False) + "\n"

    def write(self, file: Path) -> None:
        write_whole(file, self.to_json())


def load_result(folder: Path) -> Result:
    """result.json of a graded folder. Raises UserError."""
    file = folder / "result.json"
    try:
        data = json.loads(file.read_text())
        if (schema := data.pop("schema")) != SCHEMA:
            raise ValueError(f"its schema is {schema}, not {SCHEMA}")
        return Result(**data)
    except (FileNotFoundError, NotADirectoryError):
        raise UserError(f"{shown(file)}: cannot be read; give a folder that `grade` wrote to with --out") from None
    except (ValueError, KeyError, TypeError, AttributeError) as error:
        raise UserError(f"{shown(file)}: is no result of this version: {str(error).splitlines()[0]}") from None
