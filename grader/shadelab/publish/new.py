"""new: a small assignment that works, from templates/assignment, for an instructor to replace piece by piece."""

import json
import re
import shutil
from pathlib import Path

from shadelab.course.assignment import find_assignment
from shadelab.errors import UserError
from shadelab.files import write_whole
from shadelab.paths import ROOT, SCENES, SOLUTION, STARTER, shown
from shadelab.publish.release import RESERVED, TEMPLATES
from shadelab.publish.starter import write_starter


def write_assignment(name: str, title: str | None) -> list[Path]:
    """Writes solution/NAME, scenes/NAME and starter/NAME. Returns the files that are to be edited."""
    # The name becomes part of identifiers in C++, GLSL (which keeps gl_ and __ for itself) and Python.
    if not re.fullmatch(r"[a-z][a-z0-9]*(_[a-z0-9]+)*", name) or name.startswith("gl_") or len(name) > 40:
        raise UserError(f"{name}: a name has small letters, digits and single underscores, such as soft_light")
    if name in RESERVED or (ROOT / name).exists():
        raise UserError(f"{name}: is the name of something else; choose another")
    for folder in (SOLUTION / name, SCENES / name, STARTER / name):
        if folder.exists():
            raise UserError(f"{shown(folder)}: is there already; choose another name")
    title = (title or name.replace("_", " ").capitalize()).strip()
    if not title or not title.isprintable():
        raise UserError("--title: must be one line of text")
    words = {
        "__NAME__": name,
        "__TITLE__": title,
        "__TITLE_TEXT__": json.dumps(title, ensure_ascii=False),
        "__STRUCT__": "".join(part.capitalize() for part in name.split("_")) + "Material",
    }
    try:
        return _write(name, words)
    except BaseException:  # what is half there would stand in the way of the next try
        for folder in (SOLUTION / name, SCENES / name, STARTER / name):
            shutil.rmtree(folder, ignore_errors=True)
        raise


def _write(name: str, words: dict[str, str]) -> list[Path]:
    written = []
    for template in sorted((TEMPLATES / "assignment").iterdir()):
        file = SCENES / name / f"{name}.toml" if template.name == "scene.toml" else SOLUTION / name / template.name
        file.parent.mkdir(parents=True, exist_ok=True)
        text = template.read_text()
        for word, meaning in words.items():
            text = text.replace(word, meaning)
        write_whole(file, text)
        written.append(file)
    write_starter(find_assignment(SOLUTION / name, name), force=True)
    return written


def next_steps(name: str) -> str:
    return f"""What to do next:
  ./shadelab check {name}           it works as it stands; after each change it must again
  ./shadelab render scenes/{name}/{name}.toml
  1. solution/{name}/shading.cpp and .glsl: your functions, with STUDENT BEGIN and END round what students write
  2. solution/{name}/assignment.toml: declare them; scenes/{name}: scenes in which likely mistakes show
  3. exact.py, mistakes.toml, hidden.toml, handout.md beside it; ./shadelab starter {name} after each change
  4. ./shadelab test -k assignments says what an assignment of this course still lacks;
     .shadelab/venv/bin/python docs/make_pictures.py {name} draws its pictures for the gallery
  5. ./shadelab release {name} --out DIR for students, ./shadelab package {name} --for gradescope -o FILE.zip for the grader"""
