"""The zip for an autograding service: complete, small, with a seed of its own and scripts that run."""

import hashlib
import subprocess
import zipfile

import pytest

from conftest import ROOT
from shadelab.course.assignment import load_assignment
from shadelab.course.toml_files import tomllib
from shadelab.errors import UserError
from shadelab.publish.package import write_package


@pytest.fixture(scope="module")
def phong():
    return load_assignment(ROOT / "solution" / "phong")


@pytest.fixture
def package(phong, tmp_path):
    def write(seed=None):
        file = tmp_path / "phong.zip"
        digest = write_package(phong, "gradescope", file, seed, force=True)
        return digest, zipfile.ZipFile(file)

    return write


def test_contents(package, phong):
    _, archive = package()
    names = set(archive.namelist())
    assert {
        "setup.sh",
        "run_autograder",
        "shadelab/shadelab",
        "shadelab/packages.apt",
        "shadelab/CMakeLists.txt",
    } <= names
    assert {n for n in names if "/" not in n} == {"setup.sh", "run_autograder"}
    top = {n.split("/")[1] for n in names if "/" in n}
    assert not top & {".git", ".shadelab", ".ci", "build", "out", "tests", "docs", "starter"}
    assert {n.split("/")[2] for n in names if n.startswith("shadelab/solution/")} == {"lights", "phong"}
    for file in ("assignment.toml", "shading.cpp", "shading.glsl", "mistakes.toml", "hidden.toml"):
        assert f"shadelab/solution/phong/{file}" in names
    for file in ("mistakes.toml", "hidden.toml", "handout.md"):  # of a given assignment only the code is used
        assert f"shadelab/solution/lights/{file}" not in names
    for scene in phong.public_scenes:
        assert f"shadelab/scenes/phong/{scene.name}.toml" in names
    assert not [n for n in names if "__pycache__" in n or n.endswith((".obj", ".png", ".npz", ".so"))]
    assert sum(i.file_size for i in archive.infolist()) < 4e6


def test_modes(package):
    _, archive = package()
    executable = {i.filename for i in archive.infolist() if i.external_attr >> 16 & 0o111}
    assert executable == {"setup.sh", "run_autograder", "shadelab/shadelab"}


def test_scripts(package, tmp_path):
    _, archive = package()
    for name in ("setup.sh", "run_autograder"):
        text = archive.read(name).decode()
        assert "__" not in text and "\r" not in text and text.startswith("#!/usr/bin/env bash\n")
        done = subprocess.run(["bash", "-n"], input=text, text=True, capture_output=True)
        assert done.returncode == 0, done.stderr


def test_every_package_has_a_seed_of_its_own(package, phong):
    seeds = []
    for _ in range(2):
        digest, archive = package()
        hidden = tomllib.loads(archive.read("shadelab/solution/phong/hidden.toml").decode())
        seeds.append(hidden["seed"])
        assert digest == hashlib.sha256(hidden["seed"].encode()).hexdigest()[:16]
        assert hidden["seed"] != phong.hidden.seed and len(hidden["seed"]) == 32
        assert [f["name"] for f in hidden["family"]] == [f.name for f in phong.hidden.family]
    assert seeds[0] != seeds[1]


@pytest.mark.parametrize("seed", ["autumn 2027", 'with "quotes" and \\ backslash', r"\1 \g<0>", "Umlaute äöü"])
def test_a_seed_of_ones_own(package, seed):
    digest, archive = package(seed)
    hidden = tomllib.loads(archive.read("shadelab/solution/phong/hidden.toml").decode())
    assert hidden["seed"] == seed and digest == hashlib.sha256(seed.encode()).hexdigest()[:16]


def test_the_same_seed_gives_the_same_bytes(phong, tmp_path):
    for name in ("a.zip", "b.zip"):
        write_package(phong, "gradescope", tmp_path / name, "seed", force=True)
    assert (tmp_path / "a.zip").read_bytes() == (tmp_path / "b.zip").read_bytes()
    assert sorted(f.name for f in tmp_path.iterdir()) == ["a.zip", "b.zip"]


def test_bad_input_is_one_line(phong, tmp_path):
    for target, output, seed, said in (
        ("moodle", "a.zip", None, "moodle: is not known; there is gradescope"),
        ("gradescope", "a.tar", None, "must be the name of a .zip file"),
        ("gradescope", "no/such/a.zip", None, "there is no folder"),
        ("gradescope", "a.zip", " ", "--seed: is empty"),
    ):
        with pytest.raises(UserError, match=said):
            write_package(phong, target, tmp_path / output, seed, force=True)
    assert not list(tmp_path.iterdir())


def run_autograder(archive, tmp_path, shadelab):
    """run_autograder with /autograder and /opt moved below tmp_path, and `shadelab` in the place of ours."""
    script = archive.read("run_autograder").decode()
    script = script.replace("/autograder/", f"{tmp_path}/autograder/").replace("/opt/", f"{tmp_path}/opt/")
    (tmp_path / "opt/shadelab").mkdir(parents=True)
    command = tmp_path / "opt/shadelab/shadelab"
    command.write_text(f"#!/usr/bin/env bash\n{shadelab}\n")
    command.chmod(0o755)
    done = subprocess.run(["bash", "-c", script], capture_output=True, text=True, timeout=30)
    return done.returncode, (tmp_path / "autograder/results/results.json").read_text()


def test_our_failure_is_not_the_students(package, tmp_path):
    code, results = run_autograder(package()[1], tmp_path, "exit 3")
    assert code == 0 and "not your submission's fault" in results


def test_what_was_earned_before_a_failure_stays(package, tmp_path):
    ours = 'while [[ $1 != --out ]]; do shift; done; echo "{}" >"$2/results.json"; exit 3'
    assert run_autograder(package()[1], tmp_path, ours) == (0, "{}\n")
