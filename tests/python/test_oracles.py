"""The solutions against programs that nobody here wrote: POV-Ray's pictures and Mitsuba's functions.

    ./shadelab test --slow -k oracles

Neither program is needed by the project. Where one is missing its tests are skipped, and say how to install it.
"""

import shutil
import subprocess

import numpy as np
import pytest

from conftest import ROOT
from shadelab.truth.expected import CHANNELS, INTERIOR, scene_mask
from test_models import BUILDS, dot, evaluate, unit

pytestmark = pytest.mark.oracle

# ------------------------------------------------------------------------------------------------------- POV-Ray

# Half a step of POV-Ray's 16-bit output (7.63e-6), and float32 on its way: POV-Ray's colours are that (values up to 1, so a few
# times 6e-8), and so are our float builds, whose vectors' rounding (1e-7) a lobe multiplies by up to its slope (5 for q = 60).
STEP = 0.5 / 65535
PICTURE_LIMITS = {"double": STEP + 2e-7, "float": STEP + 2e-6, "glsl": STEP + 4e-6}

WIDTH, HEIGHT = 160, 120


class Camera:
    """POV-Ray's own vectors: `right` and `up` span the picture, so no rule about handedness or field of view is in it."""

    def __init__(self, eye, target, up, fov_y):
        self.eye = np.array(eye, float)
        self.direction = unit(np.array(target, float) - self.eye)
        right = unit(np.cross(self.direction, up))
        height = 2 * np.tan(np.radians(fov_y) / 2)
        self.right, self.up = right * height * WIDTH / HEIGHT, np.cross(right, self.direction) * height

    def __str__(self):
        names = ("direction", "right", "up")
        vectors = " ".join(f"{name} {pov(getattr(self, name))}" for name in names)
        return f"camera {{ perspective location {pov(self.eye)} {vectors} }}"

    def rays(self) -> np.ndarray:
        """(HEIGHT, WIDTH, 3) unit vectors through the middles of the pixels."""
        x, y = np.meshgrid((np.arange(WIDTH) + 0.5) / WIDTH - 0.5, 0.5 - (np.arange(HEIGHT) + 0.5) / HEIGHT)
        return unit(self.direction + x[..., None] * self.right + y[..., None] * self.up)


def pov(vector) -> str:
    return "<" + ", ".join(f"{x:.17g}" for x in vector) + ">"


@pytest.fixture
def povray(tmp_path):
    """povray(text): the picture of a scene, linear, (HEIGHT, WIDTH, 3), in steps of 1/65535."""
    program = shutil.which("povray")
    if program is None:
        pytest.skip("POV-Ray is not installed: apt-get install --no-install-recommends povray")

    def draw(text: str) -> np.ndarray:
        (tmp_path / "scene.pov").write_text(
            "#version 3.7; global_settings { assumed_gamma 1 ambient_light 0 }\n" + text
        )
        command = [program, "+Iscene.pov", "+Oscene.ppm", "+FP16", f"+W{WIDTH}", f"+H{HEIGHT}", "-D", "-A", "-GA"]
        command += ["+Q9", "File_Gamma=1", "Dither=off"]
        done = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True, timeout=60)
        assert done.returncode == 0, done.stderr[-2000:]
        data = (tmp_path / "scene.ppm").read_bytes()
        assert b"\n65535\n" in data[:400]
        numbers = np.frombuffer(data.split(b"\n65535\n", 1)[1], ">u2")
        return numbers.reshape(HEIGHT, WIDTH, 3) / 65535

    return draw


def plain(**finish: float) -> str:
    """A white material with only the named parts. (`shadowless` lights would have no highlights; no_shadow keeps them.)"""
    values = {"ambient": 0, "emission": 0, "diffuse": 0, **finish}
    return "no_shadow pigment { rgb 1 } finish { " + " ".join(f"{k} {v:.17g}" for k, v in values.items()) + " }"


def sphere_points(camera: Camera) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Which pixels see the unit sphere about the origin, and there x (the normal too) and v."""
    rays = camera.rays()
    b = dot(rays, camera.eye)
    inside = b**2 - dot(camera.eye, camera.eye) + 1
    # The outermost ring is left out: there the intersection itself loses digits.
    seen = inside > 1e-4
    rays = rays[seen]
    t = -b[seen] - np.sqrt(inside[seen])
    return seen, unit(camera.eye + t[:, None] * rays), -rays


def plane_points(camera: Camera) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Which pixels see the plane y = 0, and there x and v."""
    rays = camera.rays()
    seen = rays[..., 1] < -1e-3
    rays = rays[seen]
    return seen, camera.eye - camera.eye[1] / rays[:, 1:2] * rays, -rays


