"""Studies: the arithmetic of points and slopes, samples and truths, small runs of each kind, and the command. No test
asserts a time."""

import csv
import io
import json
from contextlib import ExitStack
from dataclasses import replace

import numpy as np
import pytest
import tomli_w
from rich.console import Console

from conftest import ROOT
from shadelab.course.assignment import Scene, load_assignment
from shadelab.course.toml_files import read_toml
from shadelab.errors import UserError
from shadelab.machine import renderer
from shadelab.measure.timing import interleaved
from shadelab.study import declaration, plot
from shadelab.study.backends import SERIES, measure_backends
from shadelab.study.declaration import Backends, Interpolation, Sampling, Study, load_study, studied, study_names
from shadelab.study.images import ONE_FRAME, converged, small_size
from shadelab.study.interpolation import measure_interpolation
from shadelab.study.points import Guide, Part, Point, Slope, fit_slope, front, timing_noise
from shadelab.study.report import print_study, write_files
from shadelab.study.run import as_json
from shadelab.study.sampling import measure_sampling, random_shifts, stratified_shifts
from shadelab.study.timing import DrawnFrames, Workbench

PHONG = ROOT / "solution" / "phong"
SMALL_SCENE = ROOT / "scenes" / "phong" / "sphere.toml"


def silent(what, done, total):
    pass


@pytest.fixture
def work(tmp_path):
    return Workbench(tmp_path / "work", silent)


def point(seconds: float | None, rmse: float, series: str = "a", **knob) -> Point:
    times = seconds and {"median": seconds, "min": seconds / 2, "max": seconds * 2, "runs": 3}
    return Point(series, knob, {"rmse": rmse, "max": 2 * rmse}, times)


# ------------------------------------------------------------------------------------------------ points and slopes


def test_front_holds_what_nothing_beats():
    points = [point(1, 4), point(2, 2), point(2, 3), point(3, 2), point(4, 1), point(None, 0), point(5, 1)]
    front(points)
    assert [p.front for p in points] == [True, True, False, False, True, False, False]


def test_equal_points_share_the_front():
    points = [point(1, 1), point(1, 1)]
    front(points)
    assert all(p.front for p in points)


def test_groups_have_fronts_of_their_own():
    part = Part("x", "x", "x", {}, [point(1, 1, scene="a"), point(2, 2, scene="b"), point(3, 3, scene="b")])
    part.front_within = "scene"
    part.mark_front()
    assert [p.front for p in part.points] == [True, True, False]


def test_slope_of_a_power_law():
    x = np.array([1, 2, 4, 9, 16, 64])
    slope, error = fit_slope(x, 3 * x**-0.75)
    assert slope == pytest.approx(-0.75) and error == pytest.approx(0, abs=1e-12)


def test_standard_error_is_that_of_least_squares():
    rng = np.random.default_rng(2)
    x = np.geomspace(1, 100, 12)
    y = x**2 * np.exp(rng.normal(0, 0.1, 12))
    fitted, covariance = np.polyfit(np.log(x), np.log(y), 1, cov=True)
    assert fit_slope(x, y) == pytest.approx((fitted[0], np.sqrt(covariance[0, 0])))


@pytest.mark.parametrize("x, y", [([1, 2], [1, 2]), ([1, 2, 3], [1, 0, 2])])
def test_no_slope_without_positive_points(x, y):
    with pytest.raises(ValueError, match="three or more positive points"):
        fit_slope(x, y)


def test_runs_are_interleaved_after_a_warm_up():
    order = []
    clock = iter(range(100))

    def own(name):
        order.append(name)
        return float(next(clock))

    times = interleaved({"a": lambda: own("a"), "b": lambda: own("b")}, 3, pause=0)
    assert order == list("abbaabba")  # the first two warm up; who begins changes
    assert times["a"] == {"median": 4, "min": 3, "max": 7, "runs": 3}
    assert times["b"] == {"median": 5, "min": 2, "max": 6, "runs": 3}
    [taken] = interleaved({"c": lambda: None}, 2, pause=0).values()  # who does not measure is measured
    assert 0 <= taken["min"] <= taken["median"] < 0.1


def test_noise_is_the_spread_of_the_runs():
    assert timing_noise([point(2, 1), point(None, 1)]) == {"median_spread": 1.5, "largest_spread": 1.5}
    assert timing_noise([point(None, 1)]) == {}


# -------------------------------------------------------------------------------------------------------- sampling


