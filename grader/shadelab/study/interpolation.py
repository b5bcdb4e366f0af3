"""Flat, Gouraud and Phong interpolation of one sphere, cut ever finer, against the sphere that no triangle stands for.

With h the length of an edge, a flat face's normal is off by up to a multiple of h: order 1. Interpolation between vertices that
have the right colours (Gouraud) or normals (Phong) is off by h^2. Both hold once h is small against the highlight, and away from
the outline, whose polygon is another matter: only pixels that both cover and that face the eye count.
"""

import importlib.util
import sys
from collections.abc import Callable
from contextlib import ExitStack
from pathlib import Path
from types import ModuleType

import numpy as np
import tomli_w

from shadelab.course.assignment import assignment_of_scene
from shadelab.course.toml_files import read_toml
from shadelab.machine import renderer
from shadelab.measure.images import image_error
from shadelab.measure.timing import interleaved, milliseconds
from shadelab.paths import SCENES
from shadelab.study.declaration import Interpolation, Study, declared_scene
from shadelab.study.images import Functions, analytic_sphere
from shadelab.study.points import Guide, Part, Point, Slope, fit_slope
from shadelab.study.timing import Drawer, Workbench

KINDS = {
    "flat": {"normals": "flat"},
    "gouraud": {"normals": "file", "interpolation": "gouraud"},
    "phong": {"normals": "file", "interpolation": "phong"},
}
EXPECTED = {"flat": 1, "gouraud": 2, "phong": 2}


def mesh_maker() -> ModuleType:
    """scenes/make_meshes.py, which is a script and no part of the package."""
    spec = importlib.util.spec_from_file_location("make_meshes", SCENES / "make_meshes.py")
    module = importlib.util.module_from_spec(spec)
    sys.modules[spec.name] = module  # its dataclasses look themselves up there
    spec.loader.exec_module(module)
    return module


def sphere(subdivisions: int, file: Path, maker: ModuleType) -> float:
    """Writes the icosahedron with each triangle cut into 4^subdivisions, and the sphere's normals. Returns the mean edge."""
    mesh = maker.sphere(2**subdivisions, normals=True)
    file.write_text(maker.obj_text(mesh, f"a sphere for a study, subdivided {subdivisions} times"))
    [faces] = mesh.faces
    edges = mesh.vertices[faces] - mesh.vertices[np.roll(faces, 1, axis=1)]
    return float(np.linalg.norm(edges, axis=2).mean())


def write_scene(scene: Path, mesh: Path, kind: str, size: int, file: Path) -> Path:
    """The study's scene with another mesh in the place of its sphere, interpolated in this way."""
    content = read_toml(scene)
    content["film"] |= {"width": size, "height": size}
    for entry in content["object"]:
        entry |= {"mesh": str(mesh), **KINDS[kind]}
    file.write_text(tomli_w.dumps(content))
    return file


def measure_interpolation(study: Study, spec: Interpolation, work: Workbench, name: str) -> Part:
    scene = declared_scene(spec.scene, name)
    assignment = assignment_of_scene(scene)
    maker = mesh_maker()
    edges, scenes = {}, {}
    for done, level in enumerate(spec.subdivisions):
        work.progress("making spheres", done, len(spec.subdivisions))
        mesh = work.folder / f"sphere-{level}.obj"
        edges[level] = sphere(level, mesh, maker)
        for kind in KINDS:
            file = work.folder / f"{kind}-{level}.toml"
            scenes[kind, level] = write_scene(scene, mesh, kind, spec.size, file)
    work.progress("the analytic sphere", 0, 1)
    described = renderer.describe(file, assignment.directory)
    truth, facing = analytic_sphere(described, spec.facing, Functions(work, assignment))
    with ExitStack() as stack:
        programs: dict[tuple[str, int], Drawer] = {}
        for key, scene in scenes.items():
            work.progress("loading", len(programs), len(scenes))
            programs[key] = stack.enter_context(work.cpp(scene, assignment, work.needs(scene, assignment).loops))
        draws: dict[tuple[str, int], Callable[[], float]] = {
            key: lambda program=program: program.draw(image=False).seconds for key, program in programs.items()
        }
        seconds = interleaved(draws, study.repeats, work.progress)
        images = {key: program.draw().image for key, program in programs.items()}
    points = []
    for (kind, level), image in images.items():
        both = facing & (image.max(axis=2) > 0)
        knob = {"subdivisions": level, "edge": edges[level], "triangles": 20 * 4**level}
        points.append(Point(kind, knob, image_error(image[both], truth[both]), seconds[kind, level]))
    part = Part(
        name, study.title, f"a sphere of radius 1, {spec.scene}",
        {"what": f"the analytic sphere at each pixel's centre, shaded in double; pixels that both cover, with n.v >= {spec.facing:g}",
         "samples": 1, "pixels": f"{spec.size}x{spec.size}"},
        points, knob="edge", knob_label="mean length of an edge, of a sphere of radius 1",
    )  # fmt: skip
    for kind, order in EXPECTED.items():
        fitted = [p for p in points if p.series == kind and p.knob["subdivisions"] >= spec.fit_from]
        slope, error = fit_slope([p.knob["edge"] for p in fitted], [p.error["rmse"] for p in fitted])
        levels = [p.knob["subdivisions"] for p in fitted]
        part.slopes.append(Slope(kind, "edge", str(order), slope, error, f"subdivisions {levels[0]} to {levels[-1]}"))
    part.guides = [Guide("flat", 1, "$h$"), Guide("phong", 2, "$h^2$")]
    part.claims = claims(points, part.slopes)
    return part


def claims(points: list[Point], slopes: list[Slope]) -> list[str]:
    orders = ", ".join(f"{s.series} {s.fitted:.3f} ± {s.standard_error:.3f} (theory: {s.expected})" for s in slopes)
    phong = sorted((p for p in points if p.series == "phong"), key=lambda p: p.knob["subdivisions"])
    flat = max((p for p in points if p.series == "flat"), key=lambda p: p.knob["subdivisions"])
    as_good = next(p for p in [*phong, phong[-1]] if p.error["rmse"] <= flat.error["rmse"] or p is phong[-1])
    return [
        f"Orders of convergence in the length of an edge: {orders}.",
        f"Phong interpolation of {as_good.knob['triangles']} triangles has an error of {as_good.error['rmse']:.1e} in"
        f" {milliseconds(1000 * as_good.seconds['median'])} ms; flat faces have {flat.error['rmse']:.1e} with"
        f" {flat.knob['triangles']}, in {milliseconds(1000 * flat.seconds['median'])} ms.",
    ]
