"""Frame packets (packet.hpp): what an OpenGL client needs of a scene, in one file."""

import json
from pathlib import Path
from typing import Any

from shadelab.errors import UserError


class Packet:
    """A frame packet (packet.hpp): header and buffers."""

    def __init__(self, file: Path) -> None:
        with open(file, "rb") as stream:
            if stream.readline() != b"shadelab packet 1\n":
                raise UserError(f"{file}: not a frame packet of this version")
            size = int(stream.readline())
            self.header: dict[str, Any] = json.loads(stream.read(size))
            self.data = stream.read()

    def bytes(self, place: dict[str, int], element: int) -> bytes:
        return self.data[place["offset"] : place["offset"] + place["count"] * element]
