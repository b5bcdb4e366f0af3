"""The OpenGL client: evaluates functions and draws frame packets with a student's GLSL. Runs in a child process.

    python -m shadelab.gl.client JOBS.json

JOBS.json: {"student": file, "prelude": file, "status": file, "jobs": [...]}, each job one of
    {"kind": "compile"}
    {"kind": "evaluate", "main": file, "columns_in": n, "columns_out": n, "rows": file, "output": file}
    {"kind": "draw", "packet": file, "output": file}
and, where it is not about the student's file, with "student": another file. Tables are raw float32, images .npy. For each
job the status file gets a line {"begin": i} and, when it ended, {"end": i, "error": null | message, "students": whether the
student's shader is at fault, "said": what the compiler says of code that compiles, "seconds": s, "frames": seconds of drawing
alone}; a job that has begun and not ended took the process with it.
"""

import json
import sys
import time
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import moderngl
import numpy as np

from shadelab.errors import UserError
from shadelab.gl.context import compiler_log, create_context, describe
from shadelab.gl.packet import Packet
from shadelab.gl.submission import read

# Each text has its own line numbers, so that a driver's message tells which one it means (see glue.hpp).
PRELUDE_LINE, MAIN_LINE = 1_000_001, 2_000_001

_full_screen = "#version 330\nin vec2 corner;\nvoid main() { gl_Position = vec4(corner, 0.0, 1.0); }\n"


class ShaderError(Exception):
    """The driver's words about a shader that does not compile or link."""


class Client:
    def __init__(self, prelude: str = "", student: str = "") -> None:
        """prelude: what stands before the student's functions when they are evaluated alone; a packet has its own."""
        self.context = create_context()
        self.prelude, self.student = prelude, student
        self.programs: dict[tuple[str, str], moderngl.Program] = {}
        self.last_set: dict[int, Object] = {}  # by program (glo): whose uniforms it holds

    def program(self, vertex: str, fragment: str) -> moderngl.Program:
        if (vertex, fragment) not in self.programs:
            try:
                self.programs[vertex, fragment] = self.context.program(vertex_shader=vertex, fragment_shader=fragment)
            except moderngl.Error as error:
                raise ShaderError(str(error)) from None
        return self.programs[vertex, fragment]

    def set_uniforms(self, which: "Object") -> None:
        """Objects may share a program: its uniforms are set when another object was the last to use it."""
        if self.last_set.get(which.program.glo) is not which:
            for uniform, value in which.uniforms:
                uniform.write(value)
            self.last_set[which.program.glo] = which

    # ------------------------------------------------------------------------------------------------- functions

    def assemble(self, main: str) -> str:
        return f"#version 330\n#line {PRELUDE_LINE}\n{self.prelude}\n#line 1\n{self.student}\n#line {MAIN_LINE}\n{main}"

    def compile(self) -> str:
        """What the compiler says of code that compiles."""
        main = "out vec4 shadelab_out;\nvoid main() { shadelab_out = vec4(0.0); }\n"
        return compiler_log(self.context, self.program(_full_screen, self.assemble(main)))

    def evaluate(self, main: str, rows: np.ndarray, columns_out: int) -> np.ndarray:
        """rows: (N, columns) float32. Returns (N, columns_out) float32. The layout is evaluate.glsl's: 1024 rows per line."""
        program = self.program(_full_screen, self.assemble(main))
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

    def draw(self, packet: Packet, frames: int = 0) -> tuple[np.ndarray, list[float]]:
        """The packet's image: (H, W, channels) float32, row 0 at the top. And the seconds of further frames."""
        images, seconds = [], [0.0] * frames
        for number in range(len(packet.header["passes"])):
            frame = Frame(self, packet, number)
            frame.draw()
            images.append(frame.read())
            # The first drawing has compiled; others tell what one takes.
            for turn in range(frames):
                start = time.perf_counter()
                frame.draw()
                self.context.finish()
                seconds[turn] += time.perf_counter() - start
            frame.release()
        return packet.film(images), seconds


