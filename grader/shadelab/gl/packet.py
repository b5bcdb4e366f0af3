"""Frame packets (packet.hpp): what an OpenGL client needs of a scene, in one file."""

import json
from pathlib import Path
from typing import Any

import numpy as np

from shadelab.errors import UserError

VERSION = b"shadelab packet 2\n"


class Packet:
    """Header and buffers."""

    def __init__(self, file: Path) -> None:
        with open(file, "rb") as stream:
            if stream.readline() != VERSION:
                raise UserError(f"{file}: not a frame packet of this version")
            size = int(stream.readline())
            self.header: dict[str, Any] = json.loads(stream.read(size))
            self.data = stream.read()

    @property
    def size(self) -> tuple[int, int]:
        """Of the targets: width, height."""
        return self.header["width"], self.header["height"]

    def bytes(self, offset: int, numbers: int) -> bytes:
        """So many float32 or uint32 from there on."""
        return self.data[offset : offset + 4 * numbers]

    def attribute(self, place: dict[str, int]) -> bytes:
        return self.bytes(place["offset"], place["count"] * place["components"])

    def indices(self, place: dict[str, int]) -> bytes:
        return self.bytes(place["offset"], place["count"])

    def stage(self, pieces: list[dict[str, Any]], student: str) -> str:
        """The text of a shader, of which `student` is the student's part."""
        glsl = self.header["glsl"]
        parts = [f"#version {glsl['version']}\n{glsl['precision']}"]
        for piece in pieces:
            text = piece.get("text") or (student if piece.get("student") else self.header["sources"][piece["source"]])
            parts.append(f"#line {piece['line']}\n{text}\n")
        return "".join(parts)

    def film(self, passes: list[list[np.ndarray]]) -> np.ndarray:
        """(H, W, channels) float32 of what each pass has drawn into its targets: (H, W, 4) float32, row 0 at the top. The
        layers in the order of the C++ film."""
        n = self.header["supersample"]
        layers = []
        for layer in self.header["film"]:
            drawn = passes[layer["pass"]][layer["target"]]
            part = drawn[..., layer["first"] : layer["first"] + layer["channels"]]
            layers.append(box_filter(part, n) if layer["reduce"] == "mean" else part[n // 2 :: n, n // 2 :: n])
        return np.concatenate(layers, axis=2)


def box_filter(image: np.ndarray, n: int) -> np.ndarray:
    """Averages n x n pixels, in double."""
    if n == 1:
        return image
    height, width, channels = image.shape
    return image.reshape(height // n, n, width // n, n, channels).mean(axis=(1, 3), dtype=np.float64).astype(np.float32)
