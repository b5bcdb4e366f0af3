"""The reports: whole, harmless whatever a student's code prints, and small."""

from __future__ import annotations

import base64
import hashlib
import io
import re
import zlib
from html.parser import HTMLParser
from pathlib import Path

import numpy as np
import pytest
from markupsafe import Markup
from PIL import Image
from rich.cells import cell_len
from rich.console import Console

from shadelab.grading.pictures import Pictures
from shadelab.report import wording
from shadelab.report.formats.markdown import summary
from shadelab.report.html import encoding, illustrations
from shadelab.report.html.page import PRINTED, write_html
from shadelab.report.html.pictures import (
    MAGENTA,
    PALETTE,
    PICTURE,
    RAMP,
    THUMBNAIL,
    Figure,
    difference,
    excess,
    figures_of,
    picture_uri,
    srgb,
    thumbnail,
)
from shadelab.report.terminal import print_result
from shadelab.result import Check, Error, Mistake, Render, Result, Worst
from shadelab.truth.expected import EDGE, INTERIOR, SceneFacts, SceneTruth
from shadelab.words import plain

HOSTILE = "<script>alert(1)</script>\"'><img src=x onerror=y> {{ 7 * 7 }} [red]no[/red] \x1b[2J\x1b]0;title\x07 \x00 \x9b31m \u202egnp.exe"
SIDE = 300
VOID = {"meta", "img", "br", "link", "input"}


def check(name: str, status: str, score: float, most: float, **rest: object) -> Check:
    backend, kind, *_ = name.split("/")
    return Check(id=name, kind=kind, backend=backend, status=status, score=score, max_score=most, **rest)


@pytest.fixture
def result() -> Result:
    out = Result(assignment="phong", submission="sha256:" + HOSTILE, max_score=60, complete=True)
    worst = Worst(
        inputs={"n": [0.0, 0.0, 1.0], "m.q": 1e300, "odd": [None, float(2**60), HOSTILE], "m": {"kd": [0.1, 0.2, 0.3]}},
        expected=[0.123456789, 0.5, -1e300],
        actual=[0.123456789, None, 1e300],
        replay="./shadelab eval submission half_vector --inputs 'replay/half vector.npz' --backend cpp --out "
        + "long/" * 11
        + "result.npz",
    )
    terms = Worst(
        inputs={"l": [1.0, 0.0, 0.0]},
        expected=[k / 10 for k in range(9)],
        actual=[k / 10 for k in range(8)] + [8.0],
        replay="./shadelab eval TERMS",
    )
    add = out.add
    add(check("cpp/build", "passed", 0, 0))
    add(check("cpp/function/half_vector", "failed", 0, 6, message=HOSTILE + "\nsecond line\n", printed=HOSTILE * 100, worst=worst,
              error=Error(name="scaled", value=None, limit=1e-3, floor=1.6e-4), mistake=Mistake(id="x", hint="normalise " + HOSTILE, margin=3)))  # fmt: skip
    add(check("cpp/function/phong", "passed", 10, 10, error=Error(name="scaled", value=1.23e-5, limit=1e-3)))
    add(check("cpp/image/teapot", "failed", 2, 8, message="a pixel is off", worst=Worst(inputs={"pixel": [3, 4]}, expected=[0.1, 0.2, 0.3],
              actual=[None, 0.2, 0.3], replay="./shadelab probe scenes/phong/teapot.toml 3,4")))  # fmt: skip
    add(check("cpp/image/knot", "passed", 8, 8))
    add(check("cpp/image/crash", "failed", 0, 8, message="the program crashed"))
    add(check("cpp/stability/phong", "error", 0, 4, message="no space left on device"))
    add(check("glsl/build", "failed", 0, 0, message="shading.glsl:3: error: syntax error\n  vec3 a = ;\n           ^"))
    add(check("glsl/function/half_vector", "skipped", 0, 6, needs=["glsl/build"]))
    add(check("glsl/function/phong", "failed", 0, 10, message="wrong", worst=terms))
    out.environment = {"gl": "llvmpipe", "cpu": HOSTILE}
    return out


