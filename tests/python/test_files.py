"""A disk that is full or cannot be written to: one line names the file, and no half of it stays. Two gradings in one folder."""

import os
import signal
import subprocess
import sys

import pytest

from conftest import ROOT
from shadelab.errors import UserError
from shadelab.files import alone_in, whole
from shadelab.result import Check, Result

COSINE = ROOT / "scenes" / "lights" / "cosine.toml"


@pytest.fixture
def disk(tmp_path):
    """disk(options): a small disk, mounted at the same place again after each call."""
    place = tmp_path / "disk"
    place.mkdir()

    def mount(options: str):
        subprocess.run(["umount", place], capture_output=True)
        if subprocess.run(["mount", "-t", "tmpfs", "-o", options, "none", place], capture_output=True).returncode:
            pytest.skip("a disk can be mounted by root alone")
        return place

    yield mount
    subprocess.run(["umount", place], capture_output=True)


def graded(folder):
    """As grade leaves it, but for the pictures: a report of some size."""
    folder.mkdir()
    result = Result(assignment="lights", submission="sha256:0", complete=True, max_score=200)
    for number in range(200):
        check = Check(
            id=f"cpp/function/f{number}", kind="function", backend="cpp", status="failed", score=0, max_score=1, message="wrong " * 20
        )  # fmt: skip
        result.add(check)
    result.write(folder / "result.json")
    return folder


@pytest.mark.parametrize(
    "name, file", [("markdown", "summary.md"), ("junit", "junit.xml"), ("gradescope", "results.json")]
)
def test_a_report_that_does_not_fit_leaves_the_former_one(tmp_path, name, file):
    folder = graded(tmp_path / "out")
    (folder / file).write_text("the former one")
    # -B: Python does not notice that a module which it compiles is cut off, and could not load it afterwards.
    command = ["bash", "-c", 'ulimit -S -f 8; exec "$@"', "-", sys.executable, "-I", "-B", "-m", "shadelab"]
    done = subprocess.run([*command, "report", folder, "--format", name], capture_output=True, text=True, cwd=tmp_path)
    assert done.returncode == 3 and done.stderr == f"out/{file}: File too large; make room, or write elsewhere\n"
    assert (folder / file).read_text() == "the former one" and len(list(folder.iterdir())) == 2


def commands(place):
    """What writes, and the file that it is to write."""
    return {
        place / "a.npy": ["render", COSINE, "-o", place / "a.npy"],
        place / "b.npy": ["render", COSINE, "--backend", "glsl", "-o", place / "b.npy"],
        place / "a.packet": ["render", ROOT / "scenes/phong/knot.toml", "--packet", place / "a.packet"],
        place / "a.zip": ["package", "lights", "--for", "gradescope", "--force", "-o", place / "a.zip"],
        place / "a.json": ["probe", COSINE, "100,111", "--json", place / "a.json"],
    }


@pytest.mark.parametrize(
    "options, said",
    [
        ("size=4k", r"; make room, or write elsewhere"),
        ("size=4k,ro", r"Read-only file system; write elsewhere: --out, or -o, says where"),
    ],
)
def test_a_full_or_closed_disk_is_one_line_that_names_the_file(shadelab, disk, options, said):
    place = disk(options)
    for file, command in commands(place).items():
        done = shadelab(*command)
        last = done.stderr.splitlines()[-1]
        assert done.code == 3 and last.startswith(f"disk/{file.name}: ") and last.endswith(said), done.stderr
        assert "Traceback" not in done.stderr and list(place.iterdir()) == []


@pytest.mark.slow
def test_a_release_that_does_not_fit_leaves_nothing(shadelab, disk):
    place = disk("size=1m")
    done = shadelab("release", "lights", "--out", place / "lights")
    assert done.code == 3 and "Traceback" not in done.stderr
    assert done.stderr.splitlines()[-1].startswith("disk/lights/") and ".making-" not in done.stderr
    assert list(place.iterdir()) == []


def test_a_grading_on_a_full_disk_keeps_its_last_whole_result(shadelab, disk):
    place = disk("size=12k")
    done = shadelab("grade", ROOT / "starter/lights", "--only", "*/function/*", "--out", place / "out")
    last = done.stderr.splitlines()[-1]
    assert done.code == 3 and "disk/out/" in last and last.endswith("; make room, or write elsewhere"), done.stderr
    assert not [f for f in (place / "out").iterdir() if f.name.startswith(".")]


def test_what_stands_there_stays_until_the_new_one_is_whole(tmp_path):
    file = tmp_path / "a.txt"
    file.write_text("old")
    with pytest.raises(ZeroDivisionError), whole(file) as part:
        part.write_text("half")
        assert file.read_text() == "old" and part.suffix == ".txt"
        1 / 0  # noqa: B018
    assert file.read_text() == "old" and list(tmp_path.iterdir()) == [file]


def test_two_gradings_in_one_folder(shadelab, tmp_path):
    out = graded(tmp_path / "out")
    before = (out / "result.json").read_bytes()
    with alone_in(out):
        for command in (["grade", ROOT / "starter/lights", "--out", out], ["report", out]):
            done = shadelab(*command)
            assert done.code == 2 and done.stderr == (
                "out: another grading is writing there; wait until it is done, or choose another folder with --out\n"
            )
        assert (out / "result.json").read_bytes() == before and len(list(out.iterdir())) == 1
    assert shadelab("report", out).code == 0


def test_the_lock_does_not_outlive_who_holds_it(tmp_path):
    code = f"import time; from pathlib import Path; from shadelab.files import alone_in\nwith alone_in(Path({str(tmp_path)!r})): print('held', flush=True); time.sleep(60)"
    holder = subprocess.Popen([sys.executable, "-I", "-c", code], stdout=subprocess.PIPE, text=True)
    assert holder.stdout.readline() == "held\n"
    with pytest.raises(UserError, match="another grading"), alone_in(tmp_path):
        pass
    os.kill(holder.pid, signal.SIGKILL)
    holder.wait()
    holder.stdout.close()
    with alone_in(tmp_path):
        assert list(tmp_path.iterdir()) == []  # no file that somebody would have to remove
