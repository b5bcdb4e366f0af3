"""render, eval, reference, starter and doctor, through the command line."""

import json
import shutil
import time

import numpy as np
import pytest
from PIL import Image

from conftest import ROOT
from shadelab.cli import app
from shadelab.cli import options as cli_options
from shadelab.course.assignment import assignment_names, load_assignment
from shadelab.course.hidden import draw_hidden_scenes
from shadelab.truth.digest import digest

PHONG = ROOT / "solution" / "phong"
SPHERE = ROOT / "scenes" / "phong" / "sphere.toml"


def test_render_writes_each_format(shadelab, tmp_path):
    for name in ("a.png", "a.exr", "a.npy"):
        done = shadelab("render", SPHERE, "--size", "64x48", "--layers", "-o", name)
        assert done.code == 0 and done.stdout == f"{name}\n"
    assert (tmp_path / "a.png").read_bytes().startswith(b"\x89PNG")
    assert (tmp_path / "a.normal.png").exists()
    assert (tmp_path / "a.exr").read_bytes()[:4] == b"\x76\x2f\x31\x01"
    assert np.load(tmp_path / "a.npy").shape == (48, 64, 21)


def test_render_glsl_writes_the_same_png(shadelab, tmp_path):
    for backend in ("cpp", "glsl"):
        options = ["--shading", "solution", "--backend", backend, "--size", "64x64"]
        shutil.copytree(PHONG, tmp_path / "solution", dirs_exist_ok=True)  # a relative folder, as students type it
        assert shadelab("render", SPHERE, *options, "-o", f"{backend}.png").code == 0
    pictures = [np.asarray(Image.open(tmp_path / f"{b}.png")).astype(int) for b in ("cpp", "glsl")]
    assert pictures[0].shape == (64, 64, 3) and pictures[0].max() > 200
    assert np.abs(pictures[0] - pictures[1]).max() <= 1  # the renderers differ by rounding


def test_x_to_the_zero_is_one_inside_the_gate(shadelab, tmp_path):
    """Also where the cosine is 0, in both languages (0^0 is no number to some drivers)."""
    up, side, down = [0, 1, 0], [1, 0, 0], [0, -1, 0]
    np.savez(tmp_path / "in.npz", n=[up, up, up], l=[up, up, down], v=[side, down, up], q=[0, 0, 0])
    for function in ("phong_lobe", "blinn_lobe"):
        for backend in ("cpp", "glsl"):
            done = shadelab("eval", PHONG, function, "--inputs", "in.npz", "-o", "out.npz", "--backend", backend)
            assert done.code == 0, done.stderr
            np.testing.assert_array_equal(np.load(tmp_path / "out.npz")["result"], [1, 1, 0])


def test_explain_and_full(shadelab, tmp_path):
    """What is left out changes no pixel."""
    scene = tmp_path / "scene.toml"
    dark = '\n[[light]]\nkind = "spot"\nposition = [1, 1, 1]\ndirection = [0, -1, 0]\nhotspot = 5\nfalloff = 9\nintensity = [0, 0, 0]\n'
    scene.write_text(
        SPHERE.read_text()
        .replace("../meshes", str(ROOT / "scenes" / "meshes"))
        .replace("[material", dark + "\n[material")
    )
    options = ["--shading", PHONG, "--size", "96x96"]
    lean = shadelab("render", scene, *options, "--explain", "-o", "lean.npy")
    needed, left_out = lean.stdout.split("left out")
    assert "light[0] (point)" in needed and "light[1] (spot): its intensity is zero" in left_out
    full = shadelab("render", scene, *options, "--explain", "--full", "-o", "full.npy")
    assert "light[1] (spot): kept by --full" in full.stdout.split("left out")[0]
    np.testing.assert_array_equal(np.load(tmp_path / "lean.npy"), np.load(tmp_path / "full.npy"))


def test_double_and_threads_change_no_coverage(shadelab, tmp_path):
    for name, options in {"float": [], "double": ["--double"], "one": ["--threads", "1"]}.items():
        assert shadelab("render", SPHERE, "--layers", "--size", "128x128", *options, "-o", f"{name}.npy").code == 0
    single, double, one = (np.load(tmp_path / f"{n}.npy") for n in ("float", "double", "one"))
    np.testing.assert_array_equal(single, one)
    np.testing.assert_array_equal(single[..., 12:14], double[..., 12:14])  # coverage, id
    # The reference's depth is worked out without the rasterizer's roundings.
    np.testing.assert_allclose(single[..., 14], double[..., 14], rtol=0, atol=4 * 2.0**-24)
    assert not np.array_equal(single, double)
    np.testing.assert_allclose(single[..., :3], double[..., :3], atol=2e-5)


