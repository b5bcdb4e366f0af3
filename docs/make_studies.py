"""Runs the studies and writes docs/studies: figures, numbers, and the page that shows them.

    .shadelab/venv/bin/python docs/make_studies.py [NAME ...]

Takes some minutes without names. Let the machine do nothing else meanwhile: what it does shows in the times.
"""

import json
import shutil
import sys
import tempfile
from pathlib import Path

from shadelab.cli.options import progress_bar
from shadelab.course.assignment import assignment_of_scene
from shadelab.study.declaration import study_names
from shadelab.study.report import machine_sentence, noise_sentence, write_files
from shadelab.study.run import run_study

STUDIES = Path(__file__).resolve().parent / "studies"
HEAD = """# Studies

Error against run time. `./shadelab study NAME` measures one of these anew, `./shadelab study SCENE.toml` does it for any scene, and a file
in [studies/](../../studies) declares another. Rings mark the Pareto front: nothing else is as fast and as exact. Made by
`.shadelab/venv/bin/python docs/make_studies.py` on a machine that did nothing else; the numbers stand beside the figures as JSON.
"""


def section(result: dict) -> str:
    """A study's figures, and what one sees on them."""
    out = [f"## {result['title']}", f"`./shadelab study {result['name']}`. {machine_sentence(result)}"]
    for part in result["parts"]:
        if len(result["parts"]) > 1:
            out.append(f"### {part['title']}")
        out += [picture(part), " ".join(part["claims"])]
        out.append(f"Reference: {part['reference']['what']}. {noise_sentence(part['noise'])}")
    return "\n\n".join(line for line in out if line)


def picture(part: dict) -> str:
    name, title = part["name"], part["title"]
    return (
        f'<picture><source media="(prefers-color-scheme: dark)" srcset="{name}-dark.png">'
        f'<img alt="{title}" src="{name}-light.png"></picture>'
    )


def main() -> None:
    STUDIES.mkdir(exist_ok=True)
    for name in sys.argv[1:] or study_names():
        with progress_bar() as progress:
            result, parts = run_study(name, None, lambda scene: assignment_of_scene(scene, None), progress)
        with tempfile.TemporaryDirectory() as folder:
            for file in write_files(result, parts, Path(folder)):
                if file.suffix == ".png":
                    shutil.copy(file, STUDIES / file.name)
        (STUDIES / f"{name}.json").write_text(json.dumps(result, indent=1, allow_nan=False) + "\n")
    measured = [
        json.loads((STUDIES / f"{n}.json").read_text()) for n in study_names() if (STUDIES / f"{n}.json").exists()
    ]
    (STUDIES / "README.md").write_text("\n\n".join([HEAD.strip(), *map(section, measured)]) + "\n")


if __name__ == "__main__":
    main()