def truth_of(total: np.ndarray, mask: np.ndarray | None = None, **layers: np.ndarray) -> SceneTruth:
    """One object in a plane; its light is all ambient."""
    height, width = total.shape[:2]
    y, x = np.mgrid[0:height, 0:width].astype(np.float32)
    flat = {
        "total": total,
        "ambient": total,
        "diffuse": np.zeros_like(total),
        "specular": np.zeros_like(total),
        "id": np.ones((height, width, 1), np.float32),
        "depth": np.full((height, width, 1), 0.5, np.float32),
        "normal": np.tile(np.array([0, 0, 1], np.float32), (height, width, 1)),
        "position": np.stack([x / width, -y / height, 0 * x], axis=2),
    }
    lights = [
        {
            "kind": 0,
            "name": "point",
            "placed": True,
            "position": [0.5, 0.5, 2.0],
            "direction": [0.0, -1.0, 0.0],
            "intensity": [1.0, 1.0, 1.0],
        },
        {
            "kind": 1,
            "name": "directional",
            "placed": False,
            "position": [0.0, 0.0, 0.0],
            "direction": [0.6, 0.0, -0.8],
            "intensity": [1.0, 1.0, 1.0],
        },
    ]
    facts = SceneFacts(eye=[0.0, 0.0, 3.0], scale=1.0, lights=lights)
    mask = np.full((height, width), INTERIOR, np.uint8) if mask is None else mask
    return SceneTruth(flat | layers, mask, facts, np.zeros((height, width), np.float32))


def drawn(total: np.ndarray) -> np.ndarray:
    """A submission's layers: all of it ambient."""
    return np.concatenate([total, total, np.zeros((*total.shape[:2], 7), np.float32)], axis=2)


def kept(folder: Path, layers: np.ndarray | None, truth: SceneTruth) -> Pictures:
    """As a grade leaves them in out/evidence."""
    name = f"picture-{len(list(folder.iterdir()))}"
    pictures = Pictures(folder / f"{name}.npy", folder / f"{name}.npz")
    if layers is not None:
        np.save(pictures.drawn, layers)
    truth.save(pictures.truth_file)
    return pictures


@pytest.fixture
def pictures(tmp_path: Path) -> dict[str, Pictures]:
    rng = np.random.default_rng(1)
    expected = rng.random((SIDE, SIDE, 3), np.float32)
    mask = np.full((SIDE, SIDE), INTERIOR, np.uint8)
    mask[:, 200:210] = EDGE
    student = expected.copy()
    student[50:60] += 0.1
    student[3, 4] = np.nan
    student[5, 6, 1] = np.inf
    ramp = np.repeat(np.linspace(0, 1, SIDE, dtype=np.float32), SIDE * 3).reshape(SIDE, SIDE, 3)
    return {
        "cpp/image/teapot": kept(tmp_path, drawn(student), truth_of(expected, mask)),
        "cpp/image/knot": kept(tmp_path, drawn(ramp), truth_of(expected)),
        "cpp/image/crash": kept(tmp_path, None, truth_of(expected)),
    }


class Page(HTMLParser):
    """The elements with their attributes, the text, and whether the tags nest."""

    def __init__(self, source: str) -> None:
        super().__init__()
        self.elements: list[tuple[str, dict[str, str]]] = []
        self.text, self.open = "", []
        self.feed(source)

    def handle_starttag(self, tag: str, attrs: list) -> None:
        self.elements.append((tag, {k: v or "" for k, v in attrs}))
        if tag not in VOID:
            self.open.append(tag)

    def handle_endtag(self, tag: str) -> None:
        assert self.open.pop() == tag

    def handle_data(self, data: str) -> None:
        self.text += data

    def all(self, tag: str) -> list[dict[str, str]]:
        return [attrs for name, attrs in self.elements if name == tag]


