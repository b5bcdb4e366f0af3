"""Grading end to end: marks, messages, and what hostile or broken submissions cost."""

import json
import re
import shlex
import shutil
import time

import pytest

from conftest import ROOT
from shadelab.course.assignment import assignment_names, load_assignment

GATE = "    if (dot(n, l) <= 0.0) return 0.0;\n    // As on the slide: pow(max(dot(v, r), 0.0), q)."
LOBE_END = "    if (x >= 1.0) return q == 0.0 ? 1.0 : 0.0;\n    return exp(q * log1p(-x));\n    // STUDENT END: return 0.0;\n}\n\n// The half-vector lobe"


def failed(result):
    return {check["id"] for check in result["checks"] if check["status"] == "failed"}


def test_solution_has_full_marks(grade):
    result = grade(ROOT / "solution" / "phong")
    assert result["schema"] == "shadelab/result/1"
    assert result["score"] == result["max_score"] > 0
    assert {c["status"] for c in result["checks"]} <= {"passed", "skipped"}
    for check in result["checks"]:
        if check["kind"] == "image" and check["status"] == "passed":
            assert check["error"]["value"] == 0  # no interior violation at all, in either language
    images = sum(c["max_score"] for c in result["checks"] if c["kind"] == "image")
    assert images >= 0.4 * result["max_score"]


def test_starter_has_little_and_is_told_why(grade):
    result = grade(ROOT / "starter" / "phong")
    assert result["score"] <= 0.15 * result["max_score"]
    assert result["by_id"]["cpp/build"]["status"] == result["by_id"]["glsl/build"]["status"] == "passed"
    for check in result["checks"]:
        if check["status"] == "failed":
            assert check["message"] and check["worst"]["inputs"] and check["worst"]["replay"].startswith("./shadelab ")


def test_forgotten_exponent_costs_what_it_touches_in_both_languages(grade, submission):
    change = {LOBE_END: LOBE_END.replace("return exp(q * log1p(-x));", "return 1.0 - x;")}
    result = grade(submission(cpp=change, glsl=change))
    touched = {f"{b}/function/phong_lobe" for b in ("cpp", "glsl")}  # and not phong, which is right given this lobe
    touched |= {
        f"{b}/image/{s.name}"
        for b in ("cpp", "glsl")
        for s in load_assignment(ROOT / "solution" / "phong").scenes
        if re.search(r'model = "phong(_physical)?"', s.file.read_text())
    }
    present = {c["id"] for c in result["checks"] if c["status"] != "skipped"}
    assert failed(result) == touched & present
    assert "specular is wrong, ambient and diffuse are right" in result["by_id"]["cpp/image/sphere"]["message"]
    for backend in ("cpp", "glsl"):
        assert result["by_id"][f"{backend}/function/phong"]["message"] == "right, given what your phong_lobe gives"
        assert result["by_id"][f"{backend}/image/sphere"]["because"] == [f"{backend}/function/phong_lobe"]
        for id in (f"{backend}/function/phong_lobe", f"{backend}/image/sphere"):
            assert result["by_id"][id]["mistake"]["id"] == "phong-lobe-exponent-forgotten"


@pytest.mark.parametrize("language, error", [("cpp", "expected"), ("glsl", "syntax error")])
def test_syntax_error_is_one_failed_build_with_the_students_line(grade, submission, language, error):
    change = {"return 2.0 * dot(n, l) * n - l;": "return 2.0 * dot(n, l) * n - l"}
    folder = submission(**{language: change})
    lines = (folder / f"shading.{language}").read_text().splitlines()
    line = next(k for k, text in enumerate(lines, 1) if text.endswith("* n - l"))
    result = grade(folder)
    build = result["by_id"][f"{language}/build"]
    assert build["status"] == "failed"
    # The compilers notice a missing semicolon on its line or at the next token.
    places = [f"shading.{language}:{k}:" for k in range(line, line + 4)]
    assert any(place in build["message"] for place in places) and error in build["message"]
    others = [c for c in result["checks"] if c["backend"] == language and c["id"] != build["id"]]
    assert others and all(c["status"] == "skipped" and c["score"] == 0 for c in others)
    assert all(c["status"] != "failed" for c in result["checks"] if c["backend"] != language)