def largest_difference(ours: np.ndarray, picture: np.ndarray) -> float:
    """Over all pixels; the picture must hold something, and nothing that is cut off at white."""
    assert (picture > 0.02).mean() > 0.01 and 0.3 < picture.max() < 1
    return float(np.abs(ours - picture).max())


SPHERE_CAMERA = Camera([0.5, 1.0, 3.2], [0, 0, 0], [0, 1, 0], 40)
PLANE_CAMERA = Camera([0.7, 2.5, 4.0], [0.2, 0, 0], [0, 1, 0], 45)


@pytest.mark.parametrize("q", [1, 8, 60])
@pytest.mark.parametrize(
    "model, finish", [("phong", lambda q: {"phong": 1, "phong_size": q}), ("blinn_phong", lambda q: {"specular": 1, "roughness": 1 / q})],
    ids=["phong", "blinn_phong"],
)  # fmt: skip
def test_highlights_are_povrays(povray, model, finish, q):
    """On a sphere, with one light behind its shoulder: without the gate n.l > 0 both lobes would leak onto the dark side."""
    position, colour = np.array([2.5, 1.0, -1.8]), np.array([0.95, 0.6, 0.3])
    picture = povray(
        f"{SPHERE_CAMERA}\nlight_source {{ {pov(position)} rgb {pov(colour)} }}\n"
        f"sphere {{ <0, 0, 0>, 1 {plain(**finish(q))} }}"
    )
    seen, x, v = sphere_points(SPHERE_CAMERA)
    l = unit(position - x)
    assert (dot(x, l) < 0).any() and (dot(x, l) > 0).any()
    m = {"ka": np.zeros(3), "kd": np.zeros(3), "ks": colour, "q": float(q)}
    for build in BUILDS:
        terms = evaluate(build, "phong", model, m=m, n=x, l=l, v=v)
        assert largest_difference(terms["specular"], picture[seen]) <= PICTURE_LIMITS[build], build


def light_rows(rows: int, **members) -> dict[str, np.ndarray]:
    defaults = {
        "kind": 0, "position": np.zeros(3), "direction": np.array([0, -1.0, 0]), "intensity": np.ones(3),
        "attenuation": np.array([0, 0, 1.0]), "hotspot": 0.1, "falloff": 0.2,
    }  # fmt: skip
    return {k: np.broadcast_to(v, (rows, *np.shape(v))) for k, v in {**defaults, **members}.items()}


SPOTS = {"soft": (12, 24), "wide": (2, 55), "narrow": (20, 21)}


@pytest.mark.parametrize("hotspot, falloff", SPOTS.values(), ids=SPOTS)
def test_spotlights_are_povrays(povray, hotspot, falloff):
    """On a plane, diffuse, no falloff with the distance. POV-Ray's `radius` and `falloff` are half-angles as ours are; its
    `tightness` must be 0."""
    position, aim, colour = np.array([0.5, 2.0, 1.0]), np.array([0.0, 0, 0.2]), np.array([0.9, 0.7, 0.4])
    picture = povray(
        f"{PLANE_CAMERA}\nlight_source {{ {pov(position)} rgb {pov(colour)} spotlight point_at {pov(aim)} "
        f"radius {hotspot} falloff {falloff} tightness 0 }}\nplane {{ y, 0 {plain(diffuse=1)} }}"
    )
    seen, x, _ = plane_points(PLANE_CAMERA)
    up, axis = np.array([0, 1.0, 0]), unit(aim - position)
    angles = {"hotspot": np.radians(hotspot), "falloff": np.radians(falloff)}
    light = light_rows(len(x), kind=2, position=position, direction=axis, intensity=colour, **angles)
    # The ramp is steep where the cosines of its ends are close: their float32 rounding counts more.
    steep = 6e-8 * 1.5 / (np.cos(angles["hotspot"]) - np.cos(angles["falloff"]))
    for build in BUILDS:
        arriving = evaluate(build, "lights", "incident_light", light=light, x=x)
        ours = evaluate(build, "lights", "irradiance", light=arriving, n=up)["result"]
        limit = PICTURE_LIMITS[build] + (0 if build == "double" else 2 * steep)
        assert largest_difference(ours, picture[seen]) <= limit, build


