"""./shadelab before and while it sets a machine up. What it calls there is played by stubs, which note their calls."""

import os
import shutil
import subprocess
import time

import pytest

from conftest import ROOT
from shadelab.cli.app import program

# As `python3 -m venv` and its pip, cmake and ninja: they make what set-up looks for.
STUBS = {
    "python3": """
        case "$*" in
        *' -m venv '*)
            for folder; do :; done
            mkdir -p "$folder/bin" "$folder/lib/python3.99/site-packages"
            cp "$0" "$folder/bin/python" ;;
        *' -m pip '*) echo "pip $*" >>"$CALLS"; sleep "${SLOW:-0}" ;;
        *' -m shadelab '*) echo "ran ${@:4}" ;;
        -V) echo Python 3.99 ;;
        esac""",
    "cmake": 'mkdir -p build && touch build/build.ninja && echo "CMAKE_HOME_DIRECTORY:INTERNAL=$PWD" >build/CMakeCache.txt',
    "ninja": 'echo "ninja $2" >>"$CALLS"',
    "g++": "echo 99",
}


@pytest.fixture
def made(tmp_path):
    """made(name, release): a checkout with little in it, and a way to call its ./shadelab: (what ran, what set-up called)."""
    stubs, calls = tmp_path / "stubs", tmp_path / "calls"
    stubs.mkdir()
    for name, text in STUBS.items():
        (stubs / name).write_text(f"#!/usr/bin/env bash\n{text}\n")
        (stubs / name).chmod(0o755)

    def make(name, release):
        folder = tmp_path / name
        (folder / "framework").mkdir(parents=True)
        (folder / "framework/a.hpp").touch()
        script = folder / "shadelab"
        script.write_text((ROOT / "shadelab").read_text().replace("/usr/bin/python3", str(stubs / "python3")))
        script.chmod(0o755)
        shutil.copytree(ROOT / "grader/shadelab/cli", folder / "grader/shadelab/cli")
        (folder / "packages.apt").write_text("bash\n")
        for file in ("pyproject.toml", "CMakeLists.txt", "CMakePresets.json", *(["release.json"] if release else [])):
            (folder / file).touch()

        def run(*arguments, **environment):
            calls.write_text("")
            environment = {
                "HOME": str(tmp_path / "home"),
                "PATH": f"{stubs}:/usr/bin:/bin",
                "CALLS": str(calls),
                **environment,
            }
            done = subprocess.run([folder / "shadelab", *arguments], capture_output=True, text=True, env=environment)
            assert done.returncode == 0, done.stderr
            run.stderr = done.stderr
            return done.stdout, calls.read_text().splitlines()

        run.folder = folder
        return run

    return make


def used(calls, program):
    return [call for call in calls if call.startswith(program)]


def test_releases_of_a_version_are_set_up_once(made, tmp_path):
    first, second = made("first", True), made("second", True)
    out, calls = first("grade", "phong")
    assert out == "ran grade phong\n" and used(calls, "pip") and used(calls, "ninja")
    out, calls = second("grade", "lights")
    assert out == "ran grade lights\n" and calls == []
    for release in (first, second):
        [paths] = release.folder.glob(".shadelab/venv/lib/*/site-packages/shadelab.pth")
        own, shared = paths.read_text().splitlines()
        assert own == str(release.folder / "grader") and shared.startswith(
            str(tmp_path / "home/.cache/shadelab/python-")
        )
        assert (release.folder / "build").resolve().is_relative_to(tmp_path / "home/.cache/shadelab")
    # Another framework is built, and changes nothing for the other release; the packages serve both.
    before = (first.folder / "build").resolve()
    (second.folder / "framework/a.hpp").write_text("// changed")
    _, calls = second("doctor")
    assert used(calls, "ninja") and not used(calls, "pip")
    assert (first.folder / "build").resolve() == before != (second.folder / "build").resolve()
    assert first("doctor")[1] == []
    # Whoever clears the cache pays with a set-up, and nothing else.
    shutil.rmtree(tmp_path / "home/.cache")
    _, calls = first("doctor")
    assert used(calls, "pip") and used(calls, "ninja") and first("doctor")[1] == []


def test_a_release_whose_cache_cannot_be_made_is_set_up_alone(made, tmp_path):
    alone = made("alone", True)
    (tmp_path / "home").write_text("no folder")
    _, calls = alone("doctor")
    assert used(calls, "pip") and (alone.folder / "build/CMakeCache.txt").is_file()
    assert not (alone.folder / "build").is_symlink()
    assert not used(alone("doctor")[1], "pip")


def test_what_one_command_needs_is_installed_with_it(made):
    """Who only grades does not get the packages of studies and tests."""
    checkout = made("checkout", False)
    _, calls = checkout("grade", "starter/phong")
    assert used(calls, "pip") and not any("[" in call for call in calls)
    for command, extras in (("study", "[study]"), ("test", "[test,study]"), ("study", None), ("grade", None)):
        _, calls = checkout(command)
        assert [
            call for call in used(calls, "pip") if "-e" in call and extras and call.endswith(extras)
        ] or not extras, calls
        assert extras or not used(calls, "pip")


def test_set_up_tells_every_few_seconds_where_it_is(made):
    checkout = made("checkout", False)
    checkout("grade", SLOW="5.5")
    assert "shadelab:   5 s: " in checkout.stderr


def test_help_before_set_up(made):
    checkout = made("checkout", False)
    (checkout.folder / "tests").mkdir()
    start = time.monotonic()
    for arguments in (["--help"], [], ["grade", "--help"]):
        out, calls = checkout(*arguments)
        assert calls == [] and not (checkout.folder / ".shadelab").exists() and "./shadelab grade" in out
    assert time.monotonic() - start < 3
    listed = [line.split()[0] for line in out.splitlines() if line.startswith("   ") and not line.startswith("    ")]
    names = [command.name or command.callback.__name__ for command in program().registered_commands]
    assert listed == names
    checkout("doctor")
    assert checkout("--help")[0] == "ran --help\n"


def test_help_of_a_release_lists_what_it_has(made):
    release = made("release", True)
    for name in ("course.py", "measuring.py", "release.py"):
        (release.folder / "grader/shadelab/cli" / name).unlink()
    (release.folder / "README.md").write_text("\n    ./shadelab grade soft_light\n")
    out, calls = release("--help")
    assert calls == [] and "     ./shadelab grade soft_light\n" in out
    assert "   doctor " in out and not any(f"   {name} " in out for name in ("check", "package", "bench", "test"))
    assert not os.path.exists(release.folder / ".shadelab")