@pytest.fixture
def file(result: Result, pictures: dict[str, Pictures], tmp_path: Path) -> Path:
    out = tmp_path / "report.html"
    write_html(result, pictures, out, "The Phong model " + HOSTILE)
    return out


@pytest.fixture
def page(file: Path) -> Page:
    return Page(file.read_text(encoding="utf-8"))


# --- HTML ---


def test_it_needs_nothing_else(file: Path, page: Page) -> None:
    assert not re.search(r"https?:|url\(|@import", file.read_text(encoding="utf-8"))
    assert not {"link", "iframe", "object"} & {tag for tag, _ in page.elements}
    for script in page.all("script"):
        assert set(script) <= {"type", "id"}
    for _, attributes in page.elements:
        assert attributes.get("src", "data:").startswith("data:")
        assert attributes.get("href", "#").startswith("#")
        assert not any(name.startswith("on") for name in attributes)


def test_only_our_script_may_run(page: Page) -> None:
    scripts = [attributes.get("type", "") for attributes in page.all("script")]
    assert scripts.count("") == 1 and set(scripts) <= {"", "text/plain", "application/json"}
    policy = next(m["content"] for m in page.all("meta") if m.get("http-equiv") == "Content-Security-Policy")
    source = (Path(illustrations.__file__).parent / "report.js").read_text(encoding="utf-8")
    digest = base64.b64encode(hashlib.sha256(source.encode()).digest()).decode()
    assert f"script-src 'sha256-{digest}'" in policy and "</script" not in source and "<!--" not in source


def test_hostile_text_stays_text(file: Path, page: Page) -> None:
    assert page.open == []
    source = file.read_text(encoding="utf-8")
    assert "<script>alert" not in source and "<img src=x" not in source
    assert "<script>alert(1)</script>" in page.text and "{{ 7 * 7 }}" in page.text
    assert "␛[2J" in page.text
    assert not re.search(r"[\x00-\x08\x0b-\x1f\x7f-\x9f\u202e]", source)


def test_every_link_has_a_target_and_ids_are_unique(page: Page) -> None:
    ids = [attributes["id"] for _, attributes in page.elements if "id" in attributes]
    assert len(ids) == len(set(ids))
    for link in page.all("a"):
        assert link["href"][1:] in ids


def test_every_failed_check_has_its_message_and_replay(result: Result, page: Page) -> None:
    for one in result.checks:
        if one.status in ("failed", "error"):
            assert plain(one.id) in page.text
            assert plain(one.message).strip() in page.text
            assert one.worst is None or plain(one.worst.replay) in page.text


def test_what_it_says(page: Page) -> None:
    text = " ".join(page.text.split())
    assert "Make shading.glsl compile first; 1 other check waits for it." in text
    assert "Waits for glsl/build" in text
    assert "grader’s fault, not yours" in text
    assert "20 of 60 points" in text
    assert "normalise" in text and "llvmpipe" in text
    assert f"{len(HOSTILE) * 100 - PRINTED} more characters" in text
    assert "0.123457" in text and "1e+300" in text and "not finite" in text


def test_pictures_have_the_right_size_and_an_alt_text(page: Page) -> None:
    sizes = []
    for image in page.all("img"):
        kind, data = re.fullmatch(r"data:image/(webp);base64,(.*)", image["src"]).groups()
        with Image.open(io.BytesIO(base64.b64decode(data))) as decoded:
            assert decoded.format == kind.upper()
            size = (int(image["width"]), int(image["height"]))
            assert decoded.size == size or decoded.size[0] < size[0]
            sizes.append(size)
        assert image["alt"]
    assert sorted(sizes) == [(THUMBNAIL, THUMBNAIL)] + 4 * [(SIDE, SIDE)]


def test_noise_loses_detail_and_nothing_else_does() -> None:
    noise = np.random.default_rng(1).integers(0, 255, (600, 600, 3)).astype(np.uint8)
    uri, exact = picture_uri(noise)
    assert uri.startswith("data:image/webp") and len(uri) <= 4 / 3 * PICTURE + 99 and not exact
    assert picture_uri(np.zeros_like(noise))[1]