@dataclass
class Object:
    """What one draw call needs, on the OpenGL side."""

    program: moderngl.Program
    uniforms: list[tuple[moderngl.Uniform, bytes]]
    array: moderngl.VertexArray
    buffers: list[moderngl.Buffer]


class Objects:
    """What a pass draws: programs, textures, buffers and vertex arrays are made here, once."""

    def __init__(self, client: Client, packet: Packet, number: int) -> None:
        self.client, header = client, packet.header
        draws = header["passes"][number]["draws"]
        # All programs first: a shader that does not compile leaves no buffers behind.
        programs = [self.program(packet, header["programs"][draw["program"]]) for draw in draws]
        self.objects = [self.object(packet, header["objects"][draw["object"]], p) for draw, p in zip(draws, programs)]
        self.textures = [self.texture(packet, texture) for texture in header["textures"]]

    def program(self, packet: Packet, pieces: dict[str, Any]) -> moderngl.Program:
        vertex, fragment = (packet.stage(pieces[stage], self.client.student) for stage in ("vertex", "fragment"))
        return self.client.program(vertex, fragment)

    def object(self, packet: Packet, declared: dict[str, Any], program: moderngl.Program) -> Object:
        """The compiler drops what a student's function does not read: of uniforms and attributes those are set that are there."""
        context = self.client.context
        uniforms = [
            (program[name], np.array(value, np.float32).tobytes())
            for name, value in {**packet.header["uniforms"], **declared["uniforms"]}.items()
            if name in program
        ]
        attributes = [
            (context.buffer(packet.attribute(place)), f"{place['components']}f", name)
            for name, place in declared["attributes"].items()
            if name in program
        ]
        indices = context.buffer(packet.indices(declared["indices"]))
        for unit, texture in enumerate(packet.header["textures"]):
            if texture["name"] in program:
                program[texture["name"]].value = unit
        array = context.vertex_array(program, attributes, indices)
        return Object(program, uniforms, array, [indices, *(buffer for buffer, _, _ in attributes)])

    def texture(self, packet: Packet, declared: dict[str, Any]) -> moderngl.Texture:
        size = declared["width"], declared["height"]
        data = packet.bytes(declared["offset"], 4 * size[0] * size[1])
        texture = self.client.context.texture(size, 4, data, dtype="f4")
        texture.filter = (moderngl.NEAREST, moderngl.NEAREST)
        return texture

    def draw(self) -> None:
        for unit, texture in enumerate(self.textures):
            texture.use(unit)
        for each in self.objects:
            self.client.set_uniforms(each)
            each.array.render(moderngl.TRIANGLES)

    def release(self) -> None:
        for each in self.objects:
            for resource in [each.array, *each.buffers]:
                resource.release()
        for texture in self.textures:
            texture.release()