def test_bytes_that_are_no_text_are_no_fault_of_ours(grade, submission):
    folder = submission()
    for name in ("shading.cpp", "shading.glsl"):
        (folder / name).write_bytes(b"// caf\xe9\r\n" + (folder / name).read_bytes())
    result = grade(folder, only="*/function/half_vector")
    assert {c["status"] for c in result["checks"]} == {"passed"}


@pytest.mark.parametrize(
    "old, new, words",
    [
        ("return 2.0 * dot(n, l) * n - l;", "return dot(n, l);", ["shading.cpp:", "'vec3'"]),
        ("return 2.0 * dot(n, l) * n - l;", "return 2.0 * dott(n, l) * n - l;", ["shading.cpp:", "dott"]),
    ],
)
def test_type_errors_are_short_and_in_the_students_words(grade, submission, old, new, words):
    build = grade(submission(cpp={old: new}), only="cpp/*")["by_id"]["cpp/build"]
    assert build["status"] == "failed"
    assert len(build["message"].splitlines()) <= 5
    for word in words:
        assert word in build["message"]
    assert "glm" not in build["message"] and "/" not in build["message"]


HALF = "vec3 half_vector(vec3 l, vec3 v) {"


@pytest.mark.parametrize(
    "write",
    [
        lambda text: ("#version 330 core\n # extension GL_ARB_gpu_shader5 : enable\n" + text).encode(),
        lambda text: text.replace(HALF, "vec3 half_vector(const in vec3 l,\n    const vec3 v) {").encode(),
        lambda text: text.replace(HALF, "highp vec3 half_vector(in vec3 l, mediump vec3 v) {").encode(),
        lambda text: text.replace(HALF, "vec3 half_vector(const in highp vec3 l, in const lowp vec3 v) {").encode(),
        lambda text: ("precision highp float;\n#line 7\n#pragma optimize(off)\n" + text).encode(),
        lambda text: (
            "layout(location = 0) out vec4 fragment;\n" + text + "\nvoid main() { fragment = vec4(1); }\n"
        ).encode(),
        lambda text: (text + "\nint main(void) {\n    { gl_FragColor = vec4(1); }\n    return 0;\n}\n").encode(),
        lambda text: ("#define c0 1.0\n#define result r\n#define main nothing\n#define Real float\n" + text).encode(),
        lambda text: ("layout(location = 0) in vec3 p;\nvarying vec3 a, b;\nuniform vec3 eye;\n" + text).encode(),
        lambda text: ('#include "lights.glsl"\n#include <shadelab/shading.hpp>\n' + text).encode(),
        lambda text: text.replace(HALF, "\0" + HALF + " // \0").encode(),
        lambda text: text.encode("utf-16"),
        lambda text: b"\xfe\xff" + text.encode("utf-16-be"),
        lambda text: b"\xef\xbb\xbf" + text.replace("\n", "\r\n").encode(),
    ],
    ids=[
        "version",
        "const",
        "precision",
        "const-precision",
        "statements",
        "out-and-main",
        "int-main",
        "macros",
        "interface",
        "include",
        "nul",
        "utf-16",
        "utf-16-be",
        "utf-8-mark",
    ],
)
def test_a_shader_is_taken_as_editors_and_habits_write_it(grade, submission, write):
    folder = submission()
    file = folder / "shading.glsl"
    file.write_bytes(write(file.read_text()))
    result = grade(folder, only="glsl/function/*[lh][oa][bl][ef]*")
    assert len(result["checks"]) > 3 and result["score"] == result["max_score"] > 0


