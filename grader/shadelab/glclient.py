"""The OpenGL client: evaluates functions and draws frame packets with a student's GLSL. Runs in a child process.

    python -m shadelab.glclient JOBS.json

JOBS.json: {"student": file, "prelude": file, "status": file, "jobs": [...]}, each job one of
    {"kind": "compile"}
    {"kind": "evaluate", "main": file, "columns_in": n, "columns_out": n, "rows": file, "output": file}
    {"kind": "draw", "packet": file, "output": file}
Tables are raw float32, images .npy. For each job the status file gets a line {"begin": i} and, when it ended,
{"end": i, "error": null | message, "students": whether the student's shader is at fault, "seconds": s}; a job that has begun and not ended took the process with it.
"""

import json
import sys
import time
from pathlib import Path
from typing import Any

import moderngl
import numpy as np

from shadelab.errors import UserError
from shadelab.glcontext import create_context, describe

# Each text has its own line numbers, so that a driver's message tells which one it means (see glue.hpp).
PRELUDE_LINE, MAIN_LINE = 1_000_001, 2_000_001

_full_screen = "#version 330\nin vec2 corner;\nvoid main() { gl_Position = vec4(corner, 0.0, 1.0); }\n"


class ShaderError(Exception):
    """The driver's words about a shader that does not compile or link."""


def assemble(prelude: str, student: str, main: str) -> str:
    return f"#version 330\n#line {PRELUDE_LINE}\n{prelude}\n#line 1\n{student}\n#line {MAIN_LINE}\n{main}"


class Client:
    def __init__(self, prelude: str, student: str) -> None:
        self.context = create_context()
        self.prelude, self.student = prelude, student
        self.programs: dict[tuple[str, str], moderngl.Program] = {}

    def program(self, vertex: str, fragment: str) -> moderngl.Program:
        if (vertex, fragment) not in self.programs:
            try:
                self.programs[vertex, fragment] = self.context.program(vertex_shader=vertex, fragment_shader=fragment)
            except moderngl.Error as error:
                raise ShaderError(str(error)) from None
        return self.programs[vertex, fragment]

    def shader(self, main: str, with_student: bool) -> str:
        return (
            assemble(self.prelude, self.student, main) if with_student else f"#version 330\n#line {MAIN_LINE}\n{main}"
        )

    # ------------------------------------------------------------------------------------------------- functions

    def compile(self) -> None:
        main = "out vec4 shadelab_out;\nvoid main() { shadelab_out = vec4(0.0); }\n"
        self.program(_full_screen, assemble(self.prelude, self.student, main))

    def evaluate(self, main: str, rows: np.ndarray, columns_out: int) -> np.ndarray:
        """rows: (N, columns) float32. Returns (N, columns_out) float32. The layout is glue.cpp's: 1024 rows per line."""
        program = self.program(_full_screen, assemble(self.prelude, self.student, main))
        count, columns = rows.shape
        width, height = 1024, (count + 1023) // 1024
        texels, targets = (columns + 3) // 4, (columns_out + 3) // 4
        padded = np.zeros((height * width, texels * 4), np.float32)
        padded[:count, :columns] = rows
        texture = self.context.texture((width * texels, height), 4, padded.tobytes(), dtype="f4")
        texture.filter = (moderngl.NEAREST, moderngl.NEAREST)
        texture.use(0)
        if "shadelab_rows" in program:  # a function that reads no argument leaves it out
            program["shadelab_rows"].value = 0
        colours = [self.context.texture((width, height), 4, dtype="f4") for _ in range(targets)]
        framebuffer = self.context.framebuffer(colours)
        framebuffer.use()
        self.context.disable(moderngl.DEPTH_TEST)
        corners = self.context.buffer(np.array([-1, -1, 3, -1, -1, 3], np.float32).tobytes())
        self.context.vertex_array(program, [(corners, "2f", "corner")]).render(moderngl.TRIANGLES)
        parts = [
            np.frombuffer(framebuffer.read(components=4, attachment=k, dtype="f4"), np.float32).reshape(-1, 4)
            for k in range(targets)
        ]
        for resource in [texture, framebuffer, corners, *colours]:
            resource.release()
        return np.concatenate(parts, axis=1)[:count, :columns_out]

    # ----------------------------------------------------------------------------------------------------- scenes

    def draw(self, packet: "Packet") -> np.ndarray:
        """The packet's image: (H, W, channels) float32, row 0 at the top; channels as the C++ film orders them."""
        header = packet.header
        names = ["total", "ambient", "diffuse", "specular"] if header["terms"] else ["total"]
        background = header["background"]
        clear = [(*background, 0.0)] + [(0.0, 0.0, 0.0, 0.0)] * (len(names) - 1)
        images = self.pass_over(packet, "program", "programs", clear, header["samples"])
        if not header["terms"]:
            return box_filter(images[0][..., :3], header["supersample"])
        coverage = images[0][..., 3:]
        shaded = box_filter(np.concatenate([i[..., :3] for i in images] + [coverage], axis=2), header["supersample"])
        if not header["geometry"]:
            return shaded
        geometry = self.pass_over(
            packet, "geometry_program", "geometry_programs", [(0.0, 0.0, 0.0, 0.0), (0.0, 0.0, 0.0, 1.0)], 1
        )
        ids, depth = geometry[0][..., 3:], geometry[1][..., 3:]
        centre = header["supersample"] // 2
        layers = np.concatenate([ids, depth, geometry[0][..., :3], geometry[1][..., :3]], axis=2)
        return np.concatenate(
            [shaded, layers[centre :: header["supersample"], centre :: header["supersample"]]], axis=2
        )

    def pass_over(self, packet: "Packet", which: str, programs: str, clear: list, samples: int) -> list[np.ndarray]:
        """Draws every object into RGBA32F targets, one per clear colour; returns them with row 0 at the top."""
        context, header = self.context, packet.header
        size = (header["width"], header["height"])
        if samples not in (1, 2, 4):
            raise UserError(f"{samples} samples: OpenGL has 1, 2 or 4; use --backend cpp, or --supersample")
        resolved = context.framebuffer(
            [context.texture(size, 4, dtype="f4") for _ in clear], context.depth_texture(size)
        )
        target = resolved
        if samples > 1:
            target = context.framebuffer(
                [context.renderbuffer(size, 4, samples=samples, dtype="f4") for _ in clear],
                context.depth_renderbuffer(size, samples=samples),
            )
        target.use()
        context.enable(moderngl.DEPTH_TEST)
        # moderngl clears all attachments at once with one colour; each is cleared alone through the others' masks.
        for k, colour in enumerate(clear):
            set_masks(target, [j == k for j in range(len(clear))])
            target.clear(*colour, depth=1.0)
        set_masks(target, [True] * len(clear))
        for draw in header["draws"]:
            texts = header[programs][draw[which]]
            student_in = "" if which != "program" else "vertex" if texts["student_in_vertex"] else "fragment"
            program = self.program(
                *(self.shader(texts[stage], stage == student_in) for stage in ("vertex", "fragment"))
            )
            for name, value in draw["uniforms"].items():
                if name in program:  # the compiler drops what a student's function does not read
                    program[name].write(np.array(value, np.float32).tobytes())
            buffers = {
                "shadelab_position": context.buffer(packet.bytes(draw["positions"], 12)),
                "shadelab_normal": context.buffer(packet.bytes(draw["normals"], 12)),
            }
            indices = context.buffer(packet.bytes(draw["indices"], 4))
            attributes = [(buffer, "3f", name) for name, buffer in buffers.items() if name in program]
            array = context.vertex_array(program, attributes, indices)
            array.render(moderngl.TRIANGLES)
            for resource in [array, indices, *buffers.values()]:
                resource.release()
        images = []
        if samples > 1:
            context.copy_framebuffer(resolved, target)
        for k in range(len(clear)):
            data = resolved.read(components=4, attachment=k, dtype="f4")
            images.append(np.frombuffer(data, np.float32).reshape(size[1], size[0], 4)[::-1])
        for framebuffer in {id(f): f for f in (target, resolved)}.values():
            for attachment in [*framebuffer.color_attachments, framebuffer.depth_attachment]:
                attachment.release()
            framebuffer.release()
        return images


