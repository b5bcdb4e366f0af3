"""What one mistake costs, of 100 points: its own share once, of the function, of the functions that call it, and of the pictures.

As a program it prints the table: .shadelab/venv/bin/python -I tests/python/test_cost.py
"""

import tempfile
from pathlib import Path

import pytest

from shadelab.course.assignment import load_assignment
from shadelab.course.mistakes import regions, with_bodies
from shadelab.course.toml_files import read_toml
from shadelab.grading.grade import grade
from shadelab.paths import SOLUTION
from shadelab.words import BACKENDS

FOLDER = Path(__file__).resolve().parents[1] / "undeclared"
MOST = 35  # of 100 points: what touches one expression costs no more
# One expression each, in both languages; from public threads, textbooks and classrooms.
SINGLE = {
    "lights": [
        "falloff-a-beside-b", "falloff-over-the-sphere", "spot-opening-angles", "incident-square-for-the-distance",
        "incident-spot-axis-reversed", "irradiance-half-lambert", "diffuse-kd-squared",
    ],
    "phong": [
        "mirror-without-the-cosine", "half-vector-v-reversed", "phong-lobe-twice-the-exponent", "phong-lobe-times-the-cosine",
        "blinn-lobe-gate-of-the-viewer", "phong-diffuse-a-hair-bright", "phong-diffuse-over-pi", "blinn-phong-exponent-converted",
    ],
    "microfacet": [
        "schlick-first-power", "dielectric-sum-of-both", "beckmann-over-pi", "geometry-two-forgotten", "cook-torrance-no-shadowing",
    ],
}  # fmt: skip
QUICK = {"spot-opening-angles"}


def mistake(name, id):
    return next(m for m in read_toml(FOLDER / f"{name}.toml")["mistake"] if m["id"] == id)


def graded(name, id, folder):
    assignment, one = load_assignment(SOLUTION / name), mistake(name, id)
    for backend in BACKENDS:
        source = assignment.directory / f"shading.{backend}"
        body = one.get(backend) or one["body"]
        (folder / source.name).write_text(with_bodies(source.read_text(), source, {one["function"]: body}))
    return grade(assignment, folder, pictures=False).result


@pytest.mark.parametrize(
    "name,id",
    [
        pytest.param(name, id, id=id, marks=[] if id in QUICK else [pytest.mark.slow])
        for name, ids in SINGLE.items()
        for id in ids
    ],
)
def test_one_mistake_costs_its_share_once(name, id, tmp_path):
    result = graded(name, id, tmp_path)
    lost = {c.id: c.max_score - c.score for c in result.checks if c.score < c.max_score}
    assert 0 < sum(lost.values()) <= MOST, lost
    function = mistake(name, id)["function"]
    for check in result.checks:  # what only calls it is right, given what it gives
        if check.kind == "function" and check.id.split("/")[-1] != function:
            assert check.status == "passed", f"{check.id}: {check.message}"


def test_a_picture_that_no_function_explains_is_judged_by_the_truth(tmp_path):
    """One function is wrong, and another keeps a state, which its table does not reach."""
    assignment = load_assignment(SOLUTION / "phong")
    source = assignment.directory / "shading.cpp"
    text = source.read_text()
    bodies = {"half_vector": mistake("phong", "half-vector-v-reversed")["body"]}
    late = "static int calls = 0;\nif (++calls > 20000) return Terms(m.ka, vec3(0.0), vec3(0.0));\n"
    for name, before in (("honest", ""), ("late", late)):
        changed = bodies | {"blinn_phong": before + regions(text, source)["blinn_phong"]["body"]}
        (tmp_path / name).mkdir()
        (tmp_path / name / source.name).write_text(with_bodies(text, source, changed))
    only = ["cpp/function/*", "cpp/image/grazing"]
    checks = {}
    for name in ("honest", "late"):
        result = grade(assignment, tmp_path / name, only=only, pictures=False).result
        checks[name] = next(c for c in result.checks if c.kind == "image")
    assert "right apart from that" in checks["honest"].message
    assert "right apart from that" not in checks["late"].message
    assert checks["late"].score < checks["honest"].score < checks["honest"].max_score


def table():
    print(f"{'':14}{'':36}{'functions':>10}{'pictures':>10}{'others':>10}{'lost':>8}")
    for name, ids in SINGLE.items():
        for id in ids:
            with tempfile.TemporaryDirectory() as folder:
                lost = {"function": 0.0, "image": 0.0}
                for check in graded(name, id, Path(folder)).checks:
                    kind = check.kind if check.kind in lost else "others"
                    lost[kind] = lost.get(kind, 0.0) + check.max_score - check.score
            rest = lost.get("others", 0.0)
            print(
                f"{name:14}{id:36}{lost['function']:10.2f}{lost['image']:10.2f}{rest:10.2f}{sum(lost.values()):8.2f}",
                flush=True,
            )


if __name__ == "__main__":
    table()