@pytest.mark.parametrize(
    "broken, words",
    [
        (("q = 32", "q = -1"), "{line}: material.clay.q: must be at least 0"),
        (("kd =", "kD ="), "material.clay.kd: is missing"),
        (('model = "phong"', 'model = "pong"'), "material.clay.model: must be phong, blinn_phong, "),
        (("[camera]", "[camera"), "not valid TOML"),
        (("sphere.obj", "spere.obj"), "spere.obj cannot be read"),
        (("[material.clay]", "[[material]]"), "material"),
        (("fov_y = 40", "fov_y = 40\nfovy = 3"), 'camera.fovy: unknown key; did you mean "fov_y"?'),
    ],
)
def test_a_broken_scene_is_one_line(shadelab, tmp_path, broken, words):
    text = SPHERE.read_text().replace("../meshes", str(ROOT / "scenes" / "meshes"))
    assert text.count(broken[0]) == 1
    (tmp_path / "scene.toml").write_text(text.replace(*broken))
    done = shadelab("render", "scene.toml", "--shading", PHONG)
    assert done.code == 2 and len(done.stderr.strip().splitlines()) == 1
    line = next(k for k, content in enumerate(text.splitlines(), 1) if broken[0] in content)
    assert "scene.toml" in done.stderr and words.format(line=f"scene.toml:{line}") in done.stderr


@pytest.mark.parametrize("backend", ["cpp", "glsl"])
def test_eval(shadelab, tmp_path, backend):
    n, l, v = [[0, 1, 0]] * 2, [[0, 1, 0], [0, -1, 0]], [[0, 0.8, 0.6]] * 2
    material = {"m.ka": [[0.1] * 3] * 2, "m.kd": [[0.5, 0.25, 1.0]] * 2, "m.ks": [[1, 1, 1]] * 2, "m.q": [2, 2]}
    np.savez(tmp_path / "in.npz", n=n, l=l, v=v, **material)
    done = shadelab("eval", PHONG, "phong", "--inputs", "in.npz", "-o", "out.npz", "--backend", backend)
    assert done.code == 0, done.stderr
    out = np.load(tmp_path / "out.npz")
    assert set(out) == {"result.ambient", "result.diffuse", "result.specular"}
    np.testing.assert_allclose(out["result.ambient"], np.full((2, 3), 0.1), rtol=1e-6)
    np.testing.assert_allclose(out["result.diffuse"], [[0.5, 0.25, 1.0], [0, 0, 0]], rtol=1e-6)
    np.testing.assert_allclose(out["result.specular"], [[0.64] * 3, [0] * 3], rtol=1e-5)
    assert "phong(m.ka = (0.1, 0.1, 0.1)" in done.stdout and "result.specular = (0.64" in done.stdout


def test_eval_shows_what_the_student_prints(shadelab, tmp_path, submission):
    region = "    vec3 sum = l + v;"
    folder = submission(
        cpp={
            region: '    std::cout << "sum " << (l + v).y << "\\n";\n' + region,
            "#include <shadelab/shading.hpp>\n": "#include <shadelab/shading.hpp>\n#include <iostream>\n",
        }
    )
    np.savez(tmp_path / "in.npz", l=[[0, 1, 0]], v=[[0, 1, 0]])
    done = shadelab("eval", folder, "half_vector", "--inputs", "in.npz", "--assignment", "phong")
    assert done.stdout.startswith("sum 2\n")


@pytest.mark.parametrize(
    "arrays, words",
    [
        ({"l": [[0, 1, 0]]}, "the input v is missing; the inputs are l, v"),
        ({"l": [[0, 1, 0]], "v": [[0, 1]]}, "v must have the shape (N, 3), not (1, 2)"),
        ({"l": [[0, 1, 0]], "v": [[0, 1, 0]] * 2}, "the same first axis"),
        ({"l": [[0, 1, 0]], "v": [[0, 1, 0]], "w": [1]}, "unknown input w"),
    ],
)
def test_eval_says_what_is_wrong_with_inputs(shadelab, tmp_path, arrays, words):
    np.savez(tmp_path / "in.npz", **arrays)
    done = shadelab("eval", PHONG, "half_vector", "--inputs", "in.npz")
    assert done.code == 2 and words in done.stderr and len(done.stderr.strip().splitlines()) == 1


