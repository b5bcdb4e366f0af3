"""What is the same in both languages is told once, and what was not begun in one line."""

import shutil

import pytest

from conftest import ROOT
from shadelab.report.wording import findings, told
from shadelab.result import Check, Worst

LOBE = "return exp(q * log1p(-x));\n    // STUDENT END: return 0.0;\n}\n\n// The half-vector lobe"
FORGOTTEN = {LOBE: LOBE.replace("exp(q * log1p(-x))", "1.0 - x")}


def checks(*messages, kind="function", actual=(1.0, 1.0), because=()):
    return [
        Check(
            id=f"{backend}/{kind}/x", kind=kind, backend=backend, status="failed", score=0, max_score=1, message=message,
            worst=Worst(inputs={}, expected=[2.0], actual=[value]), because=[f"{backend}/function/{b}" for b in because],
        )
        for backend, message, value in zip(("cpp", "glsl"), messages, actual)
    ]  # fmt: skip


def test_shares_a_few_percent_apart_are_one_finding():
    [group] = findings(checks("wrong for 37 % of the inputs; yours is 0", "wrong for 36 % of the inputs; yours is 0"))
    assert told(group) == "wrong for 36 to 37 % of the inputs; yours is 0"
    [group] = findings(checks("wrong for 98 % of the inputs", "wrong for all of the inputs"))
    assert told(group) == "wrong for 98 % and all of the inputs"
    assert len(findings(checks("wrong for 37 % of the inputs", "wrong for 60 % of the inputs"))) == 2
    assert len(findings(checks("wrong for 37 % of the inputs", "wrong for 37 % of the inputs; yours is 0"))) == 2


def test_a_picture_is_told_once_only_where_it_is_wrong_in_the_same_way():
    words = "40 % of the interior pixels are off"
    assert len(findings(checks(words, words, kind="image", actual=(1.0, 1.01)))) == 1
    assert len(findings(checks(words, words, kind="image", actual=(1.0, 1.5)))) == 2
    same, other = checks("wrong", "wrong"), checks("wrong: a", "wrong: b")
    pictures = checks(words, words, kind="image", actual=(1.0, 1.5), because=["x"])
    assert len(findings([*same, *pictures])) == 2
    assert len(findings([*other, *pictures])) == 4


def test_one_mistake_in_both_languages_is_one_finding_everywhere(shadelab, submission, tmp_path):
    only = ["--only", "*/function/*", "--only", "*/image/sphere", "--format", "markdown", "--out", tmp_path / "out"]
    done = shadelab("grade", submission(cpp=FORGOTTEN, glsl=FORGOTTEN), "--assignment", "phong", *only, COLUMNS="200")
    assert done.code == 0, done.stderr
    assert done.stdout.count("✗ phong_lobe") == 1 and "✗ phong_lobe (C++ and GLSL)" in done.stdout
    assert (tmp_path / "out/summary.md").read_text().count("### ✗ phong\\_lobe (C++ and GLSL)") == 1
    page = (tmp_path / "out/report.html").read_text()
    assert page.count("<article") == 2 and page.count("alike in both languages") == 2


@pytest.mark.slow
def test_a_language_that_was_not_begun_takes_a_line(shadelab, submission, tmp_path):
    folder = submission(cpp=FORGOTTEN)
    shutil.copy(ROOT / "starter/phong/shading.glsl", folder)
    # A comment and a blank line are no beginning.
    (folder / "shading.glsl").write_text(
        "// Ada\n" + (folder / "shading.glsl").read_text().replace("// TODO: ", "\n// ")
    )
    done = shadelab(
        "grade", folder, "--assignment", "phong", "--format", "markdown", "--out", tmp_path / "out", COLUMNS="200"
    )
    assert "Start with phong_lobe in shading.cpp" in done.stdout and "\nGLSL: not begun\n" in done.stdout
    details = done.stdout.split("Score:")[1]
    assert "✗ phong_lobe (C++)" in details and details.count("GLSL") == 1
    summary = (tmp_path / "out/summary.md").read_text()
    assert "GLSL: not begun" in summary and "(GLSL)" not in summary
    page = (tmp_path / "out/report.html").read_text()
    assert "GLSL: not begun" in page and 'id="check-' in page and "glsl/image" not in page.split("What to mend")[1]


def test_of_a_half_done_file_the_rest_takes_a_line(shadelab, tmp_path):
    folder = tmp_path / "half"
    shutil.copytree(ROOT / "starter/phong", folder)
    stub = "vec3 mirror_direction(vec3 l, vec3 n) {\n    // TODO: twice the part of l along n, minus l\n    return vec3(0.0);"
    source = (folder / "shading.cpp").read_text()
    assert stub in source
    (folder / "shading.cpp").write_text(source.replace(stub, stub.replace("vec3(0.0)", "vec3(1.0)")))
    done = shadelab("grade", folder, "--only", "*/function/*", COLUMNS="200")
    assert "C++: not begun: half_vector, phong_lobe, blinn_lobe, phong, blinn_phong\nGLSL: not begun\n" in done.stdout
    assert done.stdout.count("✗ mirror_direction") == 1 and "Start with mirror_direction in shading.cpp" in done.stdout


def test_a_stub_that_passes_by_follow_through_is_no_beginning(shadelab):
    """two_lobes adds what a wrong cook_torrance gives, and its stub is right so."""
    done = shadelab("grade", ROOT / "starter/microfacet", "--only", "cpp/function/*", "--no-html", COLUMNS="200")
    assert "\nC++: not begun\n" in done.stdout and "two_lobes" in done.stdout
