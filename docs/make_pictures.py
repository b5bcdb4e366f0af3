"""Makes docs/gallery.md and the pictures of README, gallery and handouts anew: run it after a change that alters what scenes
look like, or that adds one. It takes some minutes.

.shadelab/venv/bin/python docs/make_pictures.py [ASSIGNMENT]...      default: all
"""

import re
import subprocess
import sys
import tempfile
from pathlib import Path

import numpy as np
from PIL import Image, ImageDraw, ImageFont

from shadelab.course.assignment import Scene, assignment_names, load_assignment

ROOT = Path(__file__).resolve().parents[1]
GALLERY = ROOT / "docs" / "gallery.md"
README = ["lights/bunny", "phong/teapot", "microfacet/metals", "phong/interpolation"]
COLUMNS = 4
LAYERS = ("ambient", "diffuse", "specular", "total")


def render(scene: Path, pixels: int, file: Path, *options: str) -> None:
    """Supersampled, so that the silhouettes look their best."""
    size = ["--size", f"{pixels}x{pixels}", "--supersample", "4"]
    subprocess.run([ROOT / "shadelab", "render", scene, *size, *options, "-o", file], check=True)


def rendered(scene: Path, pixels: int, *options: str) -> Image.Image:
    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder) / "picture.png"
        render(scene, pixels, file, *options)
        return Image.open(file).convert("RGB")


# ------------------------------------------------------------------------------------------------------ handouts


def terms_table(scenes: list[Path], file: Path, pixels: int = 150) -> None:
    """The lecture's table of terms: a row for each scene, a column for each layer."""
    left, top = 92, 24
    sheet = Image.new("RGB", (left + len(LAYERS) * pixels, top + len(scenes) * pixels), "white")
    draw, font = ImageDraw.Draw(sheet), ImageFont.load_default(size=15)
    with tempfile.TemporaryDirectory() as folder:
        for row, scene in enumerate(scenes):
            raw = Path(folder) / "layers.npy"
            render(scene, pixels, raw, "--layers")
            layers = dict(zip(("total", "ambient", "diffuse", "specular"), np.split(np.load(raw)[..., :12], 4, axis=2)))
            label = scene.stem.replace("phi-", "phi = ") + "°"
            draw.text((left / 2, top + (row + 0.5) * pixels), label, "black", font, anchor="mm")
            for column, layer in enumerate(LAYERS):
                linear, picture = Path(folder) / "one.npy", Path(folder) / "one.png"
                np.save(linear, layers[layer])
                subprocess.run([ROOT / "build/shadelab-render", "convert", linear, "-o", picture], check=True)
                sheet.paste(Image.open(picture), (left + column * pixels, top + row * pixels))
    for column, layer in enumerate(LAYERS):
        draw.text((left + (column + 0.5) * pixels, top / 2), layer, "black", font, anchor="mm")
    sheet.save(file, optimize=True)


# Pictures that are more than one scene.
COMPOSED = {
    "phong/terms": lambda file: terms_table([ROOT / f"scenes/phong/phi-{a}.toml" for a in (60, 25, 0)], file),
}


def handout_pictures(name: str, directory: Path) -> None:
    """Every pictures/SCENE.png that the handout shows."""
    for picture in re.findall(r"\]\(pictures/([\w-]+)\.png\)", (directory / "handout.md").read_text()):
        file = directory / "pictures" / f"{picture}.png"
        if compose := COMPOSED.get(f"{name}/{picture}"):
            compose(file)
        else:
            render(ROOT / "scenes" / name / f"{picture}.toml", 256, file)


# ------------------------------------------------------------------------------------------------------- gallery


def says(scene: Scene) -> str:
    """The comment that opens a scene file."""
    lines = []
    for line in scene.file.read_text().splitlines():
        if not line.startswith("#"):
            break
        lines.append(line.lstrip("# "))
    return " ".join(lines)


def gallery_text() -> str:
    out = [
        "# Gallery",
        "",
        "Every public scene, drawn with the solution's functions by the C++ rasterizer. Made by `docs/make_pictures.py`; draw one",
        "yourself with `./shadelab render scenes/ASSIGNMENT/SCENE.toml`.",
    ]
    for name in assignment_names():
        assignment = load_assignment(ROOT / "solution" / name)
        out += ["", f"## {name}: {assignment.title}", "", "|" + "   |" * COLUMNS, "|" + "---|" * COLUMNS]
        scenes = assignment.public_scenes
        for start in range(0, len(scenes), COLUMNS):
            row = scenes[start : start + COLUMNS]
            cells = [
                f"![{s.name}](pictures/gallery/{name}-{s.name}.png)<br>**[{s.name}](../scenes/{name}/{s.name}.toml)** {says(s)}"
                for s in row
            ]
            out.append("| " + " | ".join(cells + [""] * (COLUMNS - len(row))) + " |")
    return "\n".join(out) + "\n"


def gallery_pictures(name: str) -> None:
    for scene in load_assignment(ROOT / "solution" / name).public_scenes:
        rendered(scene.file, 208).save(ROOT / f"docs/pictures/gallery/{name}-{scene.name}.png", optimize=True)


def main() -> None:
    names = sys.argv[1:] or assignment_names()
    (ROOT / "docs/pictures/gallery").mkdir(parents=True, exist_ok=True)
    for name in names:
        handout_pictures(name, ROOT / "solution" / name)
        gallery_pictures(name)
    GALLERY.write_text(gallery_text())
    strip = Image.new("RGB", (len(README) * 300, 300))
    for k, scene in enumerate(README):
        strip.paste(rendered(ROOT / f"scenes/{scene}.toml", 300), (k * 300, 0))
    strip.save(ROOT / "docs/pictures/scenes.png", optimize=True)


if __name__ == "__main__":
    main()