@pytest.mark.parametrize(
    "change, words",
    [
        ({HALF: "vec3 half_vector(inout vec3 l, vec3 v) {"}, "shading.glsl:{line}:6: half_vector is given values"),
        (
            {HALF: "vec3 half_vector(vec3 l, vec3 v, float s) {"},
            "shading.glsl:{line}: vec3 half_vector(vec3 l, vec3 v, float s) is not",
        ),
        (
            {HALF: "vec3 halfVector(vec3 l, vec3 v) {"},
            "half_vector is missing (halfVector in line {line} looks like it)",
        ),
        ({HALF: "float half_vector(vec3 l, vec3 v) {"}, "shading.glsl:{line}:7: half_vector returns another type"),
        (
            {HALF: "float log1p(float x) { return x; }\n" + HALF},
            "shading.glsl:{line}:7: log1p is one of the framework's",
        ),
        ({HALF: HALF + " if (l.x > 2.0) return half_vector(v, l);"}, "shading.glsl:{line}: half_vector calls itself"),
        ({HALF: HALF + " gl_FragColor = vec4(1);"}, "shading.glsl:{line}: gl_FragColor is for a main"),
        ({HALF: "/* " + HALF}, "shading.glsl:{line}:"),
        ({HALF: '#include "mine.glsl"\n' + HALF + " l = mine(v);"}, "shading.glsl:{line}:1: GLSL has no #include"),
    ],
    ids=["inout", "arguments", "name", "type", "ours", "recursion", "gl_FragColor", "comment", "include"],
)
def test_what_is_wrong_with_a_shader_is_said_with_the_students_line(grade, submission, change, words):
    folder = submission(glsl=change)
    file = folder / "shading.glsl"
    file.write_text("#version 330\n" + file.read_text())
    new = next(iter(change.values()))
    line = 1 + file.read_text().partition(new)[0].count("\n")
    build = grade(folder, only="glsl/function/half_vector")["by_id"]["glsl/build"]
    assert build["status"] == ("passed" if "is missing" in words else "failed")
    assert words.format(line=line) in build["message"]
    if "(" in words or "another" in words or "given" in words:
        assert "declare it as vec3 half_vector(vec3 l, vec3 v)" in build["message"]


@pytest.mark.parametrize(
    "body, complete",
    [
        ("if (l.x > 0.0) return l;", False),
        ("if (l.x > 0.0) return l; else if (l.y > 0.0) { return v; }", False),
        ("for (int i = 0; i < 3; ++i) { if (l[i] > 0.0) return l; }", False),
        ("if (l.x > 0.0) { return l; } else return v;", True),
        ("if (l.x > 0.0)\n#ifdef A\n    return l;\n#endif\n    return v;", True),
        ("{ vec3 s = l + v; while (true) { if (s.x > 0.0) return s; s += l; } }", True),
        ("switch (int(l.x)) { case 0: return l; default: return v; }", True),
    ],
)
def test_a_shaders_missing_return_is_told(grade, submission, body, complete):
    helper = f"vec3 helper(vec3 l, vec3 v) {{ {body}\n}}\n"
    folder = submission(glsl={HALF: helper + HALF})
    line = 1 + (folder / "shading.glsl").read_text().partition("\n}\n" + HALF)[0].count("\n") + 1
    build = grade(folder, only="glsl/function/half_vector")["by_id"]["glsl/build"]
    told = "" if complete else f"shading.glsl:{line}:1: no return at the end of helper: where none before it is reached"
    assert build["status"] == "passed" and build["message"].startswith(told) and bool(build["message"]) != complete


def test_variables_that_nothing_sets_are_told(grade, submission):
    folder = submission(glsl={HALF: "uniform vec3 eye;\n" + HALF})
    line = 1 + (folder / "shading.glsl").read_text().partition("uniform")[0].count("\n")
    build = grade(folder, only="glsl/function/half_vector")["by_id"]["glsl/build"]
    assert build["status"] == "passed" and build["message"].startswith(
        f"shading.glsl:{line}:1: nothing sets this variable (uniform)"
    )


