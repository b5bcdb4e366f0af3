"""What the tests share. They drive the project as its users do: through ./shadelab's commands and the files they write."""

import json
import os
import subprocess
import sys
from dataclasses import dataclass
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]
os.environ["SHADELAB_ROOT"] = str(ROOT)


@dataclass
class Run:
    code: int
    stdout: str
    stderr: str


@pytest.fixture
def shadelab(tmp_path):
    """Runs a command as ./shadelab would after set-up, in an empty working folder."""

    def run(*arguments: str | Path, timeout: float = 600, **environment: str) -> Run:
        done = subprocess.run(
            [sys.executable, "-I", "-m", "shadelab", *map(str, arguments)],
            cwd=tmp_path, capture_output=True, text=True, timeout=timeout, env={**os.environ, **environment},
        )  # fmt: skip
        return Run(done.returncode, done.stdout, done.stderr)

    return run


@pytest.fixture
def grade(shadelab, tmp_path):
    """Grades a folder; returns result.json with its checks also by id."""

    def run(folder: Path, only: str = "*", assignment: str = "phong", **environment: str) -> dict:
        out = tmp_path / "out"
        done = shadelab(
            "grade", folder, "--assignment", assignment, "--only", only, "--out", out, "--json", "-", **environment
        )
        result = json.loads(done.stdout)
        ours = any(check["status"] == "error" for check in result["checks"])
        assert done.code == (3 if ours else 0), done.stderr
        result["by_id"] = {check["id"]: check for check in result["checks"]}
        return result

    return run


@pytest.fixture
def submission(tmp_path):
    """A copy of a solution in which texts were replaced: submission(cpp={"old": "new"}, glsl={...})."""

    def make(assignment: str = "phong", **replacements: dict[str, str]) -> Path:
        folder = tmp_path / "submission"
        folder.mkdir()
        for language in ("cpp", "glsl"):
            text = (ROOT / "solution" / assignment / f"shading.{language}").read_text()
            for old, new in replacements.get(language, {}).items():
                assert text.count(old) == 1, f"{old!r} stands {text.count(old)} times in the solution"
                text = text.replace(old, new)
            (folder / f"shading.{language}").write_text(text)
        return folder

    return make