def test_a_thousand_passed_checks_stay_small(tmp_path: Path) -> None:
    out = Result(assignment="phong", submission="sha256:0", max_score=1000, complete=True)
    for k in range(1000):
        out.add(check(f"cpp/function/f{k}", "passed", 1, 1))
    write_html(out, {}, tmp_path / "report.html", "Many")
    assert (tmp_path / "report.html").stat().st_size < 1_000_000
    assert "every check passes" in (tmp_path / "report.html").read_text(encoding="utf-8")


def test_an_empty_result_is_a_report(tmp_path: Path) -> None:
    write_html(Result(assignment="phong", submission=""), {}, tmp_path / "report.html", "Nothing yet")
    assert "cut off" in (tmp_path / "report.html").read_text(encoding="utf-8")


# --- Pictures ---


def test_srgb() -> None:
    linear = np.array([[[0.0, 0.0031308, 0.18], [1.0, 2.0, -1.0], [np.nan, 0, 0]]])
    assert srgb(linear).tolist() == [[[0, 10, 118], [255, 255, 0], [255, 0, 255]]]


def test_the_difference_picture() -> None:
    expected = np.full((1, 7, 3), 0.5, np.float32)
    delta = np.array([0, 0.5, 4, 64, 1000, 0.5, np.nan], np.float32)
    limit = np.full((1, 7, 3), 1 / 1024, np.float32)
    student = expected.copy()
    student[0, :, 1] += delta / 1024
    edge = np.array([[False] * 5 + [True, False]])
    picture = PALETTE[difference(excess(student, expected, limit), edge, ~np.isfinite(student).all(2))[0]]
    colors = [tuple(int(c[k : k + 2], 16) for k in (1, 3, 5)) for c in RAMP]
    assert picture[0].tolist() == picture[1].tolist() == [0, 0, 0]
    assert [tuple(p) for p in picture[2:5]] == [colors[2], colors[6], colors[6]]
    assert len(set(picture[5].tolist())) == 1 and 0 < picture[5, 0] < 128
    assert tuple(picture[6]) == MAGENTA


def test_a_limit_of_zero_divides_nothing() -> None:
    student, expected = np.array([[[0.5, 0, 0]]], np.float32), np.array([[[0.5, 0, 1e-9]]], np.float32)
    assert excess(student, student, np.zeros_like(student)).item() == 0
    assert excess(student, expected, np.zeros_like(student)).item() > 1e20


def test_the_ramp_grows_lighter_step_by_step() -> None:
    def luminance(color: str) -> float:
        c = np.array([int(color[k : k + 2], 16) for k in (1, 3, 5)]) / 255
        return float(np.where(c <= 0.04045, c / 12.92, ((c + 0.055) / 1.055) ** 2.4) @ [0.2126, 0.7152, 0.0722])

    steps = np.diff(np.cbrt([luminance(c) for c in RAMP]))
    assert steps.min() > 0.05 and steps.max() < 3 * steps.min()


def test_a_thumbnail_averages_light_and_keeps_what_is_not_finite() -> None:
    checkers = np.indices((256, 512)).sum(axis=0) % 2
    linear = np.repeat(checkers[..., None], 3, axis=2).astype(np.float32)
    linear[100, 100] = np.inf
    small = thumbnail(linear, 128)
    assert small.shape == (64, 128, 3)
    assert small[0, 0].tolist() == [188, 188, 188]
    assert small[25, 25].tolist() == [255, 0, 255]
    assert thumbnail(linear[:10, :20]).shape == (10, 20, 3)