def test_lines_of_messages_stay_the_students(grade, submission):
    folder = submission()
    file = folder / "shading.glsl"
    file.write_text("#version 330\n" + file.read_text().replace(HALF, HALF + " nonsense;"))
    line = 1 + next(k for k, text in enumerate(file.read_text().splitlines()) if text.startswith(HALF))
    assert f"shading.glsl:{line}:" in grade(folder, only="glsl/function/half_vector")["by_id"]["glsl/build"]["message"]


def test_cpp_in_utf16_is_taken(grade, submission):
    folder = submission()
    file = folder / "shading.cpp"
    file.write_bytes(file.read_text().encode("utf-16"))
    result = grade(folder, only="cpp/function/half_vector")
    assert result["score"] == result["max_score"] > 0


def test_type_errors_in_glsl(grade, submission):
    build = grade(
        submission(glsl={"return 2.0 * dot(n, l) * n - l;": "return 2.0 * dott(n, l) * n - l;"}), only="glsl/*"
    )["by_id"]["glsl/build"]
    assert build["status"] == "failed" and "shading.glsl:" in build["message"] and "dott" in build["message"]


MIRROR = "    return 2.0 * dot(n, l) * n - l;"


def test_a_missing_return_does_not_compile(grade, submission):
    folder = submission()
    file = folder / "shading.cpp"
    text = file.read_text()
    begin = text.index("Real phong_lobe(")
    end = text.index("\n}\n", begin)
    file.write_text(
        f"{text[:begin]}Real phong_lobe(vec3 n, vec3 l, vec3 v, Real q) {{\n    if (q > 0.0) return q;{text[end:]}"
    )
    build = grade(folder, only="cpp/function/phong_lobe")["by_id"]["cpp/build"]
    line = text[:begin].count("\n") + 3
    assert build["status"] == "failed" and build["message"].startswith(
        f"shading.cpp:{line}:1: no return at the end of phong_lobe"
    )


def test_warnings_are_told_again_when_their_file_was_thrown_away(grade, submission):
    from shadelab.paths import STATE

    folder = submission(cpp={MIRROR: "    dot(n, l) == 0.5;\n    return n;"})
    first = grade(folder, only="cpp/function/mirror_direction")["by_id"]["cpp/build"]
    for file in (STATE / "plugins").glob("*.txt"):
        if file.stat().st_size and time.time() - file.stat().st_mtime < 60:
            file.unlink()
    again = grade(folder, only="cpp/function/mirror_direction")["by_id"]["cpp/build"]
    assert "value computed is not used" in first["message"] and again["message"] == first["message"]


@pytest.mark.parametrize(
    "body, warned, told",
    [
        ("vec3 r;\n    if (dot(n, l) > 0.5) r = 2.0 * dot(n, l) * n - l;\n    return r;", "r may be used", True),
        ("vec3 r;\n    r += 2.0 * dot(n, l) * n - l;\n    return r;", "r is used", True),
        ("Real c;\n    if (l.x > 0.0) c = dot(n, l);\n    return 2.0 * c * n - l;", "c may be used", False),
        ("dot(n, l) == 0.0;\n    return n;", "value computed is not used", False),
    ],
    ids=["vector", "sum", "scalar", "no effect"],
)
def test_warnings_stand_with_the_build_and_what_is_unset_fails(shadelab, submission, tmp_path, body, warned, told):
    folder = submission(cpp={MIRROR: "    " + body})
    line = (folder / "shading.cpp").read_text()[:-1].partition(body)[0].count("\n") + 1
    out = tmp_path / "graded"
    run = shadelab(
        "grade", folder, "--assignment", "phong", "--only", "cpp/function/mirror_direction", "--out", out,
        "--format", "markdown", "--format", "junit", GITHUB_ACTIONS="true", COLUMNS="200",
    )  # fmt: skip
    build, function = json.loads((out / "result.json").read_text())["checks"]
    assert build["status"] == "passed" and warned in build["message"]
    assert line <= int(build["message"].split(":")[1]) <= line + 2
    assert function["status"] == "failed"
    assert ("nothing was ever stored in result" in function["message"]) == told
    assert "::warning file=" in run.stderr
    for text in (run.stdout, *((out / name).read_text() for name in ("report.html", "summary.md", "junit.xml"))):
        assert warned in text