def test_every_stratum_has_one_sample():
    shifts = np.array(stratified_shifts(36, np.random.default_rng(1)))
    strata = np.floor((shifts + 0.5) * 6).astype(int)
    assert sorted(map(tuple, strata.tolist())) == [(i, j) for i in range(6) for j in range(6)]
    assert np.abs(random_shifts(1000, np.random.default_rng(1))).max() <= 0.5


@pytest.mark.parametrize("shifts, order", [(random_shifts, -0.5), (stratified_shifts, -0.75)])
def test_samples_see_an_edge_with_the_order_of_theory(shifts, order):
    """Half of the pixel is covered, by an edge through its middle in any direction."""
    rng = np.random.default_rng(3)
    counts = [4, 16, 64, 256]
    errors = []
    for count in counts:
        angles = rng.uniform(0, 2 * np.pi, 600)
        seen = [np.mean(np.array(shifts(count, rng)) @ (np.cos(a), np.sin(a)) > 0) - 0.5 for a in angles]
        errors.append(np.sqrt(np.mean(np.square(seen))))
    assert fit_slope(counts, errors)[0] == pytest.approx(order, abs=0.05)


class Remembering:
    """A program whose picture is one pixel: the mean over ONE_FRAME x ONE_FRAME samples of x + y^2, moved."""

    def __init__(self):
        self.samples = []

    def draw(self, shifts=((0.0, 0.0),), image=True):
        centres = (np.arange(ONE_FRAME) + 0.5) / ONE_FRAME - 0.5
        values = []
        for x, y in shifts:
            self.samples += [(x + a, y + b) for a in centres for b in centres]
            values += [x + a + (y + b) ** 2 for a in centres for b in centres]
        return DrawnFrames(0.0, np.full((1, 1, 3), np.mean(values)))


def test_reference_is_a_regular_grid_and_knows_its_error():
    program = Remembering()
    image, error = converged(program, 64)
    grid = (np.arange(64) + 0.5) / 64 - 0.5
    assert np.allclose(sorted(program.samples), sorted((x, y) for x in grid for y in grid))
    assert abs(image[0, 0, 0] - 1 / 12) <= max(error, 1 / 64**2)
    assert converged(Remembering(), 16)[0] == pytest.approx(1 / 12, abs=1e-3)


def test_pictures_keep_their_shape(tmp_path):
    scene = tmp_path / "scene.toml"
    content = read_toml(SMALL_SCENE)

    def size(longest, **film):
        content["film"] = film
        scene.write_text(tomli_w.dumps(content))
        return small_size(renderer.describe(scene, PHONG), longest)

    assert size(128, width=600, height=200) == "128x43"
    assert size(1000, width=600, height=200) == "600x200"
    del content["film"]
    assert size(64) == "64x64"


def test_shifted_frames_are_the_samples_of_a_larger_one(work):
    """What `--supersample 2` averages, drawn as four frames that stand by. Vertices are rounded to parts of each frame's
    own pixels, so a sample close to an edge may fall to its other side."""
    assignment = load_assignment(PHONG)
    loops = work.needs(SMALL_SCENE, assignment).loops
    quarters = [(x, y) for x in (-0.25, 0.25) for y in (-0.25, 0.25)]
    view = renderer.View(size="48x48")
    with ExitStack() as stack:
        one = stack.enter_context(work.cpp(SMALL_SCENE, assignment, loops, view=view))
        four = stack.enter_context(work.cpp(SMALL_SCENE, assignment, loops, view=replace(view, supersample=2)))
        whole = four.draw()
        same = np.abs(one.draw(quarters).image - whole.image).max(axis=2) < 1e-5
        unlike = np.abs(one.draw().image - whole.image).max(axis=2) > 1e-5
        elsewhere = np.abs(one.draw([(0.25, 0.25)] * 4).image - whole.image).max(axis=2) > 1e-5
        seen = whole.image.max(axis=2) > 0
        assert same[seen].mean() > 0.98 and unlike[seen].mean() > 0.5 and elsewhere[seen].mean() > 0.5
        assert whole.seconds > 0 and one.draw(image=False).image is None


