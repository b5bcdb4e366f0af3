"""What gives points, and how many; and what a result may say."""

import json
import shutil
from types import ModuleType

import numpy as np
import pytest

from conftest import ROOT
from shadelab.course.assignment import assignment_names, load_assignment
from shadelab.course.mistakes import regions, with_bodies
from shadelab.evidence.tasks import Evaluate
from shadelab.grading import kinds, planning
from shadelab.grading.grade import grade
from shadelab.grading.kinds import image
from shadelab.grading.pictures import PictureFolder
from shadelab.grading.planning import plan_checks
from shadelab.grading.worst import write_worst_inputs
from shadelab.judge.credit import FAR, LITTLE, MISTAKE, NEAR, NO_MARKS, credit, size_of
from shadelab.judge.functions import judge_function
from shadelab.report.formats.registry import FORMATS, write_format
from shadelab.report.html.page import write_html
from shadelab.result import Worst
from shadelab.truth.expected import Table

PHONG = load_assignment(ROOT / "solution" / "phong")
SEED = "the-seed-that-nobody-reads-8341"
every_assignment = pytest.mark.parametrize(
    "assignment", [load_assignment(ROOT / "solution" / name) for name in assignment_names()], ids=lambda a: a.name
)


def test_the_curve_of_partial_credit():
    shares = np.concatenate([[0], np.geomspace(1e-6, 1, 500)])
    curve = np.array([credit(share) for share in shares])
    assert (np.diff(curve) <= 0).all() and (curve >= 0).all()
    assert (curve <= 1 - MISTAKE).all() and MISTAKE >= 0.25  # whatever is wrong loses something
    assert credit(1e-6) == credit(LITTLE) == 1 - MISTAKE
    assert credit(1e-2) == pytest.approx(credit(LITTLE) / 2)
    assert credit(0.99 * NO_MARKS) > 0 == credit(NO_MARKS) == credit(1.0)
    assert NO_MARKS == 0.1


def test_what_is_off_by_little_keeps_as_much_as_what_is_off_in_few_places():
    assert credit(1.0, 1e-4) == credit(1.0, NEAR) == 1 - MISTAKE
    assert credit(1.0, 1e-2) == pytest.approx(credit(1e-2)) and credit(1.0, FAR) == credit(1.0, np.inf) == 0
    assert credit(1e-2, 1e-3) == 1 - MISTAKE and credit(1e-3, 1.0) == 1 - MISTAKE  # whichever leaves more
    # Nine in ten are off by at most the size: few that are near do not make the rest near.
    assert size_of(np.array([1e-3] * 89 + [1.0] * 11)) == 1.0 and size_of(np.array([1e-3] * 99 + [np.inf])) == 1e-3


@pytest.mark.parametrize("wrong, share", [(0, 1.0), (1, 0.75), (4, 0.75), (41, 0.37), (409, 0.0), (4096, 0.0)])
def test_points_of_a_function(wrong, share):
    rows = np.zeros((4096, 6), np.float32)
    truth = np.ones((4096, 3))
    actual = truth.astype(np.float32)
    actual[:wrong] *= 2
    table = Table(rows, truth, np.zeros_like(truth), len(rows))
    check = judge_function(PHONG.function("half_vector"), "cpp", 4.0, table, 0.0, actual).check
    assert check.score == pytest.approx(4 * share, abs=0.03) and check.max_score == 4
    assert (check.status == "passed") == (wrong == 0) == (check.score == check.max_score)


@every_assignment
def test_points_come_from_the_manifest_and_half_of_them_from_each_language(assignment):
    plans = plan_checks(assignment)
    points = {backend: sum(p.points for p in chain) for backend, chain in plans.items()}
    assert points == {"cpp": assignment.points / 2, "glsl": assignment.points / 2, "both": 0}
    everything = [p for chain in plans.values() for p in chain]
    assert len({p.id for p in everything}) == len(everything)
    assert sum(p.points for p in everything if p.kind == "image") >= 0.4 * assignment.points
    for function in assignment.functions:
        of_it = [p.points for p in everything if p.item is function and p.kind == "function"]
        assert of_it == ([function.points / 2] * 2 if function.graded else [])


# ------------------------------------------------------------------------- a small assignment with a seed of its own