def test_members_that_were_never_set_are_named(grade, submission):
    whole = "    return Terms(m.ka, m.kd * max(dot(n, l), 0.0), m.ks * phong_lobe(n, l, v, m.q));"
    parts = "    Terms t;\n    t.ambient = m.ka;\n    if (dot(n, l) > 0.0) { t.diffuse = m.kd * dot(n, l); t.specular = m.ks * phong_lobe(n, l, v, m.q); }"
    check = grade(submission(cpp={whole: parts + "\n    return t;"}), only="cpp/function/phong")["by_id"][
        "cpp/function/phong"
    ]
    assert check["message"].startswith("nothing was ever stored in result.diffuse and result.specular")


def test_the_drivers_warnings_stand_with_the_build(grade, submission):
    folder = submission(glsl={MIRROR: "    vec3 r;\n    return r;"})
    line = 1 + (folder / "shading.glsl").read_text().partition("    return r;")[0].count("\n")
    build = grade(folder, only="glsl/function/mirror_direction")["by_id"]["glsl/build"]
    assert build["status"] == "passed"
    assert (
        build["message"].startswith(f"shading.glsl:{line}:")
        and "r is used before anything was stored" in build["message"]
    )


@pytest.mark.parametrize("name", assignment_names())
def test_solutions_and_starters_are_free_of_warnings(grade, name):
    for folder in (ROOT / "solution" / name, ROOT / "starter" / name):
        result = grade(folder, only="*/build", assignment=name)
        assert [c["message"] for c in result["checks"]] == ["", ""]


def test_missing_file_fails_that_language_only(grade, submission):
    folder = submission()
    (folder / "shading.glsl").rename(folder / "Shading.glsl")
    result = grade(folder, only="*/function/*")
    assert (
        result["by_id"]["glsl/build"]["message"]
        == "shading.glsl is missing; it must be called shading.glsl, not Shading.glsl"
    )
    assert not any(c["status"] == "failed" for c in result["checks"] if c["backend"] == "cpp")


def test_endless_loop_ends_in_time_and_costs_its_own_checks(grade, submission):
    start = time.monotonic()
    change = {GATE: "    while (true);\n" + GATE}
    result = grade(submission(cpp=change), only="cpp/*")
    assert time.monotonic() - start < 60
    lobe = result["by_id"]["cpp/function/phong_lobe"]
    assert lobe["status"] == "failed" and "did not end" in lobe["message"]
    assert result["by_id"]["cpp/function/blinn_lobe"]["status"] == "passed"
    assert result["by_id"]["cpp/image/knot"]["status"] == "passed"  # half-vector lobe only
    assert result["by_id"]["cpp/image/sphere"]["status"] == "skipped"


def test_endless_loop_in_glsl(grade, submission):
    """llvmpipe leaves a loop after 65,535 turns, with a wrong value; one without any effect it drops, as a compiler may."""
    start = time.monotonic()
    change = {GATE: "    while (q > 0.0) q += 1.0;\n" + GATE}
    result = grade(submission(glsl=change), only="glsl/function/*_lobe")
    assert time.monotonic() - start < 60
    assert result["by_id"]["glsl/function/phong_lobe"]["status"] == "failed"
    assert result["by_id"]["glsl/function/blinn_lobe"]["status"] == "passed"