def test_sampling_from_end_to_end(work):
    spec = Sampling(scene="", samples=[1, 4, 9], size=32, reference=32)
    study = Study(title="x", kind="sampling", repeats=3, sampling=spec)
    part = measure_sampling(study, spec, work, SMALL_SCENE, load_assignment(PHONG))
    assert [(p.series, p.knob["samples"]) for p in part.points] == [
        (series, n) for series in ("random", "stratified", "regular") for n in (1, 4, 9)
    ]
    errors = {(p.series, p.knob["samples"]): p.error["rmse"] for p in part.points}
    assert errors["stratified", 9] < errors["stratified", 4] < errors["stratified", 1] / 1.5
    assert part.noise["reference_error"] < errors["stratified", 9] / 3
    assert all(p.seconds["runs"] == 3 and p.seconds["min"] > 0 for p in part.points)
    [slope] = part.slopes  # strata begin at four: two points are too few for a slope
    assert slope.series == "random" and -1.5 < slope.fitted < 0


# --------------------------------------------------------------------------------------------------- interpolation


def test_interpolation_has_the_orders_of_theory(work):
    """A wrong truth (camera, light, rows upside down) would leave an error that no subdivision lessens."""
    spec = Interpolation(scene="studies/interpolation/sphere.toml", subdivisions=[3, 4, 5], fit_from=3, size=96)
    study = Study(title="x", kind="interpolation", repeats=3, interpolation=spec)
    part = measure_interpolation(study, spec, work, "x")
    slopes = {s.series: s.fitted for s in part.slopes}
    assert slopes == {"flat": pytest.approx(1, abs=0.1), "gouraud": pytest.approx(2, abs=0.2),
                      "phong": pytest.approx(2, abs=0.05)}  # fmt: skip
    finest = {p.series: p for p in part.points if p.knob["subdivisions"] == 5}
    assert finest["phong"].error["rmse"] < 2e-4 < finest["flat"].error["rmse"]
    assert finest["flat"].knob["triangles"] == 20480 and finest["flat"].knob["edge"] == pytest.approx(0.0376, rel=0.01)


# -------------------------------------------------------------------------------------- backends, reports, figures


@pytest.fixture(scope="module")
def backends(tmp_path_factory):
    """One scene, measured once for the tests below."""
    work = Workbench(tmp_path_factory.mktemp("study"), silent)
    study = Study(title="One scene", kind="backends", repeats=3, backends=Backends(assignments=["phong"]))
    gone = tmp_path_factory.mktemp("scene") / "gone.toml"
    phi = read_toml(ROOT / "scenes/phong/phi-0.toml")
    for entry in phi["object"]:
        entry["mesh"] = "gone.obj"
    gone.write_text(tomli_w.dumps(phi))
    scenes = [(load_assignment(PHONG), Scene("phi-0", ROOT / "scenes/phong/phi-0.toml", PHONG))]
    scenes.append((load_assignment(PHONG), Scene("gone", gone, PHONG)))
    part = measure_backends(study, work, scenes, "backends", "phong")
    part.slopes = [Slope("glsl", "size", "2", 1.9, 0.1, "all")]
    part.mark_front()
    machine = {"cpu": "A Processor", "processors": 2, "threads": 1, "level": "v3", "system": "A System",
               "compiler": "g++ 1", "gl": sorted(work.drivers)}  # fmt: skip
    return part, as_json("backends", study, [part], machine, None)


def test_backends_draw_the_same_picture(backends):
    part, _ = backends
    points = {p.series: p for p in part.points}
    assert list(points) == SERIES and all(p.knob == {"scene": "phong/phi-0"} for p in part.points)
    assert points["cpp-double"].error == {"rmse": 0, "max": 0}
    assert 0 < points["cpp-float"].error["rmse"] < 1e-6 and 0 < points["glsl"].error["rmse"] < 1e-4
    assert [o["language"] for o in part.leaving_out] == ["C++", "GLSL"]
    for omission in part.leaving_out:
        assert omission["ratio"] == omission["full"]["median"] / omission["needed"]["median"]
        assert omission["difference"]["max"] < 1e-6 and "terms" in omission["left_out"]
    assert part.skipped and part.skipped[0].startswith("gone: ") and "gone.obj is absent" in part.skipped[0]
    assert len(part.claims) == 2


def test_json_has_the_agreed_shape(backends):
    numbers = json.loads(json.dumps(backends[1], allow_nan=False))
    assert numbers["schema"] == "shadelab/study/1" and numbers["scene"] == "phong"
    assert set(numbers["reference"]) >= {"what", "samples"} and numbers["machine"]["gl"][0].startswith("llvmpipe")
    assert numbers["noise"]["median_spread"] >= 0 and numbers["repeats"] == 3
    for each in numbers["points"]:
        assert set(each) == {"part", "series", "knob", "error", "seconds", "front"}
        assert set(each["seconds"]) == {"median", "min", "max", "runs"} and set(each["error"]) == {"rmse", "max"}
    assert numbers["slopes"][0]["expected"] == "2" and numbers["slopes"][0]["standard_error"] == 0.1