def test_the_ring_marks_the_pixel_that_the_check_names(result: Result, pictures: dict[str, Pictures]) -> None:
    one = result.checks[3]
    shown = pictures[one.id]

    def figures(check: Check) -> list[Figure]:
        return figures_of(check, shown, "a", (Markup(""), True))

    yours, expected, difference = figures(one)
    assert yours.ring == expected.ring == difference.ring == (100 * 3.5 / SIDE, 100 * 4.5 / SIDE)
    assert "x 3, y 4" in difference.caption
    assert "2902 of 87000 interior pixels (3 %), 100 of 3000 edge pixels (3 %)" in difference.caption
    one.worst = None
    assert figures(one)[2].ring == (
        100 * 4.5 / SIDE,
        100 * 3.5 / SIDE,
    )  # the first that is not finite
    one.worst = Worst(inputs={"pixel": [SIDE, "x"]}, expected=[], actual=[])
    assert figures(one)[2].ring == (100 * 4.5 / SIDE, 100 * 3.5 / SIDE)


# --- What the viewers show ---


def unpacked(blob: str, count: int, shape: tuple[int, int], base: np.ndarray | None, against: list[int]) -> np.ndarray:
    """As report.js does it."""
    split = np.frombuffer(zlib.decompress(base64.b64decode(blob)), np.uint8).reshape(count, 2, *shape).astype(np.uint16)
    out = np.empty((count, *shape), np.uint16)
    for k, (high, low) in enumerate(split):
        packed = high << 8 | low
        change = packed >> 1 ^ np.where(packed & 1, np.uint16(0xFFFF), np.uint16(0))
        out[k] = base[k] + change if k in against else change.cumsum(0, np.uint16).cumsum(1, np.uint16)
    return out


def test_what_is_packed_comes_back() -> None:
    rng = np.random.default_rng(3)
    planes = rng.integers(0, 65536, (3, 30, 40)).astype(np.uint16)
    changed = planes.copy()
    changed[0, 3] += 40000
    changed[2] = rng.integers(0, 65536, (30, 40))
    blob, against = encoding.packed(changed, planes[:2])
    assert against == [0, 1]
    assert (unpacked(blob, 3, (30, 40), planes, against) == changed).all()


def test_half_precision() -> None:
    values = np.array([0, 1, -1, 1 / 3, 1e-3, 3e-7, 65504, 1e9, -1e30, np.nan, np.inf, -np.inf], np.float32)
    halves = encoding.as_halves(values).view(np.float16)
    assert halves[7] == 65504 and halves[8] == -65504  # finite stays finite
    keep = np.r_[0:7, 9:12]
    np.testing.assert_array_equal(halves[keep], values[keep].astype(np.float16))
    many = np.geomspace(1e-4, 6e4, 9999, dtype=np.float32)
    assert (np.abs(encoding.as_halves(many).view(np.float16).astype(np.float32) / many - 1) < 2.0**-11 * 1.001).all()


def test_steps_of_the_tolerance() -> None:
    ratio = np.array([0, 0.2, 0.25, 1, 2, 1e6, 1e30, np.inf], np.float32)
    steps = encoding.as_steps(ratio)
    assert steps[:2].tolist() == [0, 0] and steps[-1] == 65535
    np.testing.assert_allclose(2.0 ** ((steps[2:-1].astype(float) - 33) / 16), ratio[2:-1], rtol=0.022)


def failing(folder: Path, count: int, side: int, noise: float) -> tuple[Result, dict[str, Pictures]]:
    """Checks in both languages of scenes with as much noise in them."""
    rng = np.random.default_rng(5)
    out, pictures = Result(assignment="phong", submission="", max_score=2 * count, complete=True), {}
    smooth = np.repeat(np.linspace(0, 1, side, dtype=np.float32), side * 3).reshape(side, side, 3)
    for k in range(count):
        expected = smooth + noise * rng.random((side, side, 3), np.float32)
        for backend in ("cpp", "glsl"):
            out.add(check(f"{backend}/image/s{k}", "failed", 0, 1))
            own = rng.random((side, side, 13), np.float32) if noise else drawn(expected * np.float32(1.5))
            pictures[out.checks[-1].id] = kept(folder, own, truth_of(expected))
    return out, pictures


