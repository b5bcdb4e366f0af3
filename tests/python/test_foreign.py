"""Other people's machines: installations of another user, environments, terminals and paths that nobody thought of."""

import json
import os
import re
import shlex
import shutil
import subprocess
import sys
import tempfile
from pathlib import Path

import pytest

from conftest import ROOT

QUICK = ["--only", "*/build", "--only", "*/function/half_vector", "--only", "*/image/sphere", "--no-html"]


# --- An installation that another user made ---


@pytest.fixture
def elsewhere():
    """A folder below which everyone may look: pytest's own is closed to other users."""
    folder = Path(tempfile.mkdtemp(prefix="shadelab-test-"))
    folder.chmod(0o755)
    yield folder
    subprocess.run(["chmod", "-R", "u+w", folder], check=True)
    shutil.rmtree(folder)


@pytest.fixture
def as_another_user(elsewhere):
    """Runs a command in a checkout that belongs to someone else: by a user without rights, or where we are none with ours."""
    checkout, home = elsewhere / "checkout", elsewhere / "home"
    checkout.mkdir()
    home.mkdir()
    for entry in ROOT.iterdir():
        if entry.name != ".shadelab":
            (checkout / entry.name).symlink_to(entry)
    other = os.getuid() == 0
    user = ["setpriv", "--reuid", "65534", "--regid", "65534", "--clear-groups"] if other else []
    if other:
        os.chown(home, 65534, 65534)
        if subprocess.run([*user, sys.executable, "-I", "-c", "import shadelab"], capture_output=True).returncode:
            pytest.skip("other users cannot read this checkout")
    (checkout / ".shadelab").mkdir(exist_ok=True)

    def run(*words):
        for folder in (checkout, *checkout.glob(".shadelab/**")):
            folder.chmod(0o555)
        environment = {"PATH": os.environ["PATH"], "HOME": str(home), "SHADELAB_ROOT": str(checkout)}
        command = [*user, sys.executable, "-I", "-m", "shadelab", *map(str, words)]
        return subprocess.run(command, cwd=home, env=environment, capture_output=True, text=True, timeout=600)

    run.checkout, run.home = checkout, home
    return run


def test_an_installation_of_another_user_works(as_another_user):
    done = as_another_user("eval", ROOT / "solution" / "phong", "half_vector", "--set", "l=0,0,1", "--set", "v=0,0,1")
    assert done.returncode == 0 and "result = (0, 0, 1)" in done.stdout, done.stderr
    assert list(as_another_user.home.glob(".cache/shadelab/*/plugins/*.so"))


@pytest.mark.skipif(os.getuid() != 0, reason="only root can leave files of another user behind")
def test_files_that_sudo_left_behind_are_named(as_another_user):
    state = as_another_user.checkout / ".shadelab"
    os.chown(state, 65534, 65534)
    (state / "glue").mkdir()
    state.chmod(0o755)
    run = as_another_user
    (state / "glue").chmod(0o555)
    command = ["eval", ROOT / "solution" / "phong", "half_vector", "--set", "l=0,0,1", "--set", "v=0,0,1"]
    os.environ["SHADELAB_ROOT"], before = str(run.checkout), os.environ["SHADELAB_ROOT"]
    try:
        done = subprocess.run(
            ["setpriv", "--reuid", "65534", "--regid", "65534", "--clear-groups", sys.executable, "-I", "-m", "shadelab", *map(str, command)],
            capture_output=True, text=True, cwd=run.home,
        )  # fmt: skip
    finally:
        os.environ["SHADELAB_ROOT"] = before
    assert done.returncode == 3 and done.stderr.count("\n") == 1
    assert f"{state}/glue: belongs to another user" in done.stderr and "sudo chown" in done.stderr


# --- Environments ---

POISON = "raise SystemExit('poisoned')\n"


