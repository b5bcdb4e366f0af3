"""The benchmark: the OpenGL peer's protocol, and the arithmetic and reports. No test asserts a time."""

import json
import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
import tomli_w
from rich.console import Console

from conftest import ROOT
from shadelab.course.toml_files import read_toml
from shadelab.errors import InfrastructureError, UserError
from shadelab.gl.client import Client
from shadelab.gl.packet import Packet
from shadelab.machine.sandbox import work_folder
from shadelab.measure import bars, bench, bench_report, timing, visibility
from shadelab.measure.declaration import load_declaration, mesh_file
from shadelab.measure.images import image_error
from shadelab.measure.machine import describe_machine
from shadelab.measure.standing import Stand, resident
from shadelab.paths import RENDER
from shadelab.truth.expected import CHANNELS

PHONG = ROOT / "solution" / "phong"
TINY = 96  # pixels
DECLARED = load_declaration()


def frame(mesh: str, look: str, samples: int, full: bool = False) -> bench.BenchFrame:
    return bench.BenchFrame(mesh, DECLARED.look_named(look), samples, full)


# ------------------------------------------------------------------------------------------------- the OpenGL peer


def make_packet(folder: Path, *options: str, samples: int = 1, lights: int = 2) -> Path:
    scene, packet = folder / "scene.toml", folder / "frame.packet"
    DECLARED.write_scene("phong-4.toml" if lights > 1 else "phong-1.toml", "knot", scene)
    command = [RENDER, "packet", scene, "--assignment", PHONG, "--size", f"{TINY}x{TINY}"]
    command += ["--samples", str(samples), *options, "-o", packet]
    subprocess.run(list(map(str, command)), check=True)
    return packet


def peer(packet: Path):
    command = [sys.executable, "-I", "-m", "shadelab.measure.peer", str(packet), str(PHONG / "shading.glsl")]
    return resident("peer", command, dict(os.environ))


def drawn_by_the_client(packet: Path) -> np.ndarray:
    """What the grader's draw job writes, from a process of its own."""
    read = Packet(packet)
    folder = packet.parent
    (folder / "prelude.glsl").write_text(read.header["sources"]["prelude"])
    jobs = {
        "student": str(PHONG / "shading.glsl"), "prelude": str(folder / "prelude.glsl"),
        "status": str(folder / "status.jsonl"),
        "jobs": [{"kind": "draw", "packet": str(packet), "output": str(folder / "client.npy")}],
    }  # fmt: skip
    (folder / "jobs.json").write_text(json.dumps(jobs))
    command = [sys.executable, "-I", "-m", "shadelab.gl.client", str(folder / "jobs.json")]
    subprocess.run(command, check=True, env=os.environ)
    return np.load(folder / "client.npy")


@pytest.mark.parametrize("samples", [1, 4])
@pytest.mark.parametrize("options", [[], ["--layers"]], ids=["total", "layers"])
def test_peer_draws_what_the_grader_draws(tmp_path, options, samples):
    packet = make_packet(tmp_path, *options, samples=samples)
    with peer(packet) as program:
        assert "llvmpipe" in program.ready["gl"]
        assert program.draw() > 0
        once = program.image(tmp_path / "once.npy")
        assert program.draw() > 0
        twice = program.image(tmp_path / "twice.npy")
        with pytest.raises(InfrastructureError, match="no such request"):
            program.ask("dance")
        assert program.draw() > 0  # a mistake ends nothing
    np.testing.assert_array_equal(once, twice)
    np.testing.assert_array_equal(once, drawn_by_the_client(packet))
    assert once.shape == (TINY, TINY, 21 if options else 3) and once.dtype == np.float32
    assert (once[..., :3].max(axis=2) > 0.1).mean() > 0.1  # something is in the picture


@pytest.mark.parametrize("samples", [1, 4])
def test_peer_draws_depth(tmp_path, samples):
    layers = drawn_by_the_client(make_packet(tmp_path, "--layers"))  # one sample, at the centre
    packet = make_packet(tmp_path, "--depth", samples=samples)
    with peer(packet) as program:
        program.draw()
        once = program.image(tmp_path / "depth.npy")
        program.draw()
        np.testing.assert_array_equal(once, program.image(tmp_path / "depth.npy"))
    depth = layers[..., CHANNELS["depth"]]
    assert once.shape == depth.shape == (TINY, TINY, 1)
    if samples == 1:
        np.testing.assert_allclose(once, depth, atol=2e-6)
        return
    # The first of four samples stands beside the centre: depths are near, outlines move by less than a pixel.
    both = (once < 1) & (depth < 1)
    assert both.mean() > 0.1 and ((once < 1) != (depth < 1)).mean() < 0.1
    assert np.median(np.abs(once - depth)[both]) < 1e-2