@pytest.mark.parametrize("distance", [0.7, 2.0, 6.0])
def test_the_distance_fade_is_povrays(povray, distance):
    """2 / (1 + (r / distance)^2) is the lecture's 1 / (a r^2 + b r + c) with a = 1 / (2 distance^2), b = 0, c = 1/2."""
    position, colour = np.array([0.5, 0.8, 1.0]), np.array([0.48, 0.3, 0.2])
    picture = povray(
        f"{PLANE_CAMERA}\nlight_source {{ {pov(position)} rgb {pov(colour)} fade_distance {distance} fade_power 2 }}\n"
        f"plane {{ y, 0 {plain(diffuse=1)} }}"
    )
    seen, x, _ = plane_points(PLANE_CAMERA)
    abc = np.array([1 / (2 * distance**2), 0, 0.5])
    for build in BUILDS:
        light = light_rows(len(x), position=position, intensity=colour, attenuation=abc)
        arriving = evaluate(build, "lights", "incident_light", light=light, x=x)
        ours = evaluate(build, "lights", "irradiance", light=arriving, n=np.array([0, 1.0, 0]))["result"]
        assert largest_difference(ours, picture[seen]) <= PICTURE_LIMITS[build], build


# A whole picture: our scene file, camera, rasterizer and light loop against POV-Ray's. The floor is our plane mesh.
SCENE = """
[film]
width = {width}
height = {height}

[camera]
eye = {eye}
target = {target}
up = [0, 1, 0]
fov_y = {fov}
near = 0.1
far = 100

[[light]]
kind = "spot"
position = [-1.2, 2.4, 0.8]
direction = [0.9, -2.4, -0.9]
hotspot = 8
falloff = 28
intensity = [0.4, 0.7, 1.0]
attenuation = [0, 0, 1]

[[light]]
kind = "point"
position = [1.0, 1.5, -1.5]
intensity = [0.9, 0.6, 0.3]
attenuation = [{a}, 0, 0.5]

[material.floor]
model = "phong"
ka = [0, 0, 0]
kd = [0.5, 0.5, 0.5]
ks = [0.5, 0.5, 0.5]
q = 40

[[object]]
mesh = "{mesh}"
material = "floor"
scale = 4
"""


def test_a_whole_picture_is_povrays(povray, shadelab, tmp_path):
    eye, target, fov, fade = [0.4, 1.6, 3.4], [0, 0, 0], 38, 1.5
    scene = tmp_path / "floor.toml"
    mesh = ROOT / "scenes" / "meshes" / "plane.obj"
    text = {
        "width": WIDTH,
        "height": HEIGHT,
        "eye": eye,
        "target": target,
        "fov": fov,
        "a": 1 / (2 * fade**2),
        "mesh": mesh,
    }
    scene.write_text(SCENE.format(**text))
    camera = Camera(eye, target, [0, 1, 0], fov)
    picture = povray(
        f"{camera}\n"
        "light_source { <-1.2, 2.4, 0.8> rgb <0.4, 0.7, 1.0> spotlight point_at <-0.3, 0, -0.1> radius 8 falloff 28 tightness 0 }\n"
        f"light_source {{ <1.0, 1.5, -1.5> rgb <0.9, 0.6, 0.3> fade_distance {fade} fade_power 2 }}\n"
        f"plane {{ y, 0 {plain(diffuse=0.5, phong=0.5, phong_size=40)} }}"
    )
    for build, options in BUILDS.items():
        done = shadelab("render", scene, "--layers", "-o", "image.npy", *options)
        assert done.code == 0, done.stderr
        image = np.load(tmp_path / "image.npy")
        interior = scene_mask(image, camera.eye, np.radians(fov) / HEIGHT) == INTERIOR
        assert interior.mean() > 0.3
        total = image[..., CHANNELS["total"]][interior]
        # Positions come from the rasterizer, in float32 in every build: 4e-7 of the distance, times the slope of the picture.
        assert largest_difference(total, picture[interior]) <= PICTURE_LIMITS[build] + 4e-6, build


# ------------------------------------------------------------------------------------------------------- Mitsuba


@pytest.fixture(scope="module")
def mitsuba():
    module = pytest.importorskip("mitsuba", reason="Mitsuba is not installed: pip install 'shadelab[oracle]'")
    module.set_variant("scalar_rgb")
    return module