def test_files_and_table(backends, tmp_path):
    part, numbers = backends
    files = write_files(numbers, [part], tmp_path)
    assert {f.name for f in files} == {"study.json", "study.csv"} | {
        f"backends-{ground}.{suffix}" for ground in ("light", "dark") for suffix in ("png", "svg")
    }
    rows = list(csv.DictReader(io.StringIO((tmp_path / "study.csv").read_text())))
    assert [r["series"] for r in rows] == SERIES and rows[0]["scene"] == "phong/phi-0" and rows[0]["runs"] == "3"
    assert float(rows[0]["rmse"]) == numbers["points"][0]["error"]["rmse"]
    output = io.StringIO()
    print_study(numbers, [part], Console(file=output, width=200))
    for text in ("cpp-float-full", "leaving out", "1.900", "Noise:", "A Processor", "skipped gone"):
        assert text in output.getvalue()


def test_figures_of_untimed_and_exact_points(tmp_path):
    from PIL import Image

    points = [point(None, e, "half", q=q) for q, e in ((1, 0.1), (10, 0.2), (100, 0.0))]
    part = Part("x", "title", "", {}, points, knob="q", knob_label="exponent", guides=[Guide("half", 1, "$q$")])
    assert len(plot.panels_of(part)) == 1  # without times there is no panel for them
    files = plot.draw_part(part, tmp_path)
    light, dark = (np.asarray(Image.open(tmp_path / f"x-{g}.png").convert("L"), float) for g in ("light", "dark"))
    assert len(files) == 4 and light.mean() > 200 and dark.mean() < 60


# ------------------------------------------------------------------------------------------------- students' code


def test_students_code_is_measured_in_the_sandbox(submission, tmp_path):
    """It may print what looks like the renderer's answers to some, and gives the same picture."""
    prints = {"#include <shadelab/shading.hpp>": '#include <cstdio>\n#include <shadelab/shading.hpp>\nstatic int once = '
                                                 'std::printf("[1]\\n{\\"ms\\": \\"x\\"}\\nnull\\n");'}  # fmt: skip
    assignment = load_assignment(PHONG)
    view = renderer.View(size="32x32")
    pictures = {}
    for student in (None, submission("phong", cpp=prints)):
        work = Workbench(tmp_path / "work", silent, student)
        loops = work.needs(SMALL_SCENE, assignment).loops
        with work.cpp(SMALL_SCENE, assignment, loops, view=view) as program:
            drawn = program.draw([(0.0, 0.0), (0.25, -0.125)])
            pictures[student] = drawn.image
            assert drawn.seconds > 0
    first, second = pictures.values()
    np.testing.assert_array_equal(first, second)


@pytest.mark.parametrize(
    "does, says",
    [
        ("__builtin_abort();", "crashed with SIGABRT"),
        ("std::exit(0);", "call exit"),
        ("oops;", "'oops' was not declared"),
    ],
)
def test_students_code_that_gives_no_frames(submission, tmp_path, does, says):
    broken = submission("phong", cpp={
        "#include <shadelab/shading.hpp>": "#include <cstdlib>\n#include <shadelab/shading.hpp>",
        "    // STUDENT BEGIN: three terms": f"    if (n.x != 7.0) {does}\n    // STUDENT BEGIN: three terms",
    })  # fmt: skip
    work = Workbench(tmp_path / "work", silent, broken)
    assignment = load_assignment(PHONG)
    loops = work.needs(SMALL_SCENE, assignment).loops
    with pytest.raises(UserError, match=says), work.cpp(SMALL_SCENE, assignment, loops) as program:
        program.draw()


def test_students_glsl_is_measured_in_the_sandbox(submission, tmp_path):
    broken = submission(
        "phong", glsl={"    // STUDENT BEGIN: three terms": "    oops;\n    // STUDENT BEGIN: three terms"}
    )
    assignment = load_assignment(PHONG)
    work = Workbench(tmp_path / "work", silent, broken)
    with pytest.raises(UserError, match="shading.glsl:.*oops"), work.glsl(SMALL_SCENE, assignment):
        pass
    work.student = PHONG
    with work.glsl(SMALL_SCENE, assignment) as program:
        drawn = program.draw()
    assert drawn.seconds > 0 and drawn.image.shape == (*drawn.image.shape[:2], 3) and drawn.image.max() > 0.1
    assert "llvmpipe" in next(iter(work.drivers))


