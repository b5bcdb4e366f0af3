"""The one door to the C++ program: what it says of scenes and manifests, and what plugins and it agree on."""

import ctypes
import json
import subprocess
from pathlib import Path

import numpy as np
import pytest

from conftest import ROOT
from shadelab.course.assignment import assignment_of_scene
from shadelab.course.toml_files import read_toml
from shadelab.errors import UserError
from shadelab.machine import renderer
from shadelab.machine.build import HEADERS, Recipe
from shadelab.machine.glue import UNDERSTOOD, glue_folder
from shadelab.paths import RENDER

PHONG = ROOT / "solution" / "phong"
SPOTS = ROOT / "scenes" / "phong" / "spots.toml"
LIGHT = ["kind", "position.x", "position.y", "position.z", "direction.x", "direction.y", "direction.z"]


def run(*arguments, input=""):
    return subprocess.run(
        [RENDER, *map(str, arguments)], capture_output=True, text=True, input=input, check=True
    ).stdout


# ---------------------------------------------------------------------------------------------------------- describe


def odd_scene(folder: Path, name: str) -> Path:
    """A scene whose material is called `name`, and whose mesh is absent."""
    told = json.dumps(name, ensure_ascii=False)  # TOML escapes alike
    (folder / "odd.toml").write_text(
        "[film]\nwidth = 40\nheight = 20\n[camera]\neye = [0, 0, 3]\ntarget = [0, 0, 0.1]\nnear = 1\nfar = 9\nfov_y = 60\n"
        '[[light]]\nkind = "spot"\nposition = [0.1, 0, 2]\ndirection = [0, 0, -3]\nintensity = [1, 2, 3]\nhotspot = 10\n'
        f'falloff = 30\n[material.{told}]\nmodel = "lambert"\nkd = [0.1, 0.2, 0.3]\n'
        f'[[object]]\nmesh = "no \\"mesh\\".obj"\nmaterial = {told}\ntranslate = [1, 2, 3]\n'
    )
    return folder / "odd.toml"


@pytest.mark.parametrize("name", ['a "quote"', "back\\slash", "tab\tand\nline\x01\x1b", "Größe, 大きさ, 🫖"])
def test_names_come_through_as_they_are(tmp_path, name):
    scene = odd_scene(tmp_path, name)
    told = json.loads(run("describe", scene, "--assignment", PHONG))
    assert [m["name"] for m in told["materials"]] == [o["material"] for o in told["objects"]] == [name]
    assert f"material.{name} (lambert): 1 object" in told["needs"]["needed"]
    assert told["objects"][0]["mesh"] == str(tmp_path / 'no "mesh".obj')


def test_a_description_holds_the_loaders_numbers(tmp_path):
    scene = odd_scene(tmp_path, "m")
    told = renderer.describe(scene, PHONG)
    assert (told.width, told.height, told.samples) == (40, 20, 1)
    assert told.fov_y == np.radians(60) and told.camera["near"] == 1 and told.camera["far"] == 9
    np.testing.assert_array_equal(told.eye, [0, 0, 3])
    np.testing.assert_array_equal(told.objects[0].to_world[:, 3], [1, 2, 3, 1])
    np.testing.assert_array_equal(told.objects[0].parameters, [0.1, 0.2, 0.3])
    np.testing.assert_array_equal(told.lights[0][: len(LIGHT)], [2, 0.1, 0, 2, 0, 0, -1])
    np.testing.assert_allclose(told.lights[0][-2:], np.radians([10, 30]), rtol=1e-15)
    assert told.calls == ["lambert", "incident_light"] and told.needs.loops == ["lambert_spot"]
    # What looks along the camera's axis is seen in the middle, and what is half the field of view off at the edge.
    clip = told.world_to_clip @ [0, np.tan(np.radians(30)), 2, 1]
    np.testing.assert_allclose(clip[:2] / clip[3], [0, 1], atol=1e-12)
    assert renderer.describe(scene, PHONG, renderer.View(size="10x30", samples=4)).height == 30
    assert told.missing_meshes() == [tmp_path / 'no "mesh".obj']
    with pytest.raises(UserError, match=r"odd\.toml:.*object\[0\]\.mesh"):  # which --explain does load
        renderer.describe(scene, PHONG, explain=True)