def set_masks(framebuffer: moderngl.Framebuffer, written: list[bool]) -> None:
    masks = [(w,) * 4 for w in written]
    framebuffer.color_mask = masks if len(masks) > 1 else masks[0]  # moderngl wants no list for one attachment


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


def box_filter(image: np.ndarray, n: int) -> np.ndarray:
    """Averages n x n pixels, in double."""
    if n == 1:
        return image
    height, width, channels = image.shape
    return image.reshape(height // n, n, width // n, n, channels).mean(axis=(1, 3), dtype=np.float64).astype(np.float32)


def run(job: dict[str, Any], client: Client) -> None:
    if job["kind"] == "compile":
        client.compile()
    elif job["kind"] == "evaluate":
        rows = np.fromfile(job["rows"], np.float32).reshape(-1, job["columns_in"])
        client.evaluate(Path(job["main"]).read_text(), rows, job["columns_out"]).tofile(job["output"])
    else:
        np.save(job["output"], client.draw(Packet(Path(job["packet"]))))


def main() -> None:
    task = json.loads(Path(sys.argv[1]).read_text())
    with open(task["status"], "a", buffering=1) as status:
        client = Client(Path(task["prelude"]).read_text(), Path(task["student"]).read_text(errors="replace"))
        status.write(json.dumps({"gl": describe(client.context)}) + "\n")
        for index, job in enumerate(task["jobs"]):
            status.write(json.dumps({"begin": index}) + "\n")
            start, message, students = time.perf_counter(), None, False
            try:
                run(job, client)
            except ShaderError as error:
                message, students = str(error), True
            except UserError as error:
                message = str(error)
            except Exception as error:  # a driver or a library that fails in a way of its own: ours, and told
                message = f"the OpenGL client failed: {type(error).__name__}: {error}"
            end = {"end": index, "error": message, "students": students, "seconds": time.perf_counter() - start}
            status.write(json.dumps(end) + "\n")


if __name__ == "__main__":
    main()