@pytest.mark.parametrize(
    "changes",
    [
        {"HOME": None},
        {"HOME": "/nonexistent"},
        {"LC_ALL": "C", "LANG": "C", "PYTHONUTF8": "0", "PYTHONCOERCECLOCALE": "0"},
        {"TMPDIR": "/nonexistent"},
        {"TMPDIR": "{tmp}/t mp #ü"},
        {"DISPLAY": ":99", "WAYLAND_DISPLAY": "wayland-7", "XDG_RUNTIME_DIR": "/nonexistent"},
        {
            "LIBGL_ALWAYS_SOFTWARE": "0",
            "GALLIUM_DRIVER": "softpipe",
            "MESA_GL_VERSION_OVERRIDE": "2.1",
            "MESA_GLSL_VERSION_OVERRIDE": "120",
        },
        {
            "CXX": "clang++-99",
            "CXXFLAGS": "-O0 -ffast-math",
            "LDFLAGS": "-static",
            "CPATH": "/nonexistent",
            "GCC_EXEC_PREFIX": "/nonexistent/",
        },
        {"PYTHONPATH": "{tmp}/poison", "PYTHONHOME": "/nonexistent", "VIRTUAL_ENV": "/x"},
        {"PYTHONIOENCODING": "ascii", "PYTHONWARNINGS": "error"},
        {"TERM": "dumb", "NO_COLOR": "1", "COLUMNS": "20"},
        {"FORCE_COLOR": "1", "CLICOLOR_FORCE": "1", "COLUMNS": "0"},
        {"OMP_NUM_THREADS": "0", "OMP_SCHEDULE": "foo", "GOMP_CPU_AFFINITY": "99"},
        {"TZ": "Foo/Bar", "LC_ALL": "de_DE.UTF-8"},
    ],
    ids=lambda changes: "-".join(changes),
)
def test_a_foreign_environment_costs_nothing(tmp_path, changes):
    (tmp_path / "t mp #ü").mkdir()
    (tmp_path / "poison").mkdir()
    for name in ("numpy.py", "json.py"):
        (tmp_path / "poison" / name).write_text(POISON)
    environment = {name: value for name, value in os.environ.items() if changes.get(name, "") is not None}
    environment |= {name: value.format(tmp=tmp_path) for name, value in changes.items() if value is not None}
    command = [
        sys.executable,
        "-I",
        "-m",
        "shadelab",
        "grade",
        ROOT / "solution" / "phong",
        *QUICK,
        "--out",
        tmp_path / "out",
    ]
    done = subprocess.run([*map(str, command)], cwd=tmp_path, env=environment, capture_output=True, timeout=600)
    assert done.returncode == 0 and b"Traceback" not in done.stderr, done.stderr.decode()
    result = json.loads((tmp_path / "out" / "result.json").read_text())
    assert result["score"] == result["max_score"] > 0


def test_a_umask_costs_nothing(tmp_path):
    command = [
        sys.executable,
        "-I",
        "-m",
        "shadelab",
        "grade",
        ROOT / "solution" / "phong",
        *QUICK,
        "--out",
        tmp_path / "out",
    ]
    done = subprocess.run(
        ["bash", "-c", 'umask 077; exec "$@"', "bash", *map(str, command)], capture_output=True, timeout=600
    )
    assert done.returncode == 0


# --- Paths ---


def test_odd_paths_are_quoted_where_they_are_to_be_copied(shadelab, tmp_path):
    folder, out = tmp_path / "my shading #1 ü", tmp_path / "o ut #ü"
    shutil.copytree(ROOT / "starter" / "phong", folder)
    file = folder / "shading.cpp"
    file.write_text(file.read_text().replace("0.5 * m.kd", "0.4 * m.kd"))  # begun
    done = shadelab("grade", folder, "--only", "cpp/function/phong", "--out", out, COLUMNS="400")
    assert done.code == 0
    [line] = re.findall(r"^ +(\./shadelab eval .*)$", done.stdout, re.MULTILINE)
    words = shlex.split(line)
    assert (
        Path(tmp_path / words[2]).resolve() == folder
        and Path(tmp_path / words[-1]).resolve() == out / "worst" / "cpp-phong.npz"
    )
    again = shadelab(*words[1:])
    assert again.code == 0 and "result.ambient" in again.stdout


# --- Systems that start it ---


def test_the_shipped_workflow_annotates_what_does_not_compile(submission, tmp_path):
    """Its own command line, which hands on little of the environment."""
    head = "vec3 half_vector(vec3 l, vec3 v) {"
    folder = submission(cpp={head: head + " nonsense"})
    (folder / "assignment.toml").write_text('name = "phong"\n')
    script = tmp_path / "shadelab"
    script.write_text(f'#!/bin/sh\nSHADELAB_ROOT={ROOT} exec {sys.executable} -I -m shadelab "$@"\n')
    script.chmod(0o755)
    workflow = (ROOT / "grader/shadelab/publish/templates/release/_github/workflows/grade.yml").read_text()
    [line] = re.findall(r"run: (.* grade .*)", workflow)
    line = line.replace("__NAME__", "submission") + " --only '*/build'"
    environment = {**os.environ, "GITHUB_ACTIONS": "true"}
    done = subprocess.run(["bash", "-e", "-c", line], cwd=tmp_path, capture_output=True, text=True, env=environment)
    assert done.returncode == 0 and done.stderr.count("::error file=submission/shading.cpp,line=") >= 1


def test_every_test_of_gradescope_has_a_status(shadelab, tmp_path):
    done = shadelab("grade", ROOT / "solution" / "phong", *QUICK, "--format", "gradescope", "--out", tmp_path / "out")
    tests = json.loads((tmp_path / "out" / "results.json").read_text())["tests"]
    assert done.code == 0 and {test["status"] for test in tests} == {"passed"}
    assert any(test["max_score"] == 0 for test in tests)
