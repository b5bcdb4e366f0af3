"""Frame packets (packet.hpp): what stands in one, and that clients that know nothing else draw the same pixels."""

import json
import os
import sys
from pathlib import Path

import moderngl
import numpy as np
import pytest

from conftest import ROOT
from shadelab.errors import InfrastructureError, UserError
from shadelab.gl.client import Client
from shadelab.gl.packet import Packet
from shadelab.machine import renderer
from shadelab.measure.standing import resident
from shadelab.truth.expected import CHANNELS

PHONG = ROOT / "solution" / "phong"
STUDENT = (PHONG / "shading.glsl").read_text()
SPOTS, GOURAUD, KNOT = (ROOT / "scenes" / "phong" / f"{name}.toml" for name in ("spots", "interpolation", "knot"))
TINY = "96x80"


def packet_of(scene: Path, folder: Path, assignment: Path = PHONG, **view) -> Packet:
    file = folder / "frame.packet"
    renderer.packet(scene, assignment, file, renderer.View(size=TINY, **view))
    return Packet(file)


def grid_scene(folder: Path) -> Path:
    """More lights than stand one by one in a shader: they come from a texture."""
    text = SPOTS.read_text().replace("../meshes", str(ROOT / "scenes" / "meshes"))
    grid = '\n[[light]]\nkind = "point"\nposition = [-2, 3, 2]\nintensity = [1, 1, 1]\n'
    (folder / "grid.toml").write_text(
        text + grid + "grid = { columns = 6, rows = 4, across = [0.5, 0, 0], up = [0, 0.3, 0] }\n"
    )
    return folder / "grid.toml"


# ------------------------------------------------------------------------------------------- a client of its own


