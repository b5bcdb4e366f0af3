"""editor: what an editor needs to check a submission while it is written.

compile_commands.json     for clangd and VS Code's C++: how shading.cpp is compiled
.vscode/before.hpp        what stands before shading.cpp in its translation unit: the assignment's types, and given code
.vscode/before.glsl       the same of shading.glsl
.vscode/glslang           glslangValidator with that before the text that it is given, or before shading.glsl: messages have
                          the lines of that file
.vscode/settings.json, tasks.json   point VS Code there; files that are there and say something else are left alone
"""

import json
import shutil
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from shadelab.course.assignment import Assignment
from shadelab.errors import UserError
from shadelab.machine.build import HEADERS
from shadelab.paths import shown

COMMANDS, FOLDER = "compile_commands.json", ".vscode"
VALIDATORS = ("glslangValidator", "glslang")  # one program under its old and its new name

SCRIPT = """#!/bin/sh
# Checks GLSL as Shadelab compiles it. With arguments: those of glslangValidator, the text on stdin; without: shading.glsl.
here=$(cd "$(dirname "$0")" && pwd)
whole() {
    printf '#version 330\\n'
    cat "$here/before.glsl"
    printf '\\n#line 1\\n'
    cat
    printf '\\n#line 1000001\\nvoid main() {}\\n'
}
if [ $# -gt 0 ]; then
    whole | VALIDATOR "$@"
else
    whole < "$here/../shading.glsl" | VALIDATOR --stdin -S frag > "$here/said"
    result=$?
    sed -n 's/^\\(ERROR\\|WARNING\\): 0:\\([0-9]*\\): /shading.glsl:\\2: /p' "$here/said"
    rm -f "$here/said"
    exit $result
fi
"""


@dataclass
class Written:
    files: list[Path] = field(default_factory=list)
    notes: list[str] = field(default_factory=list)


def write_editor_files(assignment: Assignment, folder: Path) -> Written:
    """Raises UserError where there is no shading.cpp."""
    folder = folder.resolve()
    if not (folder / "shading.cpp").is_file():
        raise UserError(f"{shown(folder)}: holds no shading.cpp; give the folder with what you write")
    out, own = Written(), folder / FOLDER
    own.mkdir(exist_ok=True)

    def write(file: Path, text: str) -> None:
        file.write_text(text)
        out.files.append(file)

    glue = assignment.glue
    before, found, _ = (glue / "glue.cpp").read_text().partition('#include "shading.cpp"')
    assert found, "the glue does not include the student's file"
    write(own / "before.hpp", before.replace('#include "follow.hpp"\n', ""))
    arguments = ["g++", "-std=c++20", "-Wall", f"-I{HEADERS}", f"-I{glue}", "-include", str(own / "before.hpp")]
    entry = {"directory": str(folder), "file": "shading.cpp", "arguments": [*arguments, "-c", "shading.cpp"]}
    write(folder / COMMANDS, json.dumps([entry], indent=1) + "\n")

    settings: dict[str, Any] = {"C_Cpp.default.compileCommands": f"${{workspaceFolder}}/{COMMANDS}"}
    tasks: dict[str, Any] = {}
    if validator := next(filter(None, map(shutil.which, VALIDATORS)), None):
        write(own / "before.glsl", (glue / "prelude.glsl").read_text())
        write(own / "glslang", SCRIPT.replace("VALIDATOR", f"'{validator}'"))
        (own / "glslang").chmod(0o755)
        settings |= {
            "files.associations": {"*.glsl": "glsl"},
            "glsllint.glslangValidatorPath": str(own / "glslang"),
            "glsllint.additionalStageAssociations": {".glsl": "frag"},
        }
        pattern = {"regexp": r"^(shading\.glsl):(\d+): (.*)$", "file": 1, "line": 2, "message": 3}
        matcher = {"owner": "glsl", "fileLocation": ["relative", "${workspaceFolder}"], "pattern": pattern}
        check = {
            "label": "Check shading.glsl",
            "type": "process",
            "command": str(own / "glslang"),
            "problemMatcher": matcher,
        }
        tasks = {"version": "2.0.0", "tasks": [check | {"group": {"kind": "build", "isDefault": True}}]}
    else:
        out.notes.append(
            "no glslangValidator here, so GLSL is not checked in the editor: apt install glslang-tools, and run this again"
        )
    for name, content in (("settings.json", settings), ("tasks.json", tasks)):
        text, file = json.dumps(content, indent=1) + "\n", own / name
        if not content:
            continue
        if file.exists() and file.read_text() != text:
            out.notes.append(
                f"{shown(file)} says something else and was left alone; it would be: {json.dumps(content)}"
            )
        else:
            write(file, text)
    return out
