"""A checkout that was set up and cannot be written to: a course's folder on a network disk, a container's layer."""

import json
import os
import subprocess

import pytest

from conftest import ROOT

COSINE = ROOT / "scenes" / "lights" / "cosine.toml"
# In a mount namespace of its own: there alone the checkout is read-only.
CLOSED = 'mount --bind "$0" "$0" && mount -o remount,bind,ro "$0" && exec "$0/shadelab" "$@"'


@pytest.fixture
def closed(tmp_path):
    """Runs ./shadelab of this checkout, which is read-only, in an empty folder and with an empty home."""
    if subprocess.run(["unshare", "-m", "mount", "--bind", ROOT, ROOT], capture_output=True).returncode:
        pytest.skip("a folder can be made read-only by root alone")
    home, work = tmp_path / "home", tmp_path / "work"
    home.mkdir()
    work.mkdir()
    subprocess.run([ROOT / "shadelab", "doctor"], check=True, capture_output=True)  # it was set up

    def run(*arguments, **environment):
        kept = {name: value for name, value in os.environ.items() if name not in ("SHADELAB_ROOT", "XDG_CACHE_HOME")}
        return subprocess.run(
            ["unshare", "-m", "bash", "-c", CLOSED, ROOT, *map(str, arguments)],
            cwd=work, capture_output=True, text=True, timeout=1200, env={**kept, "HOME": str(home), **environment},
        )  # fmt: skip

    return run, home, work


def test_it_grades_renders_and_probes(closed, shadelab):
    run, home, work = closed
    assert shadelab("reference", "lights").code == 0  # as the owner would: it is read from there
    done = run("grade", ROOT / "starter/lights", "--only", "*/function/*", "--out", "graded", "--json", "-")
    assert done.returncode == 0, done.stderr
    assert "reference lights" not in done.stderr and (work / "graded/report.html").is_file()
    assert json.loads(done.stdout)["complete"]
    done = run("render", COSINE, "--backend", "glsl", "-o", "a.png")
    assert done.returncode == 0 and (work / "a.png").is_file(), done.stderr
    done = run("probe", COSINE, "100,111")
    assert done.returncode == 0 and "incident_light" in done.stdout, done.stderr
    [folder] = (home / ".cache/shadelab").iterdir()
    assert folder.name.startswith(f"{ROOT.name}-") and not (folder / "expected").exists()
    said = run("doctor").stdout
    assert str(folder) in said


def test_where_it_writes_can_be_said(closed):
    run, home, work = closed
    done = run("render", COSINE, "-o", "a.png", SHADELAB_STATE="here/state")
    assert done.returncode == 0 and (work / "here/state/plugins").is_dir(), done.stderr
    assert not (home / ".cache").exists()
    done = run("render", COSINE, "-o", "a.png", SHADELAB_STATE=str(ROOT / "nowhere"))
    assert done.returncode == 3 and len(done.stderr.splitlines()) == 1 and "nowhere" in done.stderr
    # An --out in the checkout is refused in one line.
    done = run("grade", ROOT / "starter/lights", "--out", ROOT / "graded")
    assert done.returncode == 2 and "cannot be made: Read-only file system" in done.stderr


@pytest.mark.slow
def test_it_checks(closed):
    run, _, _ = closed
    done = run("check", "lights")
    assert done.returncode == 0 and "0 missed" in done.stdout, done.stdout + done.stderr