def test_expected_data_is_content_addressed(tmp_path):
    """The digest follows the solution's text, the manifests, the mistakes and the scenes."""
    shutil.copytree(ROOT / "solution", tmp_path / "solution")
    shutil.copytree(ROOT / "scenes" / "phong", tmp_path / "scenes" / "phong")
    (tmp_path / "scenes" / "meshes").symlink_to(ROOT / "scenes" / "meshes")

    def key():
        assignment = load_assignment(tmp_path / "solution" / "phong")
        draw_hidden_scenes(assignment.hidden, assignment.directory, assignment.name)
        return digest(assignment)

    digests = [key()]
    for file, old, new in [
        ("solution/phong/shading.cpp", "2.0 * dot(n, l)", "2 * dot(n, l)"),
        ("solution/lights/shading.cpp", "3.0 - 2.0 * t", "3.0 - 2 * t"),
        ("solution/phong/assignment.toml", "typical = [1, 512]", "typical = [1, 513]"),
        ("solution/phong/mistakes.toml", "1.0625 * q", "1.125 * q"),
        ("scenes/phong/teapot.toml", "q = 60", "q = 61"),
    ]:
        path = tmp_path / file
        text = path.read_text()
        assert old in text
        path.write_text(text.replace(old, new))
        digests.append(key())
    assert len(set(digests)) == len(digests)
    handout = tmp_path / "solution" / "phong" / "handout.md"  # words that no number depends on
    handout.write_text(handout.read_text() + "\nOne more line.\n")
    assert key() == digests[-1]


def test_reference_names_its_folder(shadelab):
    first, second = shadelab("reference", "phong"), shadelab("reference", "phong")
    assert first.code == 0 and first.stdout == second.stdout
    assert digest(load_assignment(PHONG)) in first.stdout


def test_starter_is_in_step(shadelab):
    done = shadelab("starter", "--verify")
    assert done.code == 0, done.stdout


@pytest.mark.parametrize("name", assignment_names())
def test_starter_holds_no_line_of_the_solution(name):
    from shadelab.course.mistakes import regions

    for language in ("cpp", "glsl"):
        source = ROOT / "solution" / name / f"shading.{language}"
        starter = (ROOT / "starter" / name / f"shading.{language}").read_text()
        assert "STUDENT" not in starter
        held = {line.strip() for line in starter.splitlines()}
        for function, region in regions(source.read_text(), source).items():
            for line in region["body"].splitlines():
                # Lines as short as `return 0.0;` or `Real nv = dot(n, v);` are no secret.
                assert len(line.strip()) < 24 or line.strip() not in held, f"{function}: {line}"


def test_doctor(shadelab):
    done = shadelab("doctor")
    assert done.code == 0, done.stdout
    assert "OpenGL in use" in done.stdout and ("through osmesa" in done.stdout or "through egl" in done.stdout)


def test_help_lists_every_command(shadelab):
    done = shadelab("--help")
    for command in ("grade", "render", "eval", "reference", "check", "starter", "doctor", "test"):
        assert command in done.stdout
        assert shadelab(command, "--help").code == 0


def test_eval_refuses_what_is_no_npz(shadelab, tmp_path):
    (tmp_path / "broken.npz").write_bytes(b"PK\x03\x04 nonsense")
    (tmp_path / "empty.npz").write_bytes(b"")
    np.save(tmp_path / "plain.npy", np.zeros(3))
    for name in ("broken.npz", "empty.npz", "plain.npy"):
        done = shadelab("eval", PHONG, "half_vector", "--inputs", name)
        assert done.code == 2 and len(done.stderr.strip().splitlines()) == 1 and name in done.stderr


def test_eval_takes_inputs_by_hand(shadelab, tmp_path):
    given = [f"--set={name}" for name in ("n=0,1,0", "l=0,1,0", "v=0,0.6,0.8", "q=2")]
    done = shadelab("eval", ROOT / "solution" / "phong", "phong_lobe", *given, "-o", tmp_path / "one.npz")
    assert done.code == 0 and "q = 2" in done.stdout, done.stderr
    assert np.load(tmp_path / "one.npz")["result"] == pytest.approx([0.36], rel=1e-6)
    # Beside an array: for each of its rows.
    np.savez(tmp_path / "in.npz", n=[[0, 1, 0]] * 2, l=[[0, 1, 0]] * 2, v=[[0, 0.6, 0.8], [0, 1, 0]])
    mixed = ["--inputs", tmp_path / "in.npz", "--set", "q=2", "-o", tmp_path / "two.npz"]
    done = shadelab("eval", ROOT / "solution" / "phong", "phong_lobe", *mixed)
    assert done.code == 0, done.stderr
    assert np.load(tmp_path / "two.npz")["result"] == pytest.approx([0.36, 1], rel=1e-6)