def look_at(eye: np.ndarray, target: np.ndarray, up: np.ndarray) -> np.ndarray:
    forward = (target - eye) / np.linalg.norm(target - eye)
    side = np.cross(forward, up)
    side /= np.linalg.norm(side)
    out = np.eye(4)
    out[:3, :3] = [side, np.cross(side, forward), -forward]
    out[:3, 3] = -out[:3, :3] @ eye
    return out


def perspective(fov_y: float, aspect: float, near: float, far: float) -> np.ndarray:
    height = np.tan(np.radians(fov_y) / 2)
    out = np.zeros((4, 4))
    out[0, 0], out[1, 1], out[3, 2] = 1 / (height * aspect), 1 / height, -1
    out[2, 2:] = -(far + near) / (far - near), -2 * far * near / (far - near)
    return out


def to_world(entry: dict) -> np.ndarray:
    """translate * rotate * scale"""
    out = np.eye(4)
    if "rotate" in entry:
        x, y, z = np.array(entry["rotate"]["axis"], float) / np.linalg.norm(entry["rotate"]["axis"])
        angle, cross = np.radians(entry["rotate"]["degrees"]), np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
        out[:3, :3] += np.sin(angle) * cross + (1 - np.cos(angle)) * cross @ cross
    out[:3, :3] *= np.broadcast_to(entry.get("scale", 1.0), 3)
    out[:3, 3] = entry.get("translate", [0, 0, 0])
    return out


SCENES = [file for file in sorted((ROOT / "scenes").glob("**/*.toml")) if "[camera]" in file.read_text()]


@pytest.mark.parametrize("scene", SCENES, ids=lambda f: f"{f.parent.name}/{f.stem}")
def test_matrices_are_what_the_file_says(scene):
    """Worked out here once more from the file itself: the truth of the visibility measurement rests on the renderer's."""
    told, text = renderer.describe(scene, assignment_of_scene(scene).directory), read_toml(scene)
    camera = text["camera"]
    eye, target = (np.array(camera[name], float) - told.origin for name in ("eye", "target"))
    up, fov_y = np.array(camera.get("up", [0, 1, 0]), float), camera.get("fov_y", 40)
    view = perspective(fov_y, told.width / told.height, camera["near"], camera["far"]) @ look_at(eye, target, up)
    np.testing.assert_allclose(told.world_to_clip, view, rtol=1e-12, atol=1e-13 * np.abs(view).max())
    assert len(told.objects) == len(text["object"])
    for each, entry in zip(told.objects, text["object"]):
        expected = to_world(entry)
        expected[:3, 3] -= told.origin
        np.testing.assert_allclose(each.to_world, expected, rtol=1e-12, atol=1e-13 * np.abs(expected).max())


def test_a_frame_is_written_under_any_name(tmp_path, glue):
    plugin = compiled(glue, tmp_path, "plugin.so", [])
    file = tmp_path / 'a "b" \\ c.npy'
    answers = run(
        "frames", SPOTS, "--assignment", PHONG, "--plugin", plugin, "--size", "9x9", input=f"draw\nwrite {file}\n"
    )
    ready, drawn, written = map(json.loads, answers.splitlines())
    assert ready["ready"] is True and drawn["ms"] > 0 and written == {"written": str(file)}
    assert np.load(file).shape == (9, 9, 3)


def test_what_is_understood_of_a_manifest(glue):
    told = json.loads((glue / UNDERSTOOD).read_text())
    assert told["schema"] == "shadelab/assignment/2" and told["name"] == "phong" and told["directory"] == str(PHONG)
    assert (
        told["models"][:2] == ["phong", "blinn_phong"] and "lambert" in told["models"] and told["given"] == ["lights"]
    )
    assert [f["name"] for f in told["fragment"]] == ["n", "x", "v"]
    assert [k["kind"] for k in told["lights"]] == ["point", "directional", "spot"]
    phong = next(f for f in told["functions"] if f["name"] == "phong")
    columns = [f"{c['path']}.{c['index']}" for c in phong["inputs"]]
    assert phong["model"] and columns[:4] == ["m.ka.0", "m.ka.1", "m.ka.2", "m.kd.0"] and columns[9] == "m.q.0"
    assert [c["path"] for c in phong["outputs"]] == [
        "result." + t for t in ("ambient", "diffuse", "specular") for _ in "xyz"
    ]
    assert {s["name"] for s in told["scenes"]} >= {"teapot", "spots"}
    assert all(Path(s["file"]).is_file() for s in told["scenes"])


