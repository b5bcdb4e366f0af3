"""probe: the facts of a pixel against arithmetic of its own, values against 50 digits, and what is marked, shown and refused."""

import json
import math
import re

import numpy as np
import pytest

from conftest import ROOT
from shadelab.course.assignment import load_assignment
from shadelab.truth import exact

PHONG = ROOT / "solution" / "phong"
SPHERE = ROOT / "scenes" / "phong" / "sphere.toml"
PIXEL = (320, 180)  # in the highlight
AT = "{},{}".format(*PIXEL)


def unit(v):
    return v / np.linalg.norm(v)


def facts_on_the_sphere(column, row):
    """n, x, l, v and h of the unit sphere under sphere.toml's camera and light, by intersecting the pixel's ray."""
    eye, light = np.array([0, 0.4, 3.6]), np.array([2, 3, 2.5])
    forward = unit(-eye)
    right = unit(np.cross(forward, [0, 1, 0]))
    up, half = np.cross(right, forward), math.tan(math.radians(20))
    ray = unit(forward + half * (((column + 0.5) / 256 - 1) * right + (1 - (row + 0.5) / 256) * up))
    x = eye + ray * (-eye @ ray - math.sqrt((eye @ ray) ** 2 - eye @ eye + 1))
    l, v = unit(light - x), unit(eye - x)
    return {"n": x, "x": x, "l": l, "v": v, "h": unit(l + v)}


def test_facts_and_values_of_a_pixel(shadelab):
    done = shadelab("probe", SPHERE, AT, "--json", "-")
    assert done.code == 0, done.stderr
    found = json.loads(done.stdout)
    [light] = found["lights"]
    for name, wanted in facts_on_the_sphere(*PIXEL).items():
        # The mesh is a fine one: it leaves the sphere by a 2000th of its radius at most.
        np.testing.assert_allclose((found | light)[name], wanted, atol=1e-3, err_msg=name)
    assert (found["object"], found["material"], found["model"], light["kind"]) == (1, "clay", "phong", "point")
    assert found["m.q"] == 32 and found["m.kd"] == pytest.approx([0.6, 0.3, 0.2])
    # In data-flow order, everything that takes part and nothing else; each with its arguments.
    calls = {call["function"]: call for call in light["calls"]}
    assert list(calls) == ["mirror_direction", "phong_lobe", "phong"]
    slides = exact.load(PHONG / "exact.py")
    for call in calls.values():
        vectors = {k: exact.vector(*a) for k, a in call["arguments"].items() if k in ("n", "l", "v")}
        vectors = {k: exact.normalize(v) for k, v in vectors.items()}
        if call["function"] == "phong":
            terms = slides.phong({"ka": [0.02] * 3, "kd": [0.6, 0.3, 0.2], "ks": [0.4] * 3, "q": 32}, **vectors)
            wanted = {f"result.{term}": [float(c) for c in colour] for term, colour in terms.items()}
            tolerance = 2e-7  # the material travels as float32
        else:
            value = getattr(slides, call["function"])(**vectors, **({"q": 32} if "v" in vectors else {}))
            wanted, tolerance = {"result": np.array(value, float)}, 1e-12
        for name, value in wanted.items():
            np.testing.assert_allclose(call["expected"][name], value, rtol=tolerance)
            for backend in ("cpp", "glsl"):
                np.testing.assert_allclose(call[backend][name], value, rtol=2e-4)
        assert call["wrong"] == []
    # The picture: the terms times what arrives from the light, 14 over its squared distance.
    arrives = 14 / np.sum((np.array([2, 3, 2.5]) - found["x"]) ** 2)
    for side, image in found["rendered"].items():
        for term in ("ambient", "diffuse", "specular"):
            value = np.array(calls["phong"]["expected"][f"result.{term}"]) * arrives
            np.testing.assert_allclose(image[term], value, rtol=1e-4, err_msg=side)
        np.testing.assert_allclose(image["total"], sum(np.array(image[t]) for t in image if t != "total"), rtol=1e-5)
    assert list(found["rendered"]) == ["cpp", "glsl", "expected"] and found["first_wrong"] == {}
    table = done.stderr  # with --json - the table goes there
    number = f"{calls['phong_lobe']['expected']['result']:.6g}"
    assert re.search(rf"phong_lobe\(n, l, v, q = 32\) +[\d.]+ +[\d.]+ +{number}\n", table)
    assert "Every value here is within its limit." in table and "\x1b" not in table
    assert max(len(line) for line in table.splitlines()) <= 80


def test_a_mistake_is_marked_and_named(shadelab, submission):
    """Wrong in C++ alone: what calls it is off, too, and what comes first is named."""
    folder = submission(cpp={"return 2.0 * dot(n, l) * n - l;": "return l - 2.0 * dot(n, l) * n;"})
    done = shadelab("probe", SPHERE, AT, "--shading", folder, "--json", "probe.json")
    assert done.code == 0, done.stderr
    assert "The first that is wrong, in data-flow order: mirror_direction (C++)." in done.stdout
    marked = [line for line in done.stdout.splitlines() if "✗" in line]
    assert any(re.match(r"phong_lobe\(n, l, v, q = 32\) +0 ✗ +0\.8\d+ +0\.8\d+$", line) for line in marked)
    assert not any("diffuse" in line or "ambient" in line for line in marked)
    assert all(line.count("✗") == 1 for line in marked)
    found = json.loads((folder.parent / "probe.json").read_text())
    assert found["first_wrong"] == {"cpp": "mirror_direction"}
    assert all(call["wrong"] == ["cpp"] for call in found["lights"][0]["calls"])


