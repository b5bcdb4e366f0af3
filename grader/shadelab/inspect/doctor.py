"""doctor: what this machine can do, and how to mend what it can't."""

import os
import platform
import shutil
import subprocess
from dataclasses import dataclass

from shadelab.course.assignment import assignment_names, load_assignment
from shadelab.gl.context import create_context, describe, try_ways
from shadelab.machine.build import processor_level
from shadelab.paths import RENDER, SOLUTION, shown
from shadelab.truth.expected import missing_meshes


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

    ways = try_ways()
    working = [name for name, way in ways.items() if not isinstance(way, str)]
    for name, way in ways.items():
        if isinstance(way, str):
            how = {
                "osmesa": "install libosmesa6 (Mesa before 25.1), or leave it: egl serves",
                "egl": "install libegl1, libgl1 and libgl1-mesa-dri",
            }
            out.append(Finding(f"OpenGL through {name}", "note" if working else "bad", way, how[name]))
        else:
            out.append(Finding(f"OpenGL through {name}", "ok", f"{way.info['GL_RENDERER']}, {way.info['GL_VERSION']}"))
            way.release()
    if working:
        context = create_context()
        why = {"osmesa": "it needs no display and no EGL device", "egl": "libOSMesa is absent (Mesa 25.1 removed it)"}
        because = (
            "SHADELAB_GL asks for it"
            if "SHADELAB_GL" in os.environ
            else why[context.extra] + " (SHADELAB_GL forces one)"
        )
        out.append(Finding("OpenGL in use", "ok", f"{describe(context)}; {because}"))

    for name in assignment_names():
        assignment = load_assignment(SOLUTION / name)
        lacking = [(scene, mesh) for scene in assignment.scenes for mesh in missing_meshes(scene)]
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