@pytest.fixture(scope="module")
def small(tmp_path_factory):
    """Phong with two scenes, one of them drawn from SEED, and a submission with a wrong half vector and a wrong lobe."""
    folder = tmp_path_factory.mktemp("small")
    for name in ("lights", "phong"):
        shutil.copytree(ROOT / "solution" / name, folder / "solution" / name)
    shutil.copytree(ROOT / "scenes" / "phong", folder / "scenes" / "phong")
    (folder / "scenes" / "meshes").symlink_to(ROOT / "scenes" / "meshes")
    own = folder / "solution" / "phong"
    (own / "mistakes.toml").unlink()  # to evaluate them takes the most time, and names what is not asked for here
    manifest = (own / "assignment.toml").read_text().split("[[scene]]")[0]
    (own / "assignment.toml").write_text(manifest + '[[scene]]\nfile = "../../scenes/phong/knot.toml"\npoints = 20\n')
    (own / "hidden.toml").write_text(
        f'seed = "{SEED}"\n[[family]]\nname = "knots"\nbase = "../../scenes/phong/knot.toml"\npoints = 20\n'
        'vary = [{ key = "light[0].position", low = [1, 1, 1], high = [2, 3, 4] }]\n'
    )
    submission = folder / "submission"
    submission.mkdir()
    for file in PHONG.files:
        text = (own / file).read_text()
        changed = {"half_vector": "return 0.5 * (l + v);"}
        assert set(changed) <= set(regions(text, own / file))
        (submission / file).write_text(with_bodies(text, own / file, changed))
    return load_assignment(own), submission


@pytest.fixture(scope="module")
def gradings(small, tmp_path_factory):
    """The same twice, with all reports, the second time with pictures of hidden scenes; (Grading, folder) each."""
    assignment, submission = small
    out = []
    for hidden_pictures in (False, True):
        folder = tmp_path_factory.mktemp("out")

        def rewrite(result, folder=folder):
            for name in FORMATS:
                write_format(name, result, folder)

        grading = grade(
            assignment,
            submission,
            folder,
            only="*/[fip]*/*[hk][an][lo]*",
            rewrite=rewrite,
            hidden_pictures=hidden_pictures,
        )
        write_worst_inputs(assignment, grading.result, submission, folder)
        rewrite(grading.result)
        write_html(grading.result, grading.pictures, folder / "report.html", assignment.title)
        out.append((grading, folder))
    return out


def test_grading_twice_gives_the_same(gradings):
    def comparable(folder):
        data = json.loads((folder / "result.json").read_text())
        for check in data["checks"]:
            assert {"seconds", "runs"} <= set(check)
            del check["seconds"], check["runs"]
            if check["worst"]:
                check["worst"]["replay"] = check["worst"]["replay"].replace(str(folder), "OUT")
        return data

    one, two = (comparable(folder) for _, folder in gradings)
    assert one == two and one["complete"]
    status = {c["id"]: c["status"] for c in one["checks"]}
    assert status["cpp/image/knot"] == status["glsl/image/hidden-knots"] == "failed"


def test_nothing_tells_the_seed(gradings, small):
    assignment, _ = small
    grading, folder = gradings[0]
    assert grading.result.environment["seed_digest"] == assignment.hidden.seed_digest
    assert grading.result.environment["level"] in ("plain", "v2", "v3", "v4")
    assert SEED not in assignment.hidden.seed_digest and len(assignment.hidden.seed_digest) >= 16
    files = [f for f in folder.rglob("*") if f.is_file()]
    assert {"result.json", "report.html"} < {f.name for f in files}
    assert {made.file for made in FORMATS.values()} <= {f.name for f in files if f.parent == folder}
    for file in files:
        assert SEED.encode() not in file.read_bytes(), file.name


def test_hidden_scenes_are_marked_in_the_result_and_left_out_of_reports(gradings):
    grading, folder = gradings[0]
    hidden = {c.id: c for c in grading.result.checks if c.hidden}
    assert set(hidden) == {"cpp/image/hidden-knots", "glsl/image/hidden-knots"}
    page = (folder / "report.html").read_text()
    for check in hidden.values():
        assert check.status == "failed" and check.message and check.worst
        assert check.message not in page
        for value in check.worst.expected:  # the visible knot has other lights, and no such number
            assert f"{value:.6g}" not in page


def test_a_graded_folder_holds_no_picture_of_a_hidden_scene_unless_asked(gradings):
    kept = [{f.stem for f in (folder / "evidence").rglob("*.np?")} for _, folder in gradings]
    assert kept == [{"knot"}, {"knot", "hidden-knots"}]
    assert [set(grading.pictures) for grading, _ in gradings] == [
        {"cpp/image/knot", "glsl/image/knot"},
        {"cpp/image/knot", "glsl/image/knot", "cpp/image/hidden-knots", "glsl/image/hidden-knots"},
    ]