@pytest.mark.parametrize(
    "code, words",
    [
        ("    volatile int* nowhere = nullptr;\n    *nowhere = 1;\n", "SIGSEGV"),
        ("    std::exit(0);\n", "without giving its results"),
        ("    raise(40);\n", "crashed with signal 40"),
        ('    std::system("rm -rf ./* ; mkfifo results.bin"); std::_Exit(0);\n', "without giving its results"),
        ('    throw std::runtime_error("no");\n', "SIGABRT"),
        pytest.param(
            "    std::string s;\n    while (s.size() >= 0) s += std::string(1 << 26, 'x');\n",
            "phong_lobe",
            marks=pytest.mark.slow,
        ),
        ('    while (true) std::cout << "spam spam spam spam\\n";\n', "phong_lobe"),
    ],
    ids=["crash", "exit", "signal", "vandal", "exception", "memory", "printing"],
)
def test_a_function_that_misbehaves_costs_its_own_checks(grade, submission, code, words):
    includes = "#include <csignal>\n#include <cstdlib>\n#include <iostream>\n#include <stdexcept>\n#include <string>\n#include <shadelab/shading.hpp>\n"
    result = grade(
        submission(cpp={GATE: code + GATE, "#include <shadelab/shading.hpp>\n": includes}), only="cpp/function/*"
    )
    assert words in result["by_id"]["cpp/function/phong_lobe"]["message"]
    assert failed(result) == {"cpp/function/phong_lobe", "cpp/function/phong"}
    assert len(result["by_id"]["cpp/function/phong_lobe"]["printed"]) <= 4096 + 64


def test_what_the_code_prints_is_kept(grade, submission):
    change = {
        GATE: '    printf("lobe\\n");\n' + GATE,
        "#include <shadelab/shading.hpp>\n": "#include <stdio.h>\n#include <shadelab/shading.hpp>\n",
    }
    check = grade(submission(cpp=change), only="cpp/function/phong_lobe")["by_id"]["cpp/function/phong_lobe"]
    assert check["status"] == "passed"
    assert check["printed"].startswith("lobe\nlobe\n") and 3900 < len(check["printed"]) <= 4096 + 64
    assert "more bytes" in check["printed"]


def test_not_a_number_is_counted_and_located(grade, submission):
    change = {"m.ks * phong_lobe(n, l, v, m.q)": "m.ks * (phong_lobe(n, l, v, m.q) / max(n.x, 0.0))"}
    result = grade(submission(cpp=change), only="cpp/*")
    assert "not finite for" in result["by_id"]["cpp/function/phong"]["message"]
    sphere = result["by_id"]["cpp/image/sphere"]
    assert "pixels are not finite, the first at (" in sphere["message"] and "n = (" in sphere["message"]


def test_result_is_written_after_every_check(shadelab, tmp_path, submission):
    """A run that is killed keeps the marks that were earned."""
    import os
    import signal
    import subprocess
    import sys

    folder = submission(cpp={GATE: "    while (true);\n" + GATE})
    out = tmp_path / "out"
    process = subprocess.Popen(
        [sys.executable, "-I", "-m", "shadelab", "grade", folder, "--assignment", "phong", "--only", "cpp/*", "--out", out],
        cwd=tmp_path, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL, env=os.environ,
    )  # fmt: skip
    deadline = time.monotonic() + 60
    while not (out / "result.json").exists() or len(json.loads((out / "result.json").read_text())["checks"]) < 3:
        assert time.monotonic() < deadline and process.poll() is None
        time.sleep(0.05)
    process.send_signal(signal.SIGKILL)
    process.wait()
    result = json.loads((out / "result.json").read_text())
    assert not result["complete"] and result["score"] > 0


def test_fail_under(shadelab):
    starter = ROOT / "starter" / "phong"
    assert shadelab("grade", starter, "--only", "cpp/function/*", "--fail-under", "50").code == 1
    assert shadelab("grade", starter, "--only", "cpp/function/*").code == 0