class Frame:
    """One pass of a packet, ready to be drawn again and again."""

    def __init__(self, client: Client, packet: Packet, number: int, components: int = 4) -> None:
        """components: of the float32 targets. 3 leaves the coverage out; not every driver draws into such targets."""
        declared = packet.header["passes"][number]
        self.context, self.size, self.components = client.context, packet.size, components
        self.clear = [tuple(target["clear"]) for target in declared["targets"]]
        self.depth = any(layer["pass"] == number and layer["target"] == -1 for layer in packet.header["film"])
        samples = declared["samples"]
        if samples not in (1, 2, 4):
            raise UserError(f"{samples} samples: OpenGL has 1, 2 or 4; use --backend cpp, or --supersample")
        if self.depth and samples > 1:
            raise UserError(f"{samples} samples: this client reads the depth of one sample a pixel alone")
        self.objects = Objects(client, packet, number)
        textures = [self.context.texture(self.size, components, dtype="f4") for _ in self.clear]
        if samples == 1:
            self.target = self.resolved = self.context.framebuffer(textures, self.context.depth_texture(self.size))
            return
        # Without a depth attachment: only colours are resolved.
        self.resolved = self.context.framebuffer(textures)
        self.target = self.context.framebuffer(
            [self.context.renderbuffer(self.size, components, samples=samples, dtype="f4") for _ in self.clear],
            self.context.depth_renderbuffer(self.size, samples=samples),
        )

    def draw(self) -> None:
        """Clears, draws every object and averages the samples. The driver may still be at work afterwards."""
        self.target.use()
        self.context.enable(moderngl.DEPTH_TEST)
        # moderngl clears all attachments at once with one colour; others are kept from it by their masks.
        for colour in dict.fromkeys(self.clear or [(0.0,) * 4]):
            set_masks(self.target, [colour == other for other in self.clear])
            self.target.clear(*colour, depth=1.0)
        set_masks(self.target, [True] * len(self.clear))
        self.objects.draw()
        if self.target is not self.resolved:
            self.context.copy_framebuffer(self.resolved, self.target)

    def buffer(self) -> np.ndarray:
        """Room for what read_into writes: (targets, H, W, components) float32."""
        return np.empty((len(self.clear), self.size[1], self.size[0], self.components), np.float32)

    def read_into(self, images: np.ndarray) -> None:
        """Copies every target once it is drawn, with row 0 at the bottom, as OpenGL has it."""
        for k, image in enumerate(images):
            self.resolved.read_into(image, components=self.components, attachment=k, dtype="f4")

    def read(self) -> list[np.ndarray]:
        """Every target, and last the depth where the film asks for it: (H, W, components) float32, row 0 at the top."""
        images = self.buffer()
        self.read_into(images)
        if not self.depth:
            return [image[::-1] for image in images]
        depth = np.empty((self.size[1], self.size[0], 1), np.float32)
        self.resolved.read_into(depth, components=1, attachment=-1, dtype="f4")
        return [image[::-1] for image in [*images, depth]]

    def release(self) -> None:
        self.objects.release()
        for framebuffer in {id(f): f for f in (self.target, self.resolved)}.values():
            for attachment in [*framebuffer.color_attachments, framebuffer.depth_attachment]:
                if attachment is not None:
                    attachment.release()
            framebuffer.release()


def set_masks(framebuffer: moderngl.Framebuffer, written: list[bool]) -> None:
    if not written:
        return
    masks = [(w,) * 4 for w in written]
    framebuffer.color_mask = masks if len(masks) > 1 else masks[0]  # moderngl wants no list for one attachment


def run(job: dict[str, Any], client: Client) -> tuple[str, list[float]]:
    """Returns what the compiler says, where nothing else is asked for, and the seconds of frames alone, where they are drawn."""
    if job["kind"] == "compile":
        return client.compile(), []
    if job["kind"] == "evaluate":
        rows = np.fromfile(job["rows"], np.float32).reshape(-1, job["columns_in"])
        client.evaluate(Path(job["main"]).read_text(), rows, job["columns_out"]).tofile(job["output"])
    else:
        image, seconds = client.draw(Packet(Path(job["packet"])), job.get("frames", 0))
        np.save(job["output"], image)
        return "", seconds
    return "", []


def main() -> None:
    task = json.loads(Path(sys.argv[1]).read_text())
    with open(task["status"], "a", buffering=1) as status:
        client = Client(Path(task["prelude"]).read_text())
        status.write(json.dumps({"gl": describe(client.context)}) + "\n")
        for index, job in enumerate(task["jobs"]):
            status.write(json.dumps({"begin": index}) + "\n")
            start, message, students, said, frames = time.perf_counter(), None, False, "", []
            try:
                shader = read(Path(job.get("student", task["student"])).read_bytes())
                client.student = shader.text
                said, frames = run(job, client)
                said = "\n".join([*shader.remarks, said])
            except ShaderError as error:
                message, students = "\n".join([*shader.includes, str(error)]), True
            except UserError as error:
                message = str(error)
            except Exception as error:  # a driver or a library that fails in a way of its own: ours, and told
                message = f"the OpenGL client failed: {type(error).__name__}: {error}"
            seconds = time.perf_counter() - start
            end = {"end": index, "error": message, "students": students, "said": said}
            status.write(json.dumps({**end, "seconds": seconds, "frames": frames}) + "\n")


if __name__ == "__main__":
    main()
