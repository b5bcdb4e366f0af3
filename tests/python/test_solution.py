"""The solutions against arithmetic with 50 digits: right, and not just consistent."""

import re
import shutil
import subprocess

import numpy as np
import pytest

from conftest import ROOT
from shadelab.course.assignment import assignment_names, load_assignment
from shadelab.machine.build import Recipe
from shadelab.machine.glue import glue_folder
from shadelab.truth import exact
from shadelab.truth.expected import Table
from shadelab.truth.making import load
from shadelab.truth.measures import function_members, scaled_error

ROWS = 400  # of the table; 50 digits take their time

cases = [
    (assignment, function)
    for assignment in (load_assignment(ROOT / "solution" / name) for name in assignment_names())
    for function in assignment.functions
]


@pytest.mark.parametrize("assignment, function", cases, ids=[f"{a.name}-{f.name}" for a, f in cases])
def test_double_build_agrees_with_50_digits(assignment, function):
    table = load(assignment).table(function)
    rows, truth = table.rows, table.truth
    # Every tenth row, and the exact gates at the end of those that are drawn.
    chosen = np.r_[np.arange(0, len(rows), len(rows) // ROWS), np.arange(table.drawn - 40, table.drawn)]
    wanted = exact.evaluate(assignment, function, rows[chosen])
    # Rounding in double instead of float32 changes the truth 2^29 times less.
    conditioning = table.conditioning[chosen] * 2.0**-29
    exactly = Table(rows[chosen], wanted, conditioning, len(chosen))
    assert scaled_error(truth[chosen], exactly, function_members(function)).max() <= 1e-12


@pytest.mark.parametrize(
    "assignment",
    [
        pytest.param(a, id=a.name, marks=[] if a.name == "phong" else [pytest.mark.slow])
        for a in {a.name: a for a, _ in cases}.values()
    ],
)
def test_every_batch_loop_of_the_solution_vectorises(assignment, tmp_path):
    """Student-level code, inlined into the generated loops: one loop per model and light kind, each in 8 lanes of AVX2."""
    glue = glue_folder(assignment.directory)
    shutil.copy(assignment.directory / "shading.cpp", tmp_path / "shading.cpp")
    shutil.copy(glue / "glue.cpp", tmp_path / "glue.cpp")
    flags = [flag for flag in Recipe().flags() if not flag.startswith("-march")]
    command = [
        "g++",
        *flags,
        "-march=x86-64-v3",
        "-fopt-info-vec-optimized",
        f"-I{ROOT / 'framework/include'}",
        f"-I{glue}",
        "glue.cpp",
        "-o",
        "p.so",
    ]
    said = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True, check=True).stderr
    vectorised = {
        int(m[1])
        for m in re.finditer(r"^glue\.cpp:(\d+):\d+: optimized: loop vectorized using 32 byte vectors", said, re.M)
    }
    lines = (tmp_path / "glue.cpp").read_text().splitlines()
    inside, wanted = False, []  # the loops of shade_MODEL_KIND, and not those over rows of a function's table
    for number, line in enumerate(lines, 1):
        if "static void shade_" in line:
            inside = True
        elif line == "}":
            inside = False
        if inside and line.startswith("    for (int i = 0; i < count; ++i)"):
            wanted.append(number)
    models = [f for a in (assignment, *assignment.given) for f in a.functions if f.is_model]
    assert len(wanted) == 3 * len(models)
    assert set(wanted) <= vectorised