def test_two_objects_of_one_program_keep_their_uniforms(tmp_path):
    """A resident frame sets uniforms when another object used the program before, in the second frame too."""
    file = tmp_path / "scene.toml"
    DECLARED.write_scene("phong-1.toml", "sphere-coarse", file)
    scene = read_toml(file)
    scene["object"] = [{**scene["object"][0], "translate": [x, 0, 0], "scale": 0.5} for x in (-0.6, 0.6)]
    file.write_text(tomli_w.dumps(scene))
    packet = tmp_path / "frame.packet"
    command = [RENDER, "packet", file, "--assignment", PHONG, "--size", f"{TINY}x{TINY}", "-o", packet]
    subprocess.run(list(map(str, command)), check=True)
    assert len(Packet(packet).header["programs"]) == 1
    with peer(packet) as program:
        program.draw()
        program.draw()
        image = program.image(tmp_path / "image.npy")
    np.testing.assert_array_equal(image, drawn_by_the_client(packet))
    covered = image.max(axis=2) > 0
    assert covered[:, : TINY // 2].sum() > 300 and covered[:, TINY // 2 :].sum() > 300


def test_client_draws_packets_in_any_order(tmp_path):
    """Packets share programs and each sets its own uniforms."""
    packets = []
    for lights in (1, 2):
        (tmp_path / str(lights)).mkdir()
        packets.append(Packet(make_packet(tmp_path / str(lights), lights=lights)))
    client = Client(packets[0].header["sources"]["prelude"], (PHONG / "shading.glsl").read_text())
    first, other, again = (client.draw(packets[k])[0] for k in (0, 1, 0))
    np.testing.assert_array_equal(first, again)
    assert np.abs(first - other).max() > 0.01


def test_program_that_ends_says_why():
    command = [sys.executable, "-c", "import sys; sys.exit('the disk is full')"]
    with pytest.raises(InfrastructureError, match="name: the disk is full"), resident("name", command, {}):
        pass


# ------------------------------------------------------------------------------------------------------- the cases


def test_cases_are_those_of_the_issue():
    cases = bench.all_frames(DECLARED)
    assert len(cases) == len({c.name for c in cases}) == 70
    assert {c.look.name for c in cases} == {"depth", "phong-1", "phong-4", "cook-torrance-1", "cook-torrance-4"}
    assert {m.name for m in bench.all_measurements(DECLARED)} >= {c.name for c in cases} | set(DECLARED.quick)
    chosen = bench.chosen_measurements(DECLARED, "teapot/depth/*", False)
    assert [m.name for m in chosen] == ["teapot/depth/1s", "teapot/depth/4s"]
    with pytest.raises(UserError, match="names look like"):
        bench.chosen_measurements(DECLARED, "nothing", False)


@pytest.mark.parametrize("mesh", ["sphere-70k", "knot-70k", "teapot", "bunny"])
def test_meshes_fill_the_picture_and_none_is_cut(tmp_path, mesh):
    """Measured in the packet's own numbers: every vertex within the picture, the largest extent over most of it."""
    if not mesh_file(mesh).exists():
        pytest.skip(f"{mesh}.obj is absent")
    DECLARED.write_scene("cook-torrance-4.toml", mesh, tmp_path / "scene.toml")
    command = [RENDER, "packet", tmp_path / "scene.toml", "--assignment", ROOT / "solution" / "microfacet"]
    subprocess.run([*map(str, command), "-o", str(tmp_path / "frame.packet")], check=True)
    packet = Packet(tmp_path / "frame.packet")
    [drawn] = packet.header["objects"]
    positions = np.frombuffer(packet.attribute(drawn["attributes"]["shadelab_position"]), np.float32).reshape(-1, 3)
    to_clip = visibility.matrices(packet)[0]
    clip = np.c_[positions, np.ones(len(positions))] @ to_clip.T
    projected = clip[:, :2] / clip[:, 3:]
    assert np.abs(projected).max() < 1
    assert np.ptp(projected, axis=0).max() > 1.5


# -------------------------------------------------------------------------------------------- arithmetic, reports


def test_pairs_alternate_and_change_who_begins():
    order = []

    def draw(who, ms):
        order.append(who)
        return ms

    pairs = timing.alternate(lambda: draw("ours", 1.0), lambda: draw("peer", 4.0), least=4, seconds=0, pause=0)
    assert pairs == [(1.0, 4.0)] * 4
    assert order == ["ours", "peer", "peer", "ours"] * 2
    enough = timing.alternate(lambda: 1.0, lambda: 1.0, least=2, seconds=1e9, pause=0)
    assert len(enough) == timing.MORE_PAIRS


def test_ratios_are_taken_pair_by_pair():
    # The machine was slow in the second half, for both: the medians' ratio would be 10/2.
    assert timing.pairwise_ratio([(1, 2), (1, 2), (10, 20)]) == 0.5
    assert timing.pairwise_ratio([(1, 10), (2, 10), (9, 10)]) == 0.2
    assert timing.geometric_mean([0.1, 10]) == pytest.approx(1)
    assert timing.geometric_mean([0.25, 0.25, 2]) == pytest.approx(0.5)


def test_image_error():
    reference = np.zeros((2, 2, 3))
    image = reference.astype(np.float32)
    image[0, 0, 1] = 0.5
    assert image_error(image, reference) == {"rmse": pytest.approx(0.5 / 12**0.5), "max": 0.5}
    assert image_error(np.ones((2, 2, 1)), np.zeros((2, 2, 1))) == {"rmse": 1.0, "max": 1.0}


def fake_case(case: bench.BenchFrame, ours: float, peer: float) -> dict:
    return {
        "name": case.name, "unit": "ms", "mesh": case.mesh, "shading": case.look.name, "samples": case.samples,
        "ours": {"median": ours, "error": 1e-6}, "peer": {"name": "llvmpipe (fake)", "median": peer, "error": 2e-6},
        "ratio": ours / peer, "load_ms": 1.0, "geometry_bytes": 1 << 20, "framebuffer_bytes": 1 << 21, "peak_bytes": 1 << 22,
    }  # fmt: skip


def fake_bench(level: str = "v3") -> dict:
    results = [fake_case(case, 12.0 if case.look.shaded else 2.0, 40.0) for case in bench.all_frames(DECLARED)]
    results += [fake_case(frame("knot-70k", "phong-1", 1, full=True), 40.0, 80.0)]
    results += [{"name": "threads/x", "frame_gain": 1.9, "arithmetic_gain": 2.0, "share": 0.95}]
    point = {"series": "ours-float", "supersample": 2, "samples": 4, "error": 1e-3, "max_error": 1e-2}
    point["ms"] = timing.spread([2.0, 1.0, 3.0])
    results += [{"name": "supersampling/sphere", "mesh": "sphere-70k", "q": 32.0, "size": 256, "points": [point]}]
    results += [{"name": "load/knot-1m", "unit": "ms", **timing.spread([900.0, 1000.0, 1700.0])}]
    machine = {"cpu": "A Processor", "processors": 2, "system": "A System", "compiler": "g++ 1", "date": "2000-01-01"}
    settings = {"threads": 2, "level": level, "pairs": 15, "size": DECLARED.size}
    return bars.assemble(DECLARED, machine, settings, results, [{"name": "bunny/x", "why": "absent"}])


def test_json_has_the_agreed_shape():
    numbers = json.loads(json.dumps(fake_bench(), allow_nan=False))
    assert numbers["machine"]["cpu"] == "A Processor" and numbers["machine"]["peer"] == ["llvmpipe (fake)"]
    assert len(numbers["cases"]) == 70
    for case in numbers["cases"]:
        assert isinstance(case["name"], str) and case["unit"] == "ms"
        assert case["peer"]["name"].startswith("llvmpipe")
        assert all(isinstance(case[who][what], float) for who in ("ours", "peer") for what in ("median", "error"))
        assert case["ratio"] == case["ours"]["median"] / case["peer"]["median"]
    assert [len(numbers[name]) for name in ("full", "threads", "supersampling", "load", "skipped")] == [1] * 5
    assert {m["name"].split("/")[0] for m in numbers["memory"]} == {"sphere-1m", "knot-1m"}


def test_bars():
    limits = {b["name"]: b for b in fake_bench()["bars"]}
    assert [b["met"] for b in limits.values()].count(False) == 1
    assert limits["geometric mean of ours/llvmpipe"]["value"] == pytest.approx((0.05 * 0.3**4) ** 0.2)
    assert limits["the same, depth only"]["value"] == pytest.approx(0.05)
    missed = limits["--full: the largest ours/llvmpipe, all layers"]
    assert not missed["met"] and missed["value"] == 0.5 and missed["limit"] == 0.45
    assert limits["two threads over one, of arithmetic's gain"]["sense"] == "at least"
    assert limits["the largest image error, ours/llvmpipe"]["value"] == pytest.approx(0.5)


def test_bars_without_avx2():
    limits = {b["name"]: b["limit"] for b in fake_bench("v2")["bars"]}
    assert limits["geometric mean of ours/llvmpipe"] == 0.75
    assert "the same, depth only" not in limits
    assert (
        bars.held_against_bars(DECLARED, [], {"full": [], "threads": [], "load": [], "omissions": []}, "v3", []) == []
    )


def test_below_avx2_the_peer_is_held_to_sse(tmp_path):
    held = [Stand(tmp_path, 2, level).environment() for level in (None, "v2", "v3")]
    assert ["GALLIUM_OVERRIDE_CPU_CAPS" in e for e in held] == [False, True, False]
    assert [e.get("SHADELAB_LEVEL") for e in held] == [os.environ.get("SHADELAB_LEVEL"), "v2", "v3"]
    assert all(e["OMP_NUM_THREADS"] == e["LP_NUM_THREADS"] == "2" for e in held)


def test_readme_block(tmp_path):
    text = "# A\n<!-- bench -->\nold\nlines\n<!-- /bench -->\nend\n"
    assert bench_report.replace_block(text, "new") == "# A\n<!-- bench -->\nnew\n<!-- /bench -->\nend\n"
    assert bench_report.replace_block(bench_report.replace_block(text, "x"), "new") == bench_report.replace_block(
        text, "new"
    )
    for wrong in ("", "<!-- bench -->", "<!-- /bench --><!-- bench -->"):
        with pytest.raises(UserError, match="README.md"):
            bench_report.replace_block(wrong, "new")


def test_readme_table():
    text = bench_report.markdown(DECLARED, fake_bench())
    rows = [line for line in text.splitlines() if line.startswith("| `")]
    assert len(rows) == 14 and all(row.count("|") == 7 for row in rows)
    assert rows[0].startswith("| `sphere-1k`, 1 sample | 2.00 / 40.0 | 12.0 / 40.0 |")
    assert (
        "no worse in 70 of 70 cases" in text
        and "A Processor" in text
        and "./shadelab bench --level v3 --readme" in text
    )
    assert "| loading a million triangles, ms | 1e+03 | ≤ 1500 | met |" in text


def test_report_on_the_terminal(capsys):
    bench_report.print_report(fake_bench(), Console(width=200, highlight=False))
    printed = capsys.readouterr().out
    assert "sphere-1k/depth/1s" in printed and "skipped bunny/x: absent" in printed
    assert "missed --full: the largest ours/llvmpipe, all layers: 0.5 (at most 0.45)" in printed


def test_interrupted_runs_go_on(tmp_path):
    file, key = tmp_path / "bench" / "run.json", {"cpu": "a", "threads": 2}
    assert bench.kept_results(file, key) == {}
    bench.keep_results(file, key, {"x": {"name": "x"}})
    assert bench.kept_results(file, key) == {"x": {"name": "x"}}
    assert bench.kept_results(file, {**key, "threads": 1}) == {}  # other settings, another run
    file.write_text("{")
    assert bench.kept_results(file, key) == {}


def test_machine_is_described():
    described = describe_machine()
    assert all(described[name] for name in ("cpu", "system", "compiler"))
    assert described["processors"] >= 1


def test_bad_options(shadelab):
    done = shadelab("bench", "--readme", "--quick")
    assert done.code == 2 and "--readme" in done.stderr
    done = shadelab("bench", "--only", "nothing")
    assert done.code == 2 and "names look like" in done.stderr and done.stderr.count("\n") == 1
    assert shadelab("bench", "--pairs", "3").code == 2  # a median of fewer than 15 is none


@pytest.mark.skipif("frames" not in subprocess.run([RENDER, "--help"], capture_output=True, text=True).stdout,
                    reason="this renderer has no frames command")  # fmt: skip
@pytest.mark.parametrize("shading", ["depth", "phong-1"])
def test_a_case_from_end_to_end(monkeypatch, shading):
    monkeypatch.setattr(timing, "MORE_PAIRS", 2)
    with work_folder("bench") as folder:
        measured = bench.Bench(DECLARED, Stand(folder, 1), 2, TINY)
        result = bench.measure_frame(measured, frame("knot", shading, 4))
    assert result["ours"]["runs"] == result["peer"]["runs"] == 2 and result["ratio"] > 0
    assert result["ours"]["error"] < 1e-2 and result["peer"]["error"] < 1e-2