@pytest.mark.parametrize(
    "arguments, words",
    [
        (["grade", "nowhere"], "nowhere: there is no such folder"),
        (["grade", str(ROOT / "solution" / "phong"), "--assignment", "phnog"], "there is no such assignment"),
        (["grade", str(ROOT / "solution" / "phong"), "--only", "cpp/funktion/*"], "ids look like"),
        (["grade", str(ROOT / "tests")], "--assignment"),
        (["render", "nowhere.toml"], "cannot be read"),
        (["render"], "SCENE"),
        (["render", str(ROOT / "scenes" / "phong" / "sphere.toml"), "--samples", "3"], "--samples 3"),
        (["render", str(ROOT / "scenes" / "phong" / "sphere.toml"), "--samples", "8", "--backend", "glsl"], "1, 2, 4"),
        (["render", str(ROOT / "scenes" / "phong" / "sphere.toml"), "--threads", "0"], "--threads"),
        (["render", str(ROOT / "scenes" / "phong" / "sphere.toml"), "--double", "--backend", "glsl"], "GLSL 330"),
        (["render", str(ROOT / "scenes" / "phong" / "sphere.toml"), "-o", "x.jpg"], ".png, .exr or .npy"),
        (["render", str(ROOT / "scenes" / "phong" / "sphere.toml"), "--size", "12"], "WIDTHxHEIGHT"),
        (["eval", str(ROOT / "solution" / "phong"), "half_vectr", "--inputs", "in.npz"], "half_vector"),
        (["reference", "nothing"], "no such assignment"),
    ],
)
def test_bad_usage_is_one_line_and_exit_2(shadelab, arguments, words):
    done = shadelab(*arguments)
    assert done.code == 2
    assert words in done.stderr and len(done.stderr.strip().splitlines()) == 1
    assert "Traceback" not in done.stderr


@pytest.mark.slow
def test_a_scene_without_its_mesh_is_skipped_and_costs_nothing(tmp_path):
    """The scanned mesh is fetched at set-up and may be absent: the scene is skipped with a clear message."""
    from shadelab.grading.grade import grade

    shutil.copytree(ROOT / "solution", tmp_path / "solution")
    shutil.copytree(ROOT / "scenes" / "phong", tmp_path / "scenes" / "phong")
    (tmp_path / "scenes" / "meshes").mkdir()
    for mesh in (ROOT / "scenes" / "meshes").glob("*.obj"):
        if mesh.name != "bunny.obj":
            (tmp_path / "scenes" / "meshes" / mesh.name).symlink_to(mesh)
    manifest = tmp_path / "solution" / "phong" / "assignment.toml"
    text = manifest.read_text()
    keep = [
        part
        for part in text.split("[[scene]]")
        if not part.strip().startswith("file") or "sphere.toml" in part or "bunny.toml" in part
    ]
    manifest.write_text("[[scene]]".join(keep))
    (manifest.parent / "hidden.toml").unlink()
    (manifest.parent / "mistakes.toml").unlink()  # to evaluate them takes the most time
    assignment = load_assignment(tmp_path / "solution" / "phong")
    result = grade(assignment, assignment.directory, only="cpp/image/*").result
    status = {check.id: check for check in result.checks}
    assert (
        status["cpp/image/bunny"].status == "skipped"
        and "bunny.obj is not on this machine" in status["cpp/image/bunny"].message
    )
    assert status["cpp/image/sphere"].status == "passed"
    assert result.score == result.max_score == 1.0  # half of the sphere's points