def drawn_by_the_book(file: Path, student: str) -> np.ndarray:
    """The image, by somebody who has read packet.hpp and nothing else."""
    with open(file, "rb") as stream:
        assert stream.readline() == b"shadelab packet 2\n"
        header = json.loads(stream.read(int(stream.readline())))
        data = stream.read()
    gl = Client().context
    gl.enable(moderngl.DEPTH_TEST)
    size = header["width"], header["height"]

    def floats(place: dict, numbers: int) -> bytes:
        return data[place["offset"] : place["offset"] + 4 * numbers]

    def stage(pieces: list) -> str:
        text = f"#version {header['glsl']['version']}\n{header['glsl']['precision']}"
        for piece in pieces:
            own = student if "student" in piece else piece.get("text") or header["sources"][piece["source"]]
            text += f"#line {piece['line']}\n{own}\n"
        return text

    programs = [gl.program(stage(p["vertex"]), fragment_shader=stage(p["fragment"])) for p in header["programs"]]
    for unit, declared in enumerate(header["textures"]):
        wide, high = declared["width"], declared["height"]
        gl.texture((wide, high), 4, floats(declared, 4 * wide * high), dtype="f4").use(unit)
    passes = []
    for declared in header["passes"]:
        targets = [gl.texture(size, 4, dtype="f4") for _ in declared["targets"]]
        resolved = gl.framebuffer(targets)
        samples = 0 if declared["samples"] == 1 else declared["samples"]
        drawn = [gl.renderbuffer(size, 4, samples=samples, dtype="f4") for _ in targets]
        for target, each in zip(drawn, declared["targets"]):
            gl.framebuffer([target]).clear(*each["clear"])
        depth = gl.depth_renderbuffer(size, samples=samples)
        gl.framebuffer(depth_attachment=depth).clear(depth=1.0)
        frame = gl.framebuffer(drawn, depth)
        frame.use()
        for draw in declared["draws"]:
            program, thing = programs[draw["program"]], header["objects"][draw["object"]]
            for name, numbers in {**header["uniforms"], **thing["uniforms"]}.items():
                if name in program:
                    program[name].write(np.array(numbers, np.float32).tobytes())
            for unit, texture in enumerate(header["textures"]):
                if texture["name"] in program:
                    program[texture["name"]].value = unit
            attributes = [
                (gl.buffer(floats(place, place["count"] * place["components"])), f"{place['components']}f", name)
                for name, place in thing["attributes"].items()
                if name in program
            ]
            indices = gl.buffer(floats(thing["indices"], thing["indices"]["count"]))
            gl.vertex_array(program, attributes, indices).render()
        gl.copy_framebuffer(resolved, frame)
        read = [np.frombuffer(target.read(), np.float32).reshape(size[1], size[0], 4)[::-1] for target in targets]
        passes.append(read)
    n, layers = header["supersample"], []
    for layer in header["film"]:
        part = passes[layer["pass"]][layer["target"]][..., layer["first"] : layer["first"] + layer["channels"]]
        if layer["reduce"] == "centre":
            layers.append(part[n // 2 :: n, n // 2 :: n])
        else:
            blocks = part.reshape(size[1] // n, n, size[0] // n, n, -1)
            layers.append(blocks.mean(axis=(1, 3), dtype=np.float64).astype(np.float32))
    return np.concatenate(layers, axis=2)


@pytest.mark.parametrize(
    "view",
    [{}, {"layers": "all"}, {"layers": "all", "samples": 4}, {"layers": "terms", "supersample": 2}, {"full": True}],
    ids=["total", "layers", "samples", "supersample", "full"],
)
@pytest.mark.parametrize("scene", [SPOTS, GOURAUD, "grid"], ids=["spots", "gouraud", "grid"])
def test_another_client_draws_the_same(scene, view, tmp_path):
    scene = grid_scene(tmp_path) if scene == "grid" else scene
    packet = packet_of(scene, tmp_path, **view)
    image, _ = Client(student=STUDENT).draw(packet)
    assert image[..., :3].max() > 0.05
    np.testing.assert_array_equal(drawn_by_the_book(tmp_path / "frame.packet", STUDENT), image)


# ----------------------------------------------------------------------------------------------- what stands in it


def test_buffers_are_what_the_header_says(tmp_path):
    packet = packet_of(KNOT, tmp_path, layers="all")
    header = packet.header
    for each in header["objects"]:
        indices = np.frombuffer(packet.indices(each["indices"]), np.uint32)
        position, normal = (each["attributes"][f"shadelab_{name}"] for name in ("position", "normal"))
        assert len(indices) % 3 == 0 and indices.max() < position["count"] == normal["count"]
        normals = np.frombuffer(packet.attribute(normal), np.float32).reshape(-1, normal["components"])
        np.testing.assert_allclose(np.linalg.norm(normals, axis=1), 1, atol=1e-6)
    last = header["objects"][-1]["indices"]
    assert last["offset"] + 4 * last["count"] == len(packet.data)
    assert [layer["layer"] for layer in header["film"]] == list(CHANNELS)
    at = 0
    for layer in header["film"]:
        assert CHANNELS[layer["layer"]] == slice(at, at := at + layer["channels"])
    student = [piece for p in header["programs"] for stage in p.values() for piece in stage if "student" in piece]
    assert student and all(piece == {"student": True, "line": 1} for piece in student)
    assert "vec3 mirror_direction(vec3 l, vec3 n) {" not in json.dumps(header)  # nothing of the solution's is in it


def test_the_cameras_numbers_move_the_picture(tmp_path):
    """Who moves the camera computes shadelab_to_clip anew, from numbers in double; where it stands already, the same comes
    out."""
    packet = packet_of(SPOTS, tmp_path)
    camera = packet.header["camera"]
    view = np.array(camera["world_to_clip"]).reshape(4, 4).T
    described = renderer.describe(SPOTS, PHONG, renderer.View(size=TINY))
    np.testing.assert_array_equal(view, described.world_to_clip)
    np.testing.assert_array_equal(np.float32(camera["eye"]), np.float32(packet.header["uniforms"]["shadelab_eye"]))
    for each, told in zip(packet.header["objects"], described.objects):
        to_world = np.array(each["to_world"]).reshape(4, 4).T
        np.testing.assert_array_equal(to_world, told.to_world)
        to_clip = np.array(each["uniforms"]["shadelab_to_clip"]).reshape(4, 4).T
        np.testing.assert_allclose(np.float32(view @ to_world), to_clip, rtol=2e-7, atol=1e-7)


def test_lights_come_one_by_one_or_from_a_texture(tmp_path):
    few, many = packet_of(SPOTS, tmp_path).header, packet_of(grid_scene(tmp_path), tmp_path).header
    assert "shadelab_light1_hotspot" in few["uniforms"] and not few["textures"]
    [texture] = many["textures"]
    assert texture["name"] == "shadelab_lights" and texture["width"] % 4 == 0
    ends = [many["uniforms"][f"shadelab_light_end_{kind}"][0] for kind in ("point", "directional", "spot")]
    lights = renderer.describe(grid_scene(tmp_path), PHONG).lights
    assert ends == [float((lights[:, 0] <= kind).sum()) for kind in range(3)]
    assert not any("light0" in name for name in many["uniforms"])


def test_depth_alone_has_no_target_and_no_normal(tmp_path):
    header = packet_of(SPOTS, tmp_path, layers="depth", samples=4).header
    [one] = header["passes"]
    assert one["targets"] == [] and one["samples"] == 4 and len(one["draws"]) == len(header["objects"])
    [layer] = header["film"]
    assert (layer["layer"], layer["target"], layer["reduce"]) == ("depth", -1, "centre")
    assert all(list(each["attributes"]) == ["shadelab_position"] for each in header["objects"])
    assert not any("student" in piece for p in header["programs"] for stage in p.values() for piece in stage)


def test_equal_objects_share_a_program_and_keep_their_uniforms(tmp_path):
    """A client that stands by sets uniforms when another object used the program before, in the second frame too."""
    text = (ROOT / "scenes/phong/sphere.toml").read_text().replace("../meshes", str(ROOT / "scenes" / "meshes"))
    text = text[: text.index("[[object]]")]
    for x in (-0.8, 0.8):
        mesh = ROOT / "scenes" / "meshes" / "sphere-coarse.obj"
        name = text.split("[material.")[1].split("]")[0]
        text += f'[[object]]\nmesh = "{mesh}"\nmaterial = "{name}"\nscale = 0.5\ntranslate = [{x}, 0, 0]\n'
    (tmp_path / "two.toml").write_text(text)
    packet = packet_of(tmp_path / "two.toml", tmp_path)
    assert len(packet.header["programs"]) == 1 and len(packet.header["objects"]) == 2
    with peer(tmp_path / "frame.packet") as program:
        program.draw()
        program.draw()
        image = program.image(tmp_path / "image.npy")
    np.testing.assert_array_equal(image, Client(student=STUDENT).draw(packet)[0])
    covered = image.max(axis=2) > 0
    half = image.shape[1] // 2
    assert covered[:, :half].sum() > 100 and covered[:, half:].sum() > 100


def test_a_client_draws_packets_in_any_order(tmp_path):
    """Packets share programs and each sets its own uniforms."""
    packets = [packet_of(scene, tmp_path) for scene in (SPOTS, KNOT)]
    client = Client(student=STUDENT)
    first, other, again = (client.draw(packets[k])[0] for k in (0, 1, 0))
    np.testing.assert_array_equal(first, again)
    assert np.abs(first - other).max() > 0.01


# --------------------------------------------------------------------------------------- the client that stands by


def peer(packet: Path):
    command = [sys.executable, "-I", "-m", "shadelab.measure.peer", str(packet), str(PHONG / "shading.glsl")]
    return resident("peer", command, {**os.environ, "SHADELAB_ROOT": str(ROOT)})


@pytest.mark.parametrize("view", [{}, {"layers": "all", "samples": 4}], ids=["total", "layers"])
def test_the_peer_draws_what_the_client_draws(tmp_path, view):
    packet = packet_of(KNOT, tmp_path, **view)
    with peer(tmp_path / "frame.packet") as program:
        assert program.draw() > 0
        once = program.image(tmp_path / "image.npy")
        program.draw()
        np.testing.assert_array_equal(program.image(tmp_path / "image.npy"), once)
        with pytest.raises(InfrastructureError, match="no such request"):
            program.ask("dance")
        assert program.draw() > 0  # a mistake ends nothing
    np.testing.assert_array_equal(once, Client(student=STUDENT).draw(packet)[0])
    assert once.shape == (80, 96, 21 if view else 3) and once.dtype == np.float32


@pytest.mark.parametrize("samples", [1, 4])
def test_the_peer_draws_depth(tmp_path, samples):
    layers, _ = Client(student=STUDENT).draw(packet_of(KNOT, tmp_path, layers="all"))  # one sample, at the centre
    packet = packet_of(KNOT, tmp_path, layers="depth", samples=samples)
    with peer(tmp_path / "frame.packet") as program:
        program.draw()
        once = program.image(tmp_path / "depth.npy")
        program.draw()
        np.testing.assert_array_equal(once, program.image(tmp_path / "depth.npy"))
    depth = layers[..., CHANNELS["depth"]]
    assert once.shape == depth.shape == (80, 96, 1)
    if samples == 1:
        np.testing.assert_allclose(once, depth, atol=2e-6)
        # The peer's depths are float32 and the client's have 24 bits.
        np.testing.assert_allclose(Client().draw(packet)[0], once, atol=2**-24)
        return
    with pytest.raises(UserError, match="4 samples: this client reads the depth of one sample a pixel alone"):
        Client().draw(packet)
    # The first of four samples stands beside the centre: depths are near, outlines move by less than a pixel.
    both = (once < 1) & (depth < 1)
    assert both.mean() > 0.1 and ((once < 1) != (depth < 1)).mean() < 0.1
    assert np.median(np.abs(once - depth)[both]) < 1e-2


def test_another_version_is_refused(tmp_path):
    packet_of(SPOTS, tmp_path)
    data = (tmp_path / "frame.packet").read_bytes()
    (tmp_path / "frame.packet").write_bytes(data.replace(b"packet 2", b"packet 1", 1))
    with pytest.raises(UserError, match="not a frame packet of this version"):
        Packet(tmp_path / "frame.packet")
