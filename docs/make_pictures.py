#!/usr/bin/env python3
"""Makes the pictures of the README and the handouts anew: run it after a change that alters what scenes look like.

.shadelab/venv/bin/python docs/make_pictures.py
"""

import subprocess
import tempfile
from pathlib import Path

from PIL import Image

ROOT = Path(__file__).resolve().parents[1]
HANDOUTS = {"phong": ["sphere", "exponents", "grazing", "backlit", "interpolation", "spots"]}
README = ["teapot", "knot", "interpolation", "spots"]


def render(assignment: str, scene: str, pixels: int, file: Path) -> None:
    """Supersampled, so that the silhouettes look their best."""
    options = ["--size", f"{pixels}x{pixels}", "--supersample", "4", "-o", file]
    subprocess.run([ROOT / "shadelab", "render", ROOT / f"scenes/{assignment}/{scene}.toml", *options], check=True)


def main() -> None:
    for assignment, scenes in HANDOUTS.items():
        for scene in scenes:
            render(assignment, scene, 256, ROOT / f"solution/{assignment}/pictures/{scene}.png")
    with tempfile.TemporaryDirectory() as folder:
        strip = Image.new("RGB", (len(README) * 300, 300))
        for k, scene in enumerate(README):
            file = Path(folder) / f"{scene}.png"
            render("phong", scene, 300, file)
            strip.paste(Image.open(file), (k * 300, 0))
        strip.save(ROOT / "docs/pictures/phong.png", optimize=True)


if __name__ == "__main__":
    main()