# Mitsuba computes in float32 as well.
COSINES = np.concatenate([[0.0, 1.0], np.exp(np.linspace(np.log(1e-3), 0, 40))[:-1], np.linspace(0.01, 0.99, 99)])
COSINES = COSINES.astype(np.float32).astype(float)
# Of a reflectance, absolute. Its slope is largest at grazing angles, and near an index of 1 differences of close numbers enter.
FRESNEL_LIMITS = {"double": 2e-6, "float": 3e-6, "glsl": 3e-6}


def test_fresnel_dielectric_is_mitsubas(mitsuba):
    iors = (
        np.array([0.6, 0.75, 1.0, 1.1, 1.33, 1.5, 1.8, 2.4, 4.0]).astype(np.float32).astype(float)
    )  # below 1: total reflection
    ior, c = (g.ravel() for g in np.meshgrid(iors, COSINES))
    # Near the angle of total reflection the cosine inside is the root of a small difference, of which float32 keeps few digits.
    sharp = (ior < 1) & (np.abs(1 - (1 - c**2) / ior**2) < 1e-2)
    assert sharp.mean() < 0.01
    ior, c = ior[~sharp], c[~sharp]
    theirs = np.array([mitsuba.fresnel(float(x), float(i))[0] for x, i in zip(c, ior)])
    assert (theirs[ior < 1] == 1).any() and (theirs[ior == 1] == 0).all()
    for build, limit in FRESNEL_LIMITS.items():
        ours = evaluate(build, "microfacet", "fresnel_dielectric", ior=ior, c=c)["result"]
        assert np.abs(ours - theirs).max() <= limit, build


METALS = {  # refractive index and absorption, red, green and blue: near gold, copper, silver, and a metal of no colour
    "gold": ([0.18, 0.42, 1.37], [3.42, 2.35, 1.77]),
    "copper": ([0.27, 0.68, 1.32], [3.61, 2.63, 2.29]),
    "silver": ([0.16, 0.14, 0.14], [3.95, 3.19, 2.37]),
    "chromium-like": ([3.1, 3.18, 2.17], [3.3, 3.33, 3.24]),
}


@pytest.mark.parametrize("eta, k", METALS.values(), ids=METALS)
def test_fresnel_conductor_is_mitsubas(mitsuba, eta, k):
    eta, k = (np.array(a).astype(np.float32).astype(float) for a in (eta, k))
    theirs = np.array(
        [
            [mitsuba.fresnel_conductor(float(c), mitsuba.ScalarComplex2f(float(e), float(a))) for e, a in zip(eta, k)]
            for c in COSINES
        ]
    )
    rows = {"eta": np.tile(eta, (len(COSINES), 1)), "k": np.tile(k, (len(COSINES), 1)), "c": COSINES}
    for build, limit in FRESNEL_LIMITS.items():
        ours = evaluate(build, "microfacet", "fresnel_conductor", **rows)["result"]
        assert np.abs(ours - theirs).max() <= limit, build


# Relative. Both exponentials take a number up to 12 whose rounding counts 12 times 6e-8, and a few operations more.
DISTRIBUTION_LIMITS = {"double": 6e-6, "float": 1.2e-5, "glsl": 2e-5}


@pytest.mark.parametrize("name, kind", [("beckmann", "Beckmann"), ("trowbridge_reitz", "GGX")])
@pytest.mark.parametrize("m", [0.05, 0.2, 0.5, 0.9])
def test_distributions_of_normals_are_mitsubas(mitsuba, name, kind, m):
    """Mitsuba's D integrates to 1 over the projected hemisphere, the lecture's to pi."""
    m = float(np.float32(m))
    rng = np.random.default_rng(3)
    # Slopes out to where Beckmann's exponential is e^-12.
    slope = m * np.sqrt(12 * rng.uniform(0, 1, 600))
    phi = rng.uniform(0, 2 * np.pi, 600)
    h = (
        unit(np.stack([slope * np.cos(phi), slope * np.sin(phi), np.ones(600)], axis=1))
        .astype(np.float32)
        .astype(float)
    )
    distribution = mitsuba.MicrofacetDistribution(getattr(mitsuba.MicrofacetType, kind), m)
    theirs = np.pi * np.array([distribution.eval(mitsuba.Vector3f(*map(float, row))) for row in h])
    for build, limit in DISTRIBUTION_LIMITS.items():
        ours = evaluate(build, "microfacet", name, n=np.array([0, 0, 1.0]), h=h, m=m)["result"]
        assert (np.abs(ours - theirs) / theirs).max() <= limit, build
