"""The OpenGL peer of the benchmark: holds one packet's frame ready and draws it on request.

    python -m shadelab.measure.peer PACKET STUDENT_GLSL

Answers each line on stdin with one JSON line on stdout, as `shadelab-render frames` does:
    (at the start)  {"ready": true, "gl": driver, "load_ms": x}
    draw            {"ms": x}: one frame, from the clear to the last value read back into memory
    write FILE      {"written": FILE}: the last frame as .npy, height x width x channels float32, row 0 at the top
"""

import ctypes
import ctypes.util
import json
import sys
import time
from collections.abc import Callable
from pathlib import Path

import moderngl
import numpy as np

from shadelab.gl.client import Client, Frame, Objects
from shadelab.gl.context import describe
from shadelab.gl.packet import Packet
from shadelab.gl.submission import read

# Values of GL/gl.h.
TEXTURE_2D, TEXTURE_2D_MULTISAMPLE, DEPTH_COMPONENT, DEPTH_COMPONENT32F = 0x0DE1, 0x9100, 0x1902, 0x8CAC
READ_FRAMEBUFFER, DRAW_FRAMEBUFFER, DEPTH_BUFFER_BIT, NEAREST, FLOAT = 0x8CA8, 0x8CA9, 0x0100, 0x2600, 0x1406
_int, _enum = ctypes.c_int, ctypes.c_uint


def gl_function(context: moderngl.Context, name: str, *arguments: type) -> Callable[..., None]:
    """A function of OpenGL that moderngl does not offer."""
    if context.extra == "osmesa":
        address = ctypes.CDLL(ctypes.util.find_library("OSMesa") or "libOSMesa.so.8").OSMesaGetProcAddress
    else:
        address = ctypes.CDLL("libEGL.so.1").eglGetProcAddress
    address.restype, address.argtypes = ctypes.c_void_p, [ctypes.c_char_p]
    return ctypes.CFUNCTYPE(None, *arguments)(address(name.encode()))


class ColourFrame:
    """The layers that the packet asks for, each read back whole."""

    def __init__(self, client: Client, packet: Packet) -> None:
        self.packet = packet
        # Of targets with 3 and 4 components, read as they are or converted, the peer gets the fastest. Reading 1024x1024
        # pixels takes 2.8 ms (3 components as 3), 4.0 (4 as 4) or 5.3 (4 as 3); whole frames, in turn, take 3 components
        # 0.95 of the time that 4 take. Where more than the total is asked for, the fourth holds coverage, id and depth.
        passes = packet.header["passes"]
        components = 3 if [layer["layer"] for layer in packet.header["film"]] == ["total"] else 4
        self.frames = [Frame(client, packet, number, components) for number in range(len(passes))]
        self.images = [frame.buffer() for frame in self.frames]

    def draw(self) -> None:
        for frame, images in zip(self.frames, self.images):
            frame.draw()
            frame.read_into(images)

    def image(self) -> np.ndarray:
        return self.packet.film([[image[::-1] for image in images] for images in self.images])


class DepthFrame:
    """Depth alone: nothing is shaded. Of a pixel's samples the first is kept."""

    def __init__(self, client: Client, packet: Packet) -> None:
        [declared] = packet.header["passes"]
        self.context, self.size = client.context, packet.size
        self.objects = Objects(client, packet, 0)
        self.resolved = self.context.framebuffer(depth_attachment=self.depth_texture(0))
        self.target = self.resolved
        if declared["samples"] > 1:
            self.target = self.context.framebuffer(depth_attachment=self.depth_texture(declared["samples"]))
        self.bind = gl_function(self.context, "glBindFramebuffer", _enum, _enum)
        self.blit = gl_function(self.context, "glBlitFramebuffer", *[_int] * 8, _enum, _enum)
        self.depths = np.empty((*self.size[::-1], 1), np.float32)

    def depth_texture(self, samples: int) -> moderngl.Texture:
        """moderngl's depths have 24 bits, which are converted when they are read; float32 is read in half the time."""
        texture = self.context.depth_texture(self.size, samples=samples)
        kind = TEXTURE_2D_MULTISAMPLE if samples else TEXTURE_2D
        gl_function(self.context, "glBindTexture", _enum, _enum)(kind, texture.glo)
        if samples:
            types = [_enum, _int, _enum, _int, _int, ctypes.c_ubyte]
            storage = gl_function(self.context, "glTexImage2DMultisample", *types)
            storage(kind, samples, DEPTH_COMPONENT32F, *self.size, 1)
        else:
            types = [_enum, _int, _int, _int, _int, _int, _enum, _enum, ctypes.c_void_p]
            storage = gl_function(self.context, "glTexImage2D", *types)
            storage(kind, 0, DEPTH_COMPONENT32F, *self.size, 0, DEPTH_COMPONENT, FLOAT, None)
        return texture

    def draw(self) -> None:
        self.target.use()
        self.context.enable(moderngl.DEPTH_TEST)
        self.target.clear(depth=1.0)
        self.objects.draw()
        if self.target is not self.resolved:
            self.bind(READ_FRAMEBUFFER, self.target.glo)
            self.bind(DRAW_FRAMEBUFFER, self.resolved.glo)
            self.blit(0, 0, *self.size, 0, 0, *self.size, DEPTH_BUFFER_BIT, NEAREST)
        self.resolved.read_into(self.depths, components=1, attachment=-1, dtype="f4")

    def image(self) -> np.ndarray:
        return self.depths[::-1]


def make_frame(client: Client, packet: Packet) -> ColourFrame | DepthFrame:
    """A packet whose passes have no targets asks for depth alone."""
    targets = any(each["targets"] for each in packet.header["passes"])
    return ColourFrame(client, packet) if targets else DepthFrame(client, packet)


def timed_draw(frame: ColourFrame | DepthFrame) -> float:
    """Milliseconds."""
    start = time.perf_counter()
    frame.draw()
    return 1e3 * (time.perf_counter() - start)


def answer(line: str, frame: ColourFrame | DepthFrame) -> dict:
    command, _, file = line.strip().partition(" ")
    if command == "draw":
        return {"ms": timed_draw(frame)}
    if command == "write":
        np.save(file, frame.image())
        return {"written": file}
    return {"error": f"{command}: no such request; there are draw and write FILE"}


def main() -> None:
    start = time.perf_counter()
    packet = Packet(Path(sys.argv[1]))
    client = Client(student=read(Path(sys.argv[2]).read_bytes()).text)
    frame = make_frame(client, packet)
    frame.draw()  # the driver compiles shaders at their first use
    load = 1e3 * (time.perf_counter() - start)
    print(json.dumps({"ready": True, "gl": describe(client.context), "load_ms": load}), flush=True)
    for line in sys.stdin:
        print(json.dumps(answer(line, frame)), flush=True)


if __name__ == "__main__":
    main()