# --------------------------------------------------------------------------------------- declarations, the command


@pytest.mark.parametrize("name", ["supersampling", "interpolation", "backends"])
def test_shipped_studies_are_declared(name):
    assert name in study_names()
    study = load_study(name)
    assert getattr(study, study.kind) is not None and study.title and study.repeats >= 9
    assert studied(name, ["phong"]) == (name, study, None)


def test_interpolation_covers_what_the_course_asks_for():
    assert load_study("interpolation").interpolation.subdivisions == list(range(8))
    assert {1, 64} <= set(load_study("supersampling").sampling.samples)


@pytest.mark.parametrize(
    "text, says",
    [
        ('title = "x"\nkind = "samples"\n', "kind"),
        ('title = "x"\nkind = "sampling"\n', r"the table \[sampling\] is missing"),
        ('title = "x"\nkind = "backends"\n[backends]\n', "names neither"),
        ('title = "x"\nkind = "backends"\n[backends]\nscenes = ["a"]\n[forms]\n', r"\[forms\] does not belong here"),
        ('title = "x"\nkind = "sampling"\n[sampling]\nscene = "a"\nsample = [1]\n', "sampling.sample: extra"),
        (
            'title = "x"\nkind = "interpolation"\n[interpolation]\nscene = "a"\nsubdivisions = [0, 1, 2]\n',
            "three subdivisions",
        ),
    ],
)
def test_mistakes_in_a_declaration_name_file_and_key(tmp_path, monkeypatch, text, says):
    monkeypatch.setattr(declaration, "STUDIES", tmp_path)
    (tmp_path / "mine.toml").write_text(text)
    with pytest.raises(UserError, match=says) as caught:
        load_study("mine")
    assert "mine.toml: " in str(caught.value) and "\n" not in str(caught.value)


def test_what_can_be_studied():
    name, study, scene = studied(str(SMALL_SCENE), ["phong"])
    assert (name, study.kind, scene) == ("phong-sphere", "backends", SMALL_SCENE)
    name, study, scene = studied("phong", ["phong"])
    assert (name, study.backends.assignments, scene) == ("phong", ["phong"], None)


@pytest.mark.parametrize(
    "arguments, says",
    [
        (["nothing"], "is no study (backends"),
        (["scenes/nothing.toml"], "does the file exist?"),
        (["wrong.toml"], "wrong.toml:2: film.width"),
        (["phong", "--shading", "nowhere"], "--shading nowhere: there is no such folder"),
        (["phong", "--json", "nowhere/x.json"], "there is no folder nowhere"),
        (["phong", "--out", "wrong.toml/x"], "choose another folder with --out"),
    ],
)
def test_bad_input_is_one_line(shadelab, tmp_path, arguments, says):
    (tmp_path / "wrong.toml").write_text('[film]\nwidth = "wide"\n')
    done = shadelab("study", *arguments)
    assert done.code == 2 and says in done.stderr and done.stderr.count("\n") == 1 and done.stdout == ""


@pytest.mark.slow
def test_a_scene_from_end_to_end(shadelab, tmp_path):
    scene = (ROOT / "scenes/phong/phi-0.toml").read_text().replace("= 256", "= 24")
    (tmp_path / "tiny.toml").write_text(scene.replace("../meshes", str(ROOT / "scenes/meshes")))
    done = shadelab("study", "tiny.toml", "--json", "-", "--out", "here")
    assert done.code == 0, done.stderr
    numbers = json.loads(done.stdout)
    assert {(p["part"], p["series"]) for p in numbers["points"]} == {
        *(("sampling", s) for s in ("random", "stratified", "regular")), *(("backends", s) for s in SERIES)
    }  # fmt: skip
    assert [s["series"] for s in numbers["slopes"]] == ["random", "stratified"] and len(numbers["leaving_out"]) == 2
    assert numbers["reference"]["samples"] == 4096 and numbers["reference"]["pixels"] == "24x24"
    assert any(p["front"] for p in numbers["points"])
    assert json.loads((tmp_path / "here" / "study.json").read_text()) == numbers
    assert "order of convergence" in done.stderr and "here/sampling-light.png" in done.stderr
