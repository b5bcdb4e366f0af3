"""doctor: what this machine can do, and how to mend what it can't."""

import json
import os
import platform
import shutil
import subprocess
import sys
from dataclasses import dataclass
from pathlib import Path

from shadelab.course.assignment import assignment_names, load_assignment
from shadelab.course.hidden import draw_hidden_scenes
from shadelab.gl.environment import ENVIRONMENT
from shadelab.machine.processor import processor_level
from shadelab.paths import RENDER, SET_UP, SOLUTION, STATE, shown


@dataclass
class Finding:
    what: str
    state: str  # ok | note | bad
    says: str
    mend: str = ""


def examine() -> list[Finding]:
    out = [Finding("system", "ok", f"{platform.platform()}, Python {platform.python_version()}")]
    compiler = shutil.which("g++")
    if compiler:
        version = subprocess.run([compiler, "--version"], capture_output=True, text=True).stdout.splitlines()[0]
        out.append(Finding("C++ compiler", "ok", version))
    else:
        out.append(Finding("C++ compiler", "bad", "g++ is missing", "install the package g++"))
    chosen = " (SHADELAB_LEVEL)" if os.environ.get("SHADELAB_LEVEL") else ""
    out.append(
        Finding(
            "processor",
            "ok",
            f"{processor_level()} of plain, v2, v3, v4{chosen}: which code draws; the image is the same",
        )
    )
    if RENDER.exists():
        out.append(Finding("framework", "ok", shown(RENDER)))
    else:
        out.append(Finding("framework", "bad", "not built", "run ./shadelab again and read what the build says"))

    out.append(_state())
    if (record := SET_UP / "venv" / ".shared").exists():
        says = f"{Path(record.read_text().strip()).parent}: what releases of this version share (Python packages, the framework)"
        out.append(Finding("set-up", "ok", says, "all of it may be deleted; the next call makes it again"))
    out += _opengl()
    if RENDER.exists():
        out += _meshes()
    return out


def _state() -> Finding:
    """Where what is made while the checkout is used goes: expected data, compiled code."""
    why = {True: "SHADELAB_STATE says so", False: "the checkout cannot be written to"}["SHADELAB_STATE" in os.environ]
    says = f"{shown(STATE)}" + ("" if STATE == SET_UP else f"; {why}")
    there = next(folder for folder in (STATE, *STATE.parents) if folder.exists())
    if os.access(there, os.W_OK):
        return Finding("working data", "ok", says)
    return Finding("working data", "bad", f"{says}; it cannot be written to", "name another folder in SHADELAB_STATE")


def _opengl() -> list[Finding]:
    """In a child: a driver may end the process that it is loaded into."""
    command = [sys.executable, "-I", "-m", "shadelab.gl.context"]
    tried = subprocess.run(command, capture_output=True, text=True, env={**ENVIRONMENT, **os.environ})
    try:
        told = json.loads(tried.stdout)
    except ValueError:
        said = tried.stderr.strip().splitlines()
        return [Finding("OpenGL", "bad", said[-1] if said else f"ended with {tried.returncode}", "install libosmesa6")]
    out = []
    hows = {
        "osmesa": "install libosmesa6 (Mesa before 25.1), or leave it: egl serves",
        "egl": "install libegl1, libgl1 and libgl1-mesa-dri",
    }
    for name, way in told["ways"].items():
        if "error" in way:
            out.append(Finding(f"OpenGL through {name}", "note" if told["used"] else "bad", way["error"], hows[name]))
        else:
            out.append(Finding(f"OpenGL through {name}", "ok", way["driver"]))
    if used := told["used"]:
        why = {"osmesa": "it needs no display and no EGL device", "egl": "libOSMesa is absent (Mesa 25.1 removed it)"}
        forced = "SHADELAB_GL asks for it"
        because = forced if "SHADELAB_GL" in os.environ else why[used["way"]] + " (SHADELAB_GL forces one)"
        out.append(Finding("OpenGL in use", "ok", f"{used['driver']}; {because}"))
    return out


def _meshes() -> list[Finding]:
    out = []
    for name in assignment_names():
        assignment = load_assignment(SOLUTION / name)
        draw_hidden_scenes(assignment.hidden, assignment.directory, name)
        lacking = [(scene, mesh) for scene in assignment.scenes for mesh in scene.missing_meshes()]
        if lacking:
            says = "; ".join(f"{scene.name} needs {mesh.name}" for scene, mesh in lacking)
            out.append(
                Finding(
                    f"meshes of {name}",
                    "note",
                    f"{says}; those scenes are skipped",
                    "run: .shadelab/venv/bin/python scenes/make_meshes.py --scan (needs apt-get and a network)",
                )
            )
        else:
            out.append(Finding(f"meshes of {name}", "ok", "all there"))
    return out