@pytest.mark.parametrize("together", [True, False])
def test_a_new_kind_of_check_is_a_module_and_a_line_of_a_list(small, together, monkeypatch, tmp_path):
    """One that evaluates beside those that draw, with a worst input: grading and all reports know what to do with it."""
    kind = ModuleType("repeat")
    kind.NAME, kind.STAGE, kind.TOGETHER, kind.DRAWS, kind.REPLAY, kind.BOTH = (
        "repeat",
        image.STAGE,
        together,
        False,
        "",
        False,
    )
    kind.items = lambda assignment: [(f.name, 0.0, f) for f in assignment.functions if f.name == "half_vector"]

    def judge(plan, ledger):
        rows = ledger.expected.table(plan.item).rows
        one = yield Evaluate(plan.item, rows)
        two = yield Evaluate(plan.item, rows)
        assert one.array is not None and np.array_equal(one.array, two.array)
        check = plan.check("failed", "is the same twice")
        check.worst = Worst(inputs={"n": [0.0, 0.0, 1.0]}, expected=[1.0], actual=[2.0])
        return check

    kind.judge = judge
    monkeypatch.setattr(kinds, "KINDS", [*kinds.KINDS, kind])
    monkeypatch.setattr(planning, "KINDS", kinds.KINDS)
    assignment, submission = small
    grading = grade(assignment, submission, tmp_path, only="*/[ir][me]*/*[hk][an][lo]*")
    write_worst_inputs(assignment, grading.result, submission, tmp_path)
    found = {c.id: c for c in grading.result.checks}
    for backend in ("cpp", "glsl"):
        repeated, drawn = found[f"{backend}/repeat/half_vector"], found[f"{backend}/image/knot"]
        assert (repeated.status, repeated.message, repeated.worst.replay) == ("failed", "is the same twice", "")
        assert drawn.status == "failed" and "of the interior pixels" in drawn.message  # drawn, and judged
    write_html(grading.result, grading.pictures, tmp_path / "report.html", assignment.title)
    for text in [(tmp_path / "report.html").read_text(), *(made.text(grading.result) for made in FORMATS.values())]:
        assert "is the same twice" in text or "repeat" in text


def test_of_a_scene_that_both_languages_have_right_the_total_is_kept(tmp_path):
    """All terms are of use where something is wrong; and 13 channels are 14 MB a picture."""
    kept, layers = PictureFolder(tmp_path, kept=True), np.ones((2, 2, 13), np.float32)
    # p passed, f failed, n failed without a picture
    for scene, verdicts in {"a": "pp", "b": "pf", "c": "fp", "d": "ff", "e": "p", "f": "pn", "g": "np"}.items():
        for backend, verdict in zip(("cpp", "glsl"), verdicts):
            kept.keep(backend, scene, None if verdict == "n" else layers, verdict != "p")
    assert not kept.file("cpp", "e").exists()  # the other language may still fail
    kept.flush()
    channels = {f"{f.parent.name}/{f.stem}": np.load(f).shape[-1] for f in tmp_path.rglob("*.npy")}
    assert channels == {
        "cpp/a": 3, "glsl/a": 3, "cpp/b": 13, "glsl/b": 13, "cpp/c": 13, "glsl/c": 13, "cpp/d": 13, "glsl/d": 13, "cpp/e": 3,
        "cpp/f": 13, "glsl/g": 13,
    }  # fmt: skip


def test_a_graded_folder_shares_no_file_with_the_expected_data(gradings, small):
    """Whoever empties one in out/ must not spoil the truth of all later gradings."""
    kept = [f for _, folder in gradings for f in (folder / "evidence").rglob("*") if f.is_file()]
    assert len(kept) > 8 and all(f.stat().st_nlink == 1 for f in kept)


def test_damaged_evidence_is_one_line(gradings, shadelab, tmp_path):
    """Cut, emptied or something else: `report` names the file, says what to do, and shows no traceback."""
    folder = tmp_path / "graded"
    shutil.copytree(gradings[0][1], folder)
    first = shadelab("report", folder)
    assert first.code == 0 and (folder / "report.html").exists(), first.stderr
    damage = {
        "evidence/cpp/knot.npy": [b"", b"junk", None],
        "evidence/expected/knot.npz": [b"", b"junk", None],
        "evidence/expected/knot.json": [b"", b"[]", b"{}", None],
        "evidence/about.json": [b"", b"[]", b"{}"],
        "result.json": [b"", b"[]", b"{}", (folder / "result.json").read_bytes().replace(b"result/1", b"result/9")],
    }
    for name, contents in damage.items():
        file = folder / name
        whole = file.read_bytes()
        for content in contents:
            file.write_bytes(whole[: len(whole) // 2] if content is None else content)
            done = shadelab("report", folder)
            assert done.code == 2 and file.stem in done.stderr and len(done.stderr.splitlines()) == 1, done.stderr
        file.write_bytes(whole)
    done = shadelab("report", folder / "result.json")
    assert done.code == 2 and "give a folder" in done.stderr
