"""The report in a browser: what its viewers draw and say, by pointer and by keyboard, and that it asks for nothing else."""

from __future__ import annotations

import re
import shutil
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pytest
from test_reports import HOSTILE, check, drawn, kept, truth_of

from shadelab.report.html import illustrations
from shadelab.report.html.page import write_html
from shadelab.report.html.pictures import MAGENTA, PALETTE, difference, excess, srgb
from shadelab.result import Error, Mistake, Render, Result, Worst
from shadelab.truth.expected import BACKGROUND, EDGE, INTERIOR

playwright = pytest.importorskip("playwright.sync_api", reason="playwright is not installed")
CHROMIUM = shutil.which("chromium")
pytestmark = pytest.mark.skipif(CHROMIUM is None, reason="chromium is not installed")

WIDTH, HEIGHT = 48, 32
WORST = (20, 10)


@dataclass
class Report:
    file: Path
    student: np.ndarray
    expected: np.ndarray
    limit: np.ndarray


def scene() -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Student, expected and limit: brighter to the right; the student's is dimmer and reddish, with a pixel that is not
    finite."""
    y, x = np.mgrid[0:HEIGHT, 0:WIDTH].astype(np.float32)
    expected = np.stack([0.1 + 0.01 * x, 0.2 + 0.01 * y, 0.3 + 0 * x], axis=2).astype(np.float32)
    student = expected * np.array([1.0, 0.5, 0.5], np.float32)
    student[:4] = expected[:4]
    student[WORST[1], WORST[0]] = (3.0, 0.0, 1234.5)
    student[6, 7] = np.nan
    return student, expected, 0.01 * np.abs(expected) + np.float32(0.001)


def write(folder: Path) -> Report:
    student, expected, limit = scene()
    mask = np.full((HEIGHT, WIDTH), INTERIOR, np.uint8)
    mask[:, 30:33] = EDGE
    mask[-2:] = BACKGROUND
    objects = np.ones((HEIGHT, WIDTH, 1), np.float32)
    objects[:, 24:] = 2
    objects[-2:] = 0
    truth = truth_of(expected, mask, id=objects)
    layers = drawn(student)
    layers[..., 3:6], layers[..., 6:9] = expected, student - expected
    x, y = WORST
    worst = Worst(
        inputs={"pixel": [x, y]}, expected=[float(v) for v in expected[y, x]], actual=[float(v) for v in student[y, x]]
    )
    result = Result(assignment="phong", submission="sha256:0", max_score=30, complete=True)
    result.add(check("cpp/image/teapot", "failed", 2, 10, message=HOSTILE, printed=HOSTILE, worst=worst, error=Error(name="share", value=0.9,
               limit=1e-3, floor=1e-5), mistake=Mistake(id="x", hint=HOSTILE, margin=3), runs=[Render(series=HOSTILE, rmse=1e-3, seconds=0.01)]))  # fmt: skip
    result.add(check("glsl/image/teapot", "failed", 2, 10, message=HOSTILE))
    result.add(check("cpp/image/knot", "passed", 10, 10))
    same, broken = (kept(folder, each, truth) for each in (drawn(expected), layers))
    same.limit = broken.limit = limit
    pictures = {"cpp/image/teapot": broken, "glsl/image/teapot": broken, "cpp/image/knot": same}
    file = folder / "report.html"
    write_html(result, pictures, file, "Teapot " + HOSTILE)
    return Report(file, student, expected, limit)


@pytest.fixture(scope="module")
def report(tmp_path_factory: pytest.TempPathFactory) -> Report:
    return write(tmp_path_factory.mktemp("report"))


@pytest.fixture(scope="module")
def browser() -> Iterator:
    with playwright.sync_playwright() as driver:
        browser = driver.chromium.launch(executable_path=CHROMIUM, args=["--no-sandbox"])
        yield browser
        browser.close()


def watched(page, complaints: list[str]):
    """A page that notes what it says on the console, and what it asks for besides its own file."""
    # The reading back is ours: pixel() below.
    page.on("console", lambda message: "willReadFrequently" in message.text or complaints.append(message.text))
    page.on("pageerror", lambda error: complaints.append(str(error)))
    page.on("dialog", lambda dialog: (complaints.append(dialog.message), dialog.dismiss()))
    page.on("request", lambda request: request.url.endswith("/report.html") or complaints.append(request.url))
    return page


@pytest.fixture(scope="module")
def one_page(browser) -> Iterator[tuple]:
    complaints: list[str] = []
    page = watched(browser.new_page(viewport={"width": 1280, "height": 900}), complaints)
    yield page, complaints
    page.close()


@pytest.fixture
def page(one_page: tuple, report: Report) -> Iterator:
    """Loaded anew; the viewer of the first failed check is open from the start."""
    page, complaints = one_page
    complaints.clear()
    page.goto(report.file.as_uri())
    page.locator(".viewer .stage").first.wait_for()
    yield page
    assert complaints == []


@pytest.fixture
def visit(browser) -> Iterator[Callable]:
    """With another file or browser."""
    pages, complaints = [], []

    def visit(file: Path, width: int = 1280, **options: object):
        pages.append(watched(browser.new_page(viewport={"width": width, "height": 900}, **options), complaints))
        pages[-1].goto(file.as_uri())
        if options.get("java_script_enabled", True):
            pages[-1].locator(".viewer .stage").first.wait_for()
        return pages[-1]

    yield visit
    for page in pages:
        page.close()
    assert complaints == []


def canvas(page, pane: str):
    return page.locator(f".viewer [data-pane={pane}] canvas").first


def pixel(page, pane: str, x: float, y: float) -> tuple[int, ...]:
    """The colour in a canvas at a place of the whole picture, in its pixels; unzoomed."""
    script = """(canvas, [x, y]) => [...canvas.getContext("2d").getImageData(
        Math.floor(x * canvas.width), Math.floor(y * canvas.height), 1, 1).data]"""
    return tuple(canvas(page, pane).evaluate(script, [(x + 0.5) / WIDTH, (y + 0.5) / HEIGHT]))[:3]


def colour(linear: np.ndarray, x: int, y: int, exposure: float = 0) -> tuple[int, ...]:
    return tuple(int(c) for c in srgb(linear[y : y + 1, x : x + 1] * np.float32(2**exposure))[0, 0])


def near(a: tuple[int, ...], b: tuple[int, ...]) -> bool:
    return max(abs(p - q) for p, q in zip(a, b)) <= 1


def click(page, pane: str, x: int, y: int) -> None:
    box = canvas(page, pane).bounding_box()
    canvas(page, pane).click(position={"x": (x + 0.5) / WIDTH * box["width"], "y": (y + 0.5) / HEIGHT * box["height"]})


def values(page) -> dict[str, list[str]]:
    """The rows of the inspector by their heads."""
    script = """root => Object.fromEntries([...root.querySelectorAll(".inspector tbody tr")].map(
        row => [row.querySelector("th").textContent, [...row.querySelectorAll("td")].map(cell => cell.textContent)]))"""
    return page.locator(".viewer").first.evaluate(script)


def number(text: str) -> float:
    """-1.5e-3 of −1.5e-3, 12 of 12×✗, 0.25 of < 0.25×."""
    return float(re.search(r"[-0-9.e+]+|inf|NaN", text.replace("−", "-").replace("∞", "inf"))[0])


def press(page, *keys: str) -> None:
    for key in keys:
        page.keyboard.press(key)


def test_side_by_side_shows_all_three(page) -> None:
    student, expected, _ = scene()
    assert near(pixel(page, "yours", 40, 20), colour(student, 40, 20))
    assert near(pixel(page, "expected", 40, 20), colour(expected, 40, 20))
    assert pixel(page, "difference", 40, 2) == (0, 0, 0)
    assert pixel(page, "difference", 40, 20) not in ((0, 0, 0), MAGENTA)
    assert len(set(pixel(page, "difference", 31, 20))) == 1  # an edge is grey
    assert pixel(page, "yours", 7, 6) == pixel(page, "difference", 7, 6) == MAGENTA


def test_the_difference_is_the_static_one(page, report: Report) -> None:
    ratio = excess(report.student, report.expected, report.limit)
    edge = np.zeros((HEIGHT, WIDTH), bool)
    palette = PALETTE[difference(ratio, edge, ~np.isfinite(ratio))]
    for x, y in ((3, 2), (40, 20), (5, 12), (25, 25)):
        drawn = pixel(page, "difference", x, y)
        assert max(abs(int(a) - int(b)) for a, b in zip(drawn, palette[y, x])) <= 8


def test_slider(page) -> None:
    student, expected, _ = scene()
    page.get_by_label("Slider").first.check()
    for x in (2, 44):
        assert near(pixel(page, "both", x, 20), colour(student if x < 24 else expected, x, 20))
    box = canvas(page, "both").bounding_box()
    page.mouse.move(box["x"] + box["width"] / 2, box["y"] + 20)
    page.mouse.down()
    page.mouse.move(box["x"] + box["width"] * 0.05, box["y"] + 20, steps=3)
    page.mouse.up()
    assert near(pixel(page, "both", 5, 20), colour(expected, 5, 20))
    wipe = page.locator(".wipe input").first
    assert wipe.input_value() == "5"
    wipe.press("End")
    assert near(pixel(page, "both", 44, 20), colour(student, 44, 20))


def test_flip(page) -> None:
    student, expected, _ = scene()
    page.get_by_label("Flip", exact=True).first.check()
    assert near(pixel(page, "both", 40, 20), colour(student, 40, 20))
    page.get_by_role("button", name="Flip to expected").click()
    assert near(pixel(page, "both", 40, 20), colour(expected, 40, 20))
    press(page, "f")
    assert near(pixel(page, "both", 40, 20), colour(student, 40, 20))


def test_exposure_is_in_step(page) -> None:
    student, expected, _ = scene()
    before = {pane: pixel(page, pane, 40, 20) for pane in ("yours", "expected", "difference")}
    page.locator(".exposure input").first.fill("1.5")
    assert near(pixel(page, "yours", 40, 20), colour(student, 40, 20, 1.5))
    assert near(pixel(page, "expected", 40, 20), colour(expected, 40, 20, 1.5))
    assert pixel(page, "yours", 7, 6) == MAGENTA
    page.locator(".exposure input").first.fill("-6")
    assert all(pixel(page, pane, 40, 20) != colour for pane, colour in before.items())
    assert "64× the tolerance" in page.locator("[data-pane=difference] figcaption").first.text_content()


def test_zoom_and_pan_are_in_step(page) -> None:
    student, expected, _ = scene()
    click(page, "yours", 40, 20)
    for _ in range(3):
        page.get_by_role("button", name="Zoom in").first.click()
    assert page.locator(".zoom output").first.text_content() == "8×"
    box = canvas(page, "expected").bounding_box()
    page.mouse.move(box["x"] + 200, box["y"] + 100)
    page.mouse.down()
    page.mouse.move(box["x"] + 20, box["y"] + 100, steps=4)  # the picture moves by 3 pixels: to the left
    page.mouse.up()
    shown = page.evaluate(
        """() => ["yours", "expected"].map(pane => {
            const canvas = document.querySelector(`[data-pane=${pane}] canvas`);
            return [...canvas.getContext("2d").getImageData(canvas.width / 2, canvas.height / 4, 1, 1).data].slice(0, 3);
        })"""
    )
    # Where both agree that they stand, by the red that depends on x and the green that depends on y.
    places = [
        {(x, y) for y in range(HEIGHT) for x in range(WIDTH) if near(colour(image, x, y), shown[k])}
        for k, image in enumerate((student, expected))
    ]
    both = places[0] & places[1]
    assert both and all(40 <= x <= 43 and y == 18 for x, y in both)
    press(page, "0")
    assert page.locator(".zoom output").first.text_content() == "1×"


def test_the_worst_pixel_is_chosen_and_exact(page, report: Report) -> None:
    x, y = WORST
    shown = values(page)
    assert shown["pixel"] == ["x 20, y 10"] and shown["object"] == ["1"] and shown["judged"] == ["strictly"]
    for k, channel in enumerate("rgb"):
        expected, yours = (number(v) for v in shown[f"total {channel}"][:2])
        assert expected == pytest.approx(report.expected[y, x, k], rel=5e-4)
        assert yours == pytest.approx(report.student[y, x, k], rel=5e-4)
    ratio = excess(report.student, report.expected, report.limit)[y, x]
    assert number(shown["total r"][2]) == pytest.approx(ratio, rel=1e-3)


@pytest.mark.parametrize("place", [(40, 20), (12, 2), (25, 7)])
def test_a_clicked_pixel_shows_its_values(page, report: Report, place: tuple[int, int]) -> None:
    x, y = place
    click(page, "expected", x, y)
    shown = values(page)
    assert shown["pixel"] == [f"x {x}, y {y}"] and shown["object"] == ["2" if x >= 24 else "1"]
    for k, channel in enumerate("rgb"):
        expected, yours = (number(v) for v in shown[f"total {channel}"][:2])
        assert expected == pytest.approx(report.expected[y, x, k], rel=1.1e-3)
        assert yours == pytest.approx(report.student[y, x, k], rel=1.1e-3)
        ambient, diffuse = number(shown[f"ambient {channel}"][1]), number(shown[f"diffuse {channel}"][1])
        assert ambient + diffuse == pytest.approx(report.student[y, x, k], rel=3e-3)
    ratio = excess(report.student, report.expected, report.limit)[y, x]
    told = shown["total r"][2]
    assert told == "< 0.25×" if ratio < 0.25 else number(told) == pytest.approx(ratio, rel=0.08)
    # The directions, from the scene of truth_of.
    position = np.array([x / WIDTH, -y / HEIGHT, 0])
    v = np.array([0, 0, 3]) - position
    l1 = np.array([0.5, 0.5, 2]) - position
    directions = {
        "x": position,
        "n": [0, 0, 1],
        "v": v / np.linalg.norm(v),
        "l₁": l1 / np.linalg.norm(l1),
        "l₂": [-0.6, 0, 0.8],
    }
    directions["h₁"] = directions["l₁"] + directions["v"]
    directions["h₁"] /= np.linalg.norm(directions["h₁"])
    for name, right in directions.items():
        assert [number(c) for c in shown[name]] == pytest.approx(list(right), abs=1e-4), name
    assert number(shown["n·l₁"][0]) == pytest.approx(directions["l₁"][2], abs=1e-4)


def test_a_pixel_that_is_not_finite_and_the_background(page) -> None:
    click(page, "yours", 7, 6)
    assert values(page)["total r"][1:2] == ["NaN"] and "∞" in values(page)["total r"][2]
    click(page, "yours", 3, HEIGHT - 1)
    shown = values(page)
    assert shown["object"] == ["none: background"] and "n" not in shown


def test_layers(page, report: Report) -> None:
    select = page.locator(".viewer select").first
    assert select.locator("option").all_text_contents() == [
        "total", "ambient", "diffuse", "specular", "id", "normal", "position", "distance",
    ]  # fmt: skip
    select.select_option("ambient")
    assert near(pixel(page, "yours", 40, 20), colour(report.expected, 40, 20))
    assert pixel(page, "difference", 40, 20) == (0, 0, 0)
    select.select_option("specular")
    assert pixel(page, "expected", 40, 20) == (0, 0, 0)
    select.select_option("normal")
    assert page.locator("[data-pane=yours]").first.is_hidden()
    assert pixel(page, "geometry", 40, 20) == (128, 128, 255)
    select.select_option("id")
    assert pixel(page, "geometry", 40, 20) != pixel(page, "geometry", 4, 20)
    assert pixel(page, "geometry", 4, HEIGHT - 1) == (0, 0, 0)
    for name in ("position", "distance"):
        select.select_option(name)
        assert pixel(page, "geometry", 40, 20) != pixel(page, "geometry", 4, 4)


def test_the_keyboard_alone(page) -> None:
    for _ in range(60):  # from the top of the page to the first viewer's pictures
        press(page, "Tab")
        if page.evaluate("document.activeElement.className") == "stage":
            break
    focused = page.locator(".stage").first
    assert focused.evaluate("e => e === document.activeElement && getComputedStyle(e).outlineStyle") == "solid"
    press(page, "ArrowRight", "ArrowDown", "Shift+ArrowRight")
    assert values(page)["pixel"] == ["x 31, y 11"]
    press(page, "w")
    assert values(page)["pixel"] == ["x 20, y 10"]
    modes = {"2": "slider", "3": "flip", "1": "side"}
    for key, mode in modes.items():
        press(page, key)
        assert page.locator(".viewer").first.get_attribute("data-mode") == mode
        assert page.locator(f".viewer [value={mode}]").first.is_checked()
    press(page, "2", "<", "<", ">")
    assert page.locator(".wipe input").first.input_value() == "45"
    press(page, "l")
    assert page.locator("select").first.input_value() == "ambient"
    press(page, "L")
    assert page.locator("select").first.input_value() == "total"
    press(page, "]", "]", "[")
    assert page.locator(".exposure output").first.text_content() == "+0.5"
    press(page, "+", "+", "-")
    assert page.locator(".zoom output").first.text_content() == "2×"
    press(page, "f")
    assert page.locator(".viewer").first.get_attribute("data-mode") == "flip"
    page.wait_for_timeout(400)
    assert page.locator(".viewer [aria-live]").first.text_content().startswith("Pixel 20, 10: expected 0.300")
    press(page, "Escape")
    assert page.locator(".viewer").count() == 0 and page.locator(".picture img").first.is_visible()
    assert page.evaluate("document.activeElement.textContent") == "Inspect the pixels"
    press(page, "Enter")
    page.locator(".stage").wait_for()
    assert page.evaluate("document.activeElement.className") == "stage"


def test_a_control_keeps_its_own_keys(page) -> None:
    page.locator(".viewer select").first.focus()
    press(page, "ArrowDown")
    assert page.locator("select").first.input_value() == "ambient" and values(page)["pixel"] == ["x 20, y 10"]
    page.locator(".exposure input").first.focus()
    press(page, "ArrowRight")
    assert page.locator(".exposure output").first.text_content() == "+0.5" and values(page)["pixel"] == ["x 20, y 10"]


def test_the_keys_are_documented(page) -> None:
    page.get_by_text("Keys and pointer").first.click()
    assert page.get_by_text("the worst pixel", exact=True).first.is_visible()


def test_pictures_open_viewers(page, report: Report) -> None:
    """A static picture at the place that was clicked; a thumbnail of a check that passes."""
    image = page.locator(".picture:visible img").first
    box = image.bounding_box()
    image.click(position={"x": 40.5 / WIDTH * box["width"], "y": 20.5 / HEIGHT * box["height"]})
    page.locator(".viewer").nth(1).wait_for()
    assert re.search(
        "x (39|40), y (19|20)", page.locator(".viewer .inspector").nth(1).text_content()
    )  # by whole CSS pixels
    page.get_by_role("button", name="Inspect the pixels of cpp/image/knot").click()
    page.locator(".thumbnails + .viewer").wait_for()
    assert "cpp/image/knot" in page.locator(".thumbnails + .viewer").text_content()
    press(page, "Escape")
    assert page.locator(".thumbnails + .viewer").count() == 0
    assert page.evaluate("document.activeElement.className") == "open"


def test_roles_and_names(page) -> None:
    snapshot = page.locator(".viewer").first.aria_snapshot()
    assert 'region "Viewer of cpp/image/teapot"' in snapshot
    assert 'radio "Side by side" [checked]' in snapshot and 'combobox "Layer"' in snapshot
    assert 'slider "Exposure' in snapshot and 'img "Difference"' in snapshot
    assert "Arrow keys move the pixel" in snapshot


@pytest.mark.parametrize("scheme", ["light", "dark"])
def test_a_phone(visit: Callable, report: Report, scheme: str) -> None:
    page = visit(
        report.file, width=360, color_scheme=scheme, device_scale_factor=2, has_touch=True, reduced_motion="reduce"
    )
    page.locator(".keys summary").first.click()
    for mode in ("1", "2", "3"):
        page.locator(".stage").first.press(mode)
        assert page.evaluate("document.scrollingElement.scrollWidth <= innerWidth")
    box = canvas(page, "both").bounding_box()
    canvas(page, "both").tap(position={"x": box["width"] * 0.9, "y": box["height"] * 0.9})
    assert values(page)["pixel"] != ["x 20, y 10"]


def test_hostile_text_is_inert(page) -> None:
    page.wait_for_timeout(100)
    assert "<script>alert(1)</script>" in page.locator(".note.mistake").text_content()
    assert page.locator("img[src=x]").count() == 0


def test_without_a_script_the_pictures_stay(visit: Callable, report: Report) -> None:
    page = visit(report.file, java_script_enabled=False)
    assert page.locator(".picture img").count() == 6 and page.locator(".thumbnails img").count() == 1
    for image in page.locator(".picture img").all():
        assert image.is_visible()
    assert page.locator(".viewer").count() == 0


def test_without_room_for_the_values(visit: Callable, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """The viewer draws the static pictures."""
    monkeypatch.setattr(illustrations, "PAGE", 0)
    report = write(tmp_path)
    page = visit(report.file)
    assert near(pixel(page, "yours", 40, 20), colour(report.student, 40, 20))
    click(page, "yours", 40, 20)
    shown = values(page)
    assert number(shown["total g"][0]) == pytest.approx(report.expected[20, 40, 1], rel=0.02)
    assert "8 bits" in page.locator(".viewer").first.text_content()
    assert page.locator("select option").first.text_content() == "total"
    assert page.get_by_text("This page has grown too large").first.is_visible()