@pytest.mark.parametrize(
    "settings, words",
    [
        ([], "which inputs? Give --inputs IN.npz, or --set for each of n, l, v, q"),
        (["q=1"], "the input n is missing"),
        (["n=0,1"], "--set n=0,1: n takes 3 numbers, as in n=0,0,1"),
        (["q=1,2"], "q takes a number"),
        (["q=much"], "q takes a number"),
        (["m.q=1"], "--set m.q=1: the inputs are n, l, v, q"),
    ],
)
def test_eval_says_what_is_wrong_with_inputs_by_hand(shadelab, settings, words):
    done = shadelab("eval", ROOT / "solution" / "phong", "phong_lobe", *(f"--set={s}" for s in settings))
    assert done.code == 2 and words in done.stderr and len(done.stderr.splitlines()) == 1


@pytest.mark.parametrize("columns", ["0", "1", "wide"])
def test_any_width_of_a_terminal_will_do(shadelab, columns):
    for command in (["--help"], ["grade", "--help"], ["doctor"]):
        done = shadelab(*command, COLUMNS=columns)
        assert done.code == 0 and len(done.stdout) > 500 and "Traceback" not in done.stderr
    only = ["--only", "*/function/half_vector", "--only", "cpp/function/mirror_direction", "--no-html"]
    done = shadelab("grade", ROOT / "starter" / "phong", *only, COLUMNS=columns)
    assert done.code == 0 and "half_vector" in done.stdout and "mirror_direction" in done.stdout, done.stderr


def test_only_what_was_asked_for_and_each_of_it_is_there(shadelab):
    grade = ["grade", ROOT / "solution" / "phong", "--no-html", "--json", "-"]
    done = shadelab(*grade, "--only", "cpp/function/half_vector", "--only", "glsl/function/phong_lobe")
    assert [c["id"] for c in json.loads(done.stdout)["checks"]] == [
        "cpp/build", "cpp/function/half_vector", "glsl/build", "glsl/function/phong_lobe",
    ]  # fmt: skip
    done = shadelab(*grade, "--only", "cpp/function/half_vector", "--only", "none")
    assert done.code == 2 and "--only none: no check" in done.stderr
    done = shadelab(*grade[:3], "--only", "cpp/build")
    assert done.code == 0 and "it carries no points" in done.stdout and "every check" not in done.stdout


def test_a_planned_command_says_that_it_is_planned(shadelab):
    for name in ("view", "lecture", "site", "fit", "acquire", "cohort"):
        done = shadelab(name, "x")
        assert (done.code, done.stdout) == (2, "") and done.stderr.startswith(f"{name}: is planned")


def test_long_work_is_told_off_a_terminal_too(capfd, monkeypatch):
    """A line every few seconds, also of one step that takes long; what is done soon says nothing."""
    monkeypatch.setattr(cli_options, "FIRST_LINE", 0.2)
    monkeypatch.setattr(cli_options, "NEXT_LINE", 0.2)
    with cli_options.progress_lines() as tell:
        for done in range(50):
            tell("reference phong: tables", done, 50)
        time.sleep(0.5)
    lines = capfd.readouterr().err.splitlines()
    assert 2 <= len(lines) <= 3 and all(line.startswith("reference phong: tables (49 of 50), ") for line in lines)
    with cli_options.progress_lines() as tell:
        tell("grade", 0, 1)
    assert capfd.readouterr().err == ""


def test_a_fault_of_ours_is_no_low_score(monkeypatch, capsys):
    """Exit code 1 is a score under --fail-under; what we did wrong is 3."""
    monkeypatch.setattr(app, "program", lambda: lambda **_: 1 / 0)
    with pytest.raises(SystemExit) as end:
        app.main()
    assert end.value.code == 3 and "a fault of Shadelab, not yours (ZeroDivisionError)" in capsys.readouterr().err