# ----------------------------------------------------------------------------------------------------------- plugins


@pytest.fixture(scope="module")
def glue():
    return glue_folder(PHONG)


def compiled(glue: Path, folder: Path, name: str, flags: list[str], recipe: Recipe = Recipe(quick=True)) -> Path:  # noqa: B008
    words = ["g++", *recipe.flags(), *flags, f"-I{HEADERS}", f"-I{glue}", f"-I{PHONG}", str(glue / "glue.cpp")]
    subprocess.run([*words, "-o", str(folder / name)], check=True)
    return folder / name


class Model(ctypes.Structure):
    _fields_ = [("name", ctypes.c_char_p), ("column_count", ctypes.c_int), ("columns", ctypes.POINTER(ctypes.c_char_p)),
                ("shade", ctypes.POINTER(ctypes.c_void_p))]  # fmt: skip


class Table(ctypes.Structure):
    _fields_ = [*((name, ctypes.c_int) for name in ("version", "real_size", "terms", "kinds", "models", "functions")),
                ("model", ctypes.POINTER(Model))]  # fmt: skip


def columns_of(plugin: Path, model: str) -> list[str]:
    table = Table.in_dll(ctypes.CDLL(str(plugin)), "shadelab_plugin")
    found = next(m for m in table.model[: table.models] if m.name.decode() == model)
    return [name.decode() for name in found.columns[: found.column_count]]


def drawn(plugin: Path, folder: Path, *options: str) -> bytes:
    image = folder / "image.npy"
    run("image", SPOTS, "--assignment", PHONG, "--plugin", plugin, "--size", "96x64", "--layers", "-o", image, *options)
    assert np.load(image)[..., :3].max() > 0.05
    return image.read_bytes()


NXV = [f"{name}.{axis}" for name in "nxv" for axis in "xyz"]


@pytest.mark.parametrize("real", ["float", "double"])
def test_a_member_of_the_material_may_be_a_column(tmp_path, glue, real):
    """As textures will need it. Whichever members they are, and in whatever number: the same bits as with a constant."""
    recipe = Recipe(double=real == "double", quick=True)
    plain = compiled(glue, tmp_path, "plain.so", [], recipe)
    assert columns_of(plain, "phong") == columns_of(plain, "lambert") == NXV
    expected = drawn(plain, tmp_path)
    for members, columns in {
        ("kd",): ["m.kd.x", "m.kd.y", "m.kd.z"],
        ("q", "ka"): ["m.ka.x", "m.ka.y", "m.ka.z", "m.q"],
    }.items():
        flags = [f"-DSHADELAB_COLUMN_phong_{member}" for member in members]
        varied = compiled(glue, tmp_path, "-".join(members) + ".so", flags, recipe)
        assert columns_of(varied, "phong") == [*NXV, *columns]
        assert columns_of(varied, "lambert") == NXV
        assert drawn(varied, tmp_path) == expected


def test_a_plugin_that_takes_what_no_fragment_holds_is_refused(tmp_path, glue):
    text = (glue / "glue.cpp").read_text().replace('"v.x"', '"w.x"')
    (tmp_path / "glue.cpp").write_text(text)
    words = ["g++", *Recipe(quick=True).flags(), f"-I{HEADERS}", f"-I{glue}", f"-I{PHONG}", str(tmp_path / "glue.cpp")]
    subprocess.run([*words, "-o", str(tmp_path / "plugin.so")], check=True)
    command = [RENDER, "image", SPOTS, "--assignment", PHONG, "--plugin", tmp_path / "plugin.so"]
    done = subprocess.run(list(map(str, command)), capture_output=True, text=True)
    assert done.returncode == 3
    assert done.stderr.strip() == "the plugin's model takes w.x, which no fragment holds; build it again"