def test_replay_lines_replay(grade, submission, shadelab, tmp_path):
    """What a report tells a student to type works, and shows the value that the report shows."""
    change = {"m.ks * phong_lobe(n, l, v, m.q)": "m.ks + phong_lobe(n, l, v, m.q)"}
    result = grade(submission(cpp=change), only="cpp/*/[ps][hp]*")
    for id in ("cpp/function/phong", "cpp/image/sphere"):
        replay = shlex.split(result["by_id"][id]["worst"]["replay"])
        assert replay[0] == "./shadelab"
        done = shadelab(*replay[1:])
        assert done.code == 0, done.stderr
        if id == "cpp/function/phong":
            actual = result["by_id"][id]["worst"]["actual"][0]["specular"]
            assert f"result.specular = ({actual[0]:.7g}, " in done.stdout
        else:
            assert (tmp_path / "out" / "cpp-sphere.png").exists()


def test_other_ways_of_writing_are_welcome(grade, submission):
    """References, float for Real, int literals, overloads, helpers with the names of given functions."""
    cpp = {
        "vec3 mirror_direction(vec3 l, vec3 n) {": "static vec3 diffuse(vec3 a) { return a; }\nvec3 mirror_direction(const vec3& l, const vec3& n) {",
        "return 2.0 * dot(n, l) * n - l;": "return diffuse(2 * dot(n, l) * n - l);",
        "vec3 half_vector(vec3 l, vec3 v) {": "float half_vector(float a) { return a; }\nvec3 half_vector(vec3 const& l, vec3 v) {",
        "Real phong_lobe(vec3 n, vec3 l, vec3 v, Real q) {": "float phong_lobe(vec3 n, vec3 l, vec3 v, const float q) {",
    }
    assert failed(grade(submission(cpp=cpp), only="cpp/function/*")) == set()


@pytest.mark.parametrize(
    "language, change, words",
    [
        (
            "cpp",
            {
                "Terms blinn_phong(Phong m, vec3 n, vec3 l, vec3 v) {": "Terms blinn_phong(Phong m, vec3 n, vec3 l) {\n    vec3 v = l;"
            },
            "Terms blinn_phong(Phong m, vec3 n, vec3 l, vec3 v)",
        ),
        ("cpp", {"return 2.0 * dot(n, l) * n - l;": "return 2.0 * dot(n, l) * n - l;\n#if 1"}, "unterminated #if"),
        (
            "cpp",
            {
                "vec3 mirror_direction(vec3 l, vec3 n) {": "vec3 diffuse(vec3 a, vec3 b) { return a; }\nvec3 mirror_direction(vec3 l, vec3 n) {\n    l = diffuse(l, l);"
            },
            "choose another name",
        ),
        (
            "glsl",
            {
                "vec3 mirror_direction(vec3 l, vec3 n) {": "vec3 diffuse(vec3 a, vec3 b) { return a; }\nvec3 mirror_direction(vec3 l, vec3 n) {"
            },
            "choose another name",
        ),
    ],
    ids=["signature", "open-if", "taken-cpp", "taken-glsl"],
)
def test_messages_say_what_to_do(grade, submission, language, change, words):
    build = grade(submission(**{language: change}), only=f"{language}/build")["by_id"][f"{language}/build"]
    assert build["status"] == "failed" and words in build["message"], build["message"]
    assert build["message"].startswith(f"shading.{language}")


def test_a_language_that_gives_no_picture_leaves_the_other_ones_report_whole(shadelab, submission, tmp_path):
    """C++ crashes where GLSL draws what is right: the report shows both."""
    mirror = "vec3 mirror_direction(vec3 l, vec3 n) {"
    folder = submission(cpp={mirror: mirror + " *(volatile int*)0 = 1;"})
    done = shadelab("grade", folder, "--assignment", "phong", "--only", "*/image/sphere", "--out", tmp_path / "out")
    assert done.code == 0 and "Traceback" not in done.stderr, done.stderr
    assert (tmp_path / "out" / "report.html").exists()
    result = json.loads((tmp_path / "out" / "result.json").read_text())
    status = {check["id"]: check["status"] for check in result["checks"]}
    assert (status["cpp/image/sphere"], status["glsl/image/sphere"]) == ("failed", "passed")