def test_one_language_that_does_not_compile_costs_its_column(shadelab, submission, tmp_path):
    """And a scene of one's own is drawn; the solution tells what is expected there, too."""
    folder = submission(cpp={"if (dot(sum, sum) == 0.0) return vec3(0.0);": "if (nonsense) return vec3(0.0);"})
    scene = tmp_path / "mine.toml"
    text = SPHERE.read_text().replace("../meshes", str(ROOT / "scenes" / "meshes"))
    scene.write_text(text.replace('model = "phong"', 'model = "blinn_phong"').replace("[14, 14, 14]", "[7, 7, 7]"))
    done = shadelab("probe", scene, AT, "--shading", folder)
    assert done.code == 0, done.stderr
    assert re.search(r"C\+\+: shading\.cpp:\d+:\d+: 'nonsense' was not declared", done.stdout)
    assert re.search(r"^ +GLSL +expected$", done.stdout, re.MULTILINE)
    assert "half_vector(l, v)" in done.stdout and "blinn_lobe(n, l, v, q = 32)" in done.stdout
    assert "mirror_direction" not in done.stdout and "Every value here is within its limit." in done.stdout


def test_without_the_solution_the_students_own_calls_are_shown(shadelab, tmp_path):
    """As in a release: what takes part is what the student's C++ calls, with its arguments; braces as people write."""
    scene = next(s for s in load_assignment(ROOT / "solution" / "lights").scenes if s.hidden)
    folder = tmp_path / "mine"
    folder.mkdir()
    for language in ("cpp", "glsl"):
        text = (ROOT / "solution/lights" / f"shading.{language}").read_text()
        text = re.sub(r"^(vec3 irradiance\(.*\)) \{$", r"\1 // irradiance(x) {\n{", text, flags=re.MULTILINE)
        (folder / f"shading.{language}").write_text(text)
    done = shadelab("probe", scene.file, "0,0", "--shading", folder)
    at = re.search(r"nearest of an object is (\d+,\d+)", done.stderr)[1] if done.code else "0,0"
    done = shadelab("probe", scene.file, at, "--shading", folder, "--json", "-")
    assert done.code == 0, done.stderr
    found = json.loads(done.stdout)
    calls = [call for light in found["lights"] for call in light["calls"]]
    names = {call["function"] for call in calls}
    assert {"incident_light", "irradiance", "diffuse"} <= names and names & {"distance_falloff", "spot_attenuation"}
    assert not any("Left out" in note for note in found["notes"])
    for call in calls:
        assert "expected" not in call
        for name, value in call["cpp"].items():
            np.testing.assert_allclose(call["glsl"][name], value, rtol=1e-4, atol=1e-6)
    assert any("what your C++ calls them with" in note for note in found["notes"])


def test_a_hidden_scene_shows_nothing_expected(shadelab):
    scene = next(s for s in load_assignment(PHONG).scenes if s.hidden)
    background = shadelab("probe", scene.file, "0,0")
    assert background.code == 2 and len(background.stderr.splitlines()) == 1
    [nearest] = re.findall(
        r"pixel 0,0 is background; the nearest of an object is (\d+,\d+)$", background.stderr.strip()
    )
    done = shadelab("probe", scene.file, nearest, "--json", "-")
    assert done.code == 0, done.stderr
    found = json.loads(done.stdout)
    calls = [call for light in found["lights"] for call in light["calls"]]
    assert calls and all(set(call) == {"function", "arguments", "cpp", "glsl", "wrong"} for call in calls)
    assert all(call["wrong"] == [] for call in calls) and found["first_wrong"] is None
    assert set(found["rendered"]) == {"cpp", "glsl"}
    assert "No expected values of functions: the scene is hidden." in done.stderr


@pytest.mark.parametrize(
    "arguments, words",
    [
        (["scenes/nowhere.toml", "1,2"], "scenes/nowhere.toml: cannot be read"),
        ([SPHERE, "12"], "12: give a pixel as X,Y"),
        ([SPHERE, "1.5,2"], "1.5,2: give a pixel as X,Y"),
        ([SPHERE, "512,3"], "the image has 512 x 512 pixels: X,Y is at most 511,511"),
        ([SPHERE, "3,3", "--json", "nowhere/a.json"], "--json nowhere/a.json: there is no folder nowhere"),
        ([SPHERE, "3,3", "--shading", "nowhere"], "nowhere: there is no such folder"),
    ],
)
def test_bad_usage_is_one_line(shadelab, arguments, words):
    done = shadelab("probe", *arguments)
    assert done.code == 2 and not done.stdout
    assert words in done.stderr and len(done.stderr.strip().splitlines()) == 1