def test_a_scene_stands_once(tmp_path: Path) -> None:
    write_html(*failing(tmp_path, 2, 64, 0), tmp_path / "report.html", "Two scenes")
    ids = [s["id"] for s in Page((tmp_path / "report.html").read_text(encoding="utf-8")).all("script") if "id" in s]
    assert sorted(ids) == [
        "data-check-0-cpp-image-s0", "data-check-1-glsl-image-s0", "data-check-2-cpp-image-s1", "data-check-3-glsl-image-s1",
        "data-scene-0", "data-scene-1", "viewers",
    ]  # fmt: skip


def test_the_page_has_a_largest_size(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """The values of the first, then 8 bits with a note; all within the room."""
    monkeypatch.setattr(illustrations, "PAGE", illustrations.WORDS + 2_600_000)
    monkeypatch.setattr(illustrations, "TOTAL", 0)
    result, pictures = failing(tmp_path, 4, 128, 1.0)
    write_html(result, pictures, tmp_path / "report.html", "Noise")
    page = Page((tmp_path / "report.html").read_text(encoding="utf-8"))
    assert (tmp_path / "report.html").stat().st_size < illustrations.PAGE
    noted = page.text.count("they are shown with 8 bits")
    blobs = [s for s in page.all("script") if s.get("id", "").startswith("data-check")]
    assert 0 < noted < 8 and len(blobs) == 8 - noted
    assert len(page.all("img")) == 24


@pytest.mark.parametrize("noise", [0.0, pytest.param(1.0, marks=pytest.mark.slow)])
def test_a_report_of_wrong_pictures_stays_below_four_megabytes(tmp_path: Path, noise: float) -> None:
    """Fourteen scenes in two languages, all wrong, as large as those of assignments; or noise, which nothing packs."""
    write_html(*failing(tmp_path, 14, 400, noise), tmp_path / "report.html", "All wrong")
    page = Page((tmp_path / "report.html").read_text(encoding="utf-8"))
    assert (tmp_path / "report.html").stat().st_size <= 4_000_000 == illustrations.PAGE
    assert len(page.all("img")) == 3 * 28
    # Where values are neither kept nor to be read off an exact picture, none are offered.
    assert len([d for d in page.all("div") if d.get("class") == "pictures"]) - page.text.count(
        "shown with loss"
    ) == len([d for d in page.all("div") if "data-viewer" in d])


def test_positions_keep_a_quarter_of_a_thousandth_of_their_range() -> None:
    layer = np.random.default_rng(2).normal(size=(50, 60, 3)).astype(np.float32) * [1, 10, 100]
    planes, low, high = encoding.as_fractions(layer)
    again = np.array(low) + np.moveaxis(planes, 0, 2) / encoding.FRACTIONS * (np.array(high) - np.array(low))
    assert (np.abs(again - layer).max(axis=(0, 1)) <= (np.array(high) - np.array(low)) / 8190 * 1.001).all()


# --- Hidden checks, mistakes, run times ---


def test_hidden_checks_show_name_status_and_points(
    result: Result, pictures: dict[str, Pictures], tmp_path: Path
) -> None:
    for one in result.checks:
        if one.id in ("cpp/image/teapot", "cpp/image/knot"):
            one.hidden, one.message, one.printed = True, "SECRET", "SECRET"
            one.mistake = Mistake(id="SECRET", hint="SECRET", margin=1)
            one.runs = [Render(series="SECRET", rmse=1e-3, seconds=0.1)]
    write_html(result, pictures, tmp_path / "report.html", "Hidden")
    source = (tmp_path / "report.html").read_text(encoding="utf-8")
    page = Page(source)
    assert "SECRET" not in source and "shadelab probe" not in source
    assert "2 / 8" in page.text and "teapot" in page.text
    assert len(page.all("img")) == 1 and "data-scene" not in source  # only what crashed has its expected picture
    write_html(result, pictures, tmp_path / "report.html", "Hidden", hidden_details=True)
    source = (tmp_path / "report.html").read_text(encoding="utf-8")
    assert "SECRET" in source and "shadelab probe" in source and len(Page(source).all("img")) == 5


def test_the_mistake_and_the_floor_are_told(page: Page) -> None:
    text = " ".join(page.text.split())
    assert "This looks like a known mistake. normalise" in text
    assert "3 times fewer of your values unexplained than anything else" in text
    assert "limit 0.001 (correct programs stay below 0.00016)" in text
    assert "Correct programs stay below" in text


def test_error_against_run_time(result: Result, tmp_path: Path) -> None:
    image = next(c for c in result.checks if c.id == "cpp/image/teapot")
    image.runs = [
        Render(series="yours", rmse=0.03, seconds=0.012),
        Render(series=HOSTILE, rmse=3e-8, seconds=0.011),
        Render(series=HOSTILE, rmse=0.0, seconds=0.11),
    ]
    write_html(result, {}, tmp_path / "report.html", "Run times")
    page = Page((tmp_path / "report.html").read_text(encoding="utf-8"))
    assert "run time is reported and never graded" in page.text
    assert "yours, C++: 0.03, 12 ms" in page.text
    plots = [a for a in page.all("svg") if a.get("role") == "img"]
    assert len(plots) == 1 and "teapot" in plots[0]["aria-label"]
    numbers = [float(n) for a in page.all("path") for n in re.findall(r"-?[0-9.]+", a["d"])]
    assert min(numbers) >= 0 and max(numbers) <= 340


# --- The terminal ---


def printed(result: Result, width: int = 80, **options: object) -> str:
    stream = io.StringIO()
    print_result(result, Console(file=stream, width=width, **options), Path("results/report.html"))
    return stream.getvalue()


@pytest.mark.parametrize("width", [80, 120])
def test_no_line_is_wider_than_the_terminal(result: Result, width: int) -> None:
    lines = printed(result, width).split("\n")
    assert max(map(cell_len, lines)) <= width and max(map(len, lines)) <= width


def test_without_a_terminal_there_are_no_control_characters(result: Result) -> None:
    assert not re.search(r"[\x00-\x09\x0b-\x1f\x7f-\x9f\u202e]", printed(result))


def test_in_a_terminal_only_our_colours_remain(result: Result) -> None:
    text = printed(result, force_terminal=True, color_system="standard")
    assert "\x1b[" in text
    rest = re.sub(r"\x1b\[[0-9;]*m", "", text)
    assert not re.search(r"[\x00-\x09\x0b-\x1f\x7f-\x9f\u202e]", rest)
    assert "␛[2J" in rest and "[red]no[/red]" in rest


def test_the_table_puts_the_backends_side_by_side(result: Result) -> None:
    text = printed(result)
    assert re.search(r"half_vector +✗ +0 / 6 +– skipped", text)
    assert re.search(r"phong +✓ 10 / 10 +✗ +0 / 10", text)
    assert re.search(r"image teapot +✗ +2 / 8\s*\n", text)
    assert "Score: 20 of 60 points" in text
    assert "results/report.html" in text


def test_failed_checks_are_told_and_skipped_ones_are_not(result: Result) -> None:
    text = printed(result)
    told = text.partition("Score:")[2]
    flat = " ".join(told.replace(" \\\n", " ").split())
    kinds = set()
    for one in result.checks:
        name = re.escape(plain(one.id.split("/", 2)[-1]) if one.kind != "build" else "build")
        heading = rf"[✗!] (?:{one.kind} )?{name} \([^)]*{re.escape({'cpp': 'C++', 'glsl': 'GLSL'}[one.backend])}"
        assert bool(re.search(heading, flat)) == (one.status in ("failed", "error")), one.id
        if one.worst:  # one replay line of each kind: the others read alike
            kinds.add(one.kind)
    assert sum(flat.count(one.worst.replay) for one in result.checks if one.worst) == len(kinds)
    assert "expected (0.1, 0.2, 0.3), yours (not finite, 0.2, 0.3)" in flat
    assert "result[8]: expected 0.8, yours 8" in flat and "result[7]" not in flat
    assert "The grader's fault, not yours." in flat


def test_an_ascii_terminal_gets_ascii(result: Result) -> None:
    stream = io.TextIOWrapper(io.BytesIO(), encoding="ascii")
    print_result(result, Console(file=stream, width=80), None)
    stream.flush()
    assert b"X  0 / 6" in stream.buffer.getvalue()


# --- Words ---


def test_a_releases_score_is_explained_where_it_stands(result: Result, tmp_path: Path) -> None:
    released = result.model_copy(update={"elsewhere": 8.0})
    write_html(released, {}, tmp_path / "report.html", "Lobes")
    words = "8 more are for scenes that only the course has"
    texts = {Page((tmp_path / "report.html").read_text(encoding="utf-8")).text, summary(released), printed(released)}
    for text in texts:
        flat = " ".join(text.split())
        assert words in flat and re.search(
            r"of [\d.]+ points[.\s]+These are the points of the checks in this release", flat
        )
    assert words not in summary(result) and words not in " ".join(printed(result).split())


def test_what_comes_first(result: Result) -> None:
    assert wording.first_step(result)[1].id == "glsl/build"
    result.checks = [c for c in result.checks if c.kind != "build"]
    assert wording.first_step(result)[1].id == "cpp/function/half_vector"
    result.checks = [c for c in result.checks if c.status != "failed"]
    assert wording.first_step(result)[1].status == "error"
    result.checks = [c for c in result.checks if c.status == "passed"]
    assert wording.first_step(result) == ("Nothing to mend: every check passes.", None)
    result.complete = False
    assert "cut off" in wording.first_step(result)[0]


def test_inputs_that_the_explanation_speaks_of_come_first() -> None:
    one = check("cpp/function/f", "failed", 0, 1, message="wrong for 46 % of the inputs; only where n.h > 0.5")
    one.mistake = Mistake(id="undeclared", hint="Your values are those with 4 times m.q in the place of m.q.", margin=9)
    inputs = {"n": [0.0, 0.0, 1.0], "l": [1.0, 0.0, 0.0], "m.kd": [0.1, 0.2, 0.3], "m.q": 1.5, "m.qq": 2.0}
    one.worst = Worst(inputs=inputs, expected=[1.0], actual=[2.0])
    assert next(wording.worst_lines(one)).startswith("at n = (0, 0, 1), m.q = 1.5, l = ")


def test_wrong_components_are_marked() -> None:
    def marks(expected: list, actual: list) -> list[bool]:
        one = check("cpp/function/f", "failed", 0, 1, error=Error(name="scaled", value=1, limit=1e-3))
        one.worst = Worst(inputs={}, expected=expected, actual=actual)
        return [wrong for *_, wrong in wording.compared(one)]

    assert marks([1.0, 2.0, 3.0], [1.0, 2.1, None]) == [False, True, True]
    assert marks([1.0, 0.0], [1.0, 1e-7]) == [False, False] or marks([1.0, 0.0], [1.0, 1e-7]) == [False, True]
    assert marks([1.0], [1.0000001]) == [
        True
    ]  # the largest error is marked even where this row alone explains no failure
    assert marks([1.0], [1.0]) == [False]
    assert marks([[1.0, 2.0], [3.0, 4.0]], [[1.0, 2.0], [3.0]]) == [False, False, False, True]


def test_names_of_components() -> None:
    one = check("cpp/function/f", "failed", 0, 1)
    one.worst = Worst(inputs={}, expected=[{"diffuse": [1.0, 2.0, 3.0]}, {"q": 1.0}], actual=[])
    assert [name for name, *_ in wording.compared(one)] == [
        "result.diffuse.x",
        "result.diffuse.y",
        "result.diffuse.z",
        "result.q",
    ]
