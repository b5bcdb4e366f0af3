"""What the models promise beyond their formulas: reciprocity, energy, the ratios between normalisations, linear lights.

A model's Terms hold the cosine where it takes one, so its BRDF is f = (diffuse + specular) / n.l, and the fraction of light that
a white furnace sends back towards v (the albedo) is the integral of diffuse + specular over the light directions.
"""

import tempfile
from functools import cache
from pathlib import Path

import numpy as np
import pytest
from typer.testing import CliRunner

from conftest import ROOT
from shadelab.cli.app import program

BUILDS = {"double": ["--double"], "float": [], "glsl": ["--backend", "glsl"]}
PI = np.pi

# How far two evaluations of one formula may lie apart (see `apart`). A lobe multiplies the rounding of the vectors that lead to
# it by q <= 64 or by 1 / m^2 <= 25; with the rest of a model that is at most some hundred eps: 1.1e-16 in double, 6e-8 in GLSL,
# where the rounding of the inputs to float32 and the driver's exp and log come in as well.
LIMITS = {"double": 1e-13, "glsl": 2e-5}


def evaluate(build: str, assignment: str, function: str, **inputs: np.ndarray) -> dict[str, np.ndarray]:
    """The solution's function through `./shadelab eval` (in this process, to save its start): {"result": ...} or the members.

    A struct's members are given as m={"kd": ...}. What has no first axis holds for every row.
    """
    flat = {}
    for name, value in inputs.items():
        flat |= {f"{name}.{k}": v for k, v in value.items()} if isinstance(value, dict) else {name: value}
    rows = max(len(v) for v in flat.values() if np.ndim(v))
    arrays = {
        k: v if np.ndim(v) and len(v) == rows else np.broadcast_to(v, (rows, *np.shape(v))) for k, v in flat.items()
    }
    with tempfile.TemporaryDirectory() as folder:
        given, got = Path(folder) / "in.npz", Path(folder) / "out.npz"
        np.savez(given, **arrays)
        command = ["eval", ROOT / "solution" / assignment, function, "--inputs", given, "-o", got, *BUILDS[build]]
        done = CliRunner().invoke(program(), list(map(str, command)))
        assert done.exit_code == 0, (function, done.exception, done.output)
        return {name.removeprefix("result."): array.astype(float) for name, array in np.load(got).items()}


def unit(v: np.ndarray) -> np.ndarray:
    return v / np.linalg.norm(v, axis=-1, keepdims=True)


def dot(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    return np.sum(a * b, axis=-1)


def light(terms: dict[str, np.ndarray]) -> np.ndarray:
    """What a light contributes, without ambient."""
    return terms["diffuse"] + terms["specular"]


def apart(a: np.ndarray, b: np.ndarray) -> float:
    """The largest difference, relative to the value; values below 1e-3 of the largest count as that."""
    return float(np.max(np.abs(a - b) / np.maximum(np.abs(b), 1e-3 * np.abs(b).max())))


# --------------------------------------------------------------------------------------------- one table for all

ASSIGNMENT = {
    "lambert": "lights", "lambert_physical": "lights",
    "phong": "phong", "blinn_phong": "phong", "phong_physical": "phong", "blinn_phong_ngan": "phong",
    "cook_torrance": "microfacet", "cook_torrance_physical": "microfacet", "cook_torrance_ngan": "microfacet",
    "two_lobes": "microfacet", "metal": "microfacet", "plastic": "microfacet",
}  # fmt: skip


@cache
def directions() -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """n, l, v with both directions at least 6 degrees above the horizon; half of the v near the mirror image of l, where
    highlights are."""
    rng = np.random.default_rng(837)
    n, l, v = (unit(rng.normal(size=(4000, 3))) for _ in range(3))
    l *= np.sign(dot(n, l))[:, None]
    mirror = 2 * dot(n, l)[:, None] * n - l
    v *= np.sign(dot(n, v))[:, None]
    v[::2] = unit(mirror[::2] + 0.2 * rng.normal(size=(2000, 3)))
    keep = (dot(n, l) > 0.1) & (dot(n, v) > 0.1)
    return n[keep], l[keep], v[keep]


@cache
def materials(model: str) -> dict[str, np.ndarray]:
    """The members of the model's struct: colours in [0, 1], q in 1 to 64, m in 0.2 to 0.8. The same for models of one struct."""
    rng = np.random.default_rng(42)
    rows = len(directions()[0])

    def colour():
        return rng.uniform(0, 1, (rows, 3)).astype(np.float32)

    def width():
        return rng.uniform(0.2, 0.8, rows).astype(np.float32)

    if model.startswith("lambert"):
        return {"kd": colour()}
    if ASSIGNMENT[model] == "phong":
        q = np.exp(rng.uniform(0, np.log(64), rows)).astype(np.float32)
        return {"ka": colour(), "kd": colour(), "ks": colour(), "q": q}
    if model == "metal":
        return {"eta": 0.1 + 3 * colour(), "k": 1 + 5 * colour(), "m": width()}
    if model == "plastic":
        return {"kd": colour(), "ior": rng.uniform(1.1, 2.4, rows).astype(np.float32), "m": width()}
    first = {"kd": colour(), "rho_s": colour(), "f0": colour(), "m": width()}
    if model == "two_lobes":
        one = {f"{name}1": value for name, value in first.items() if name != "kd"}
        two = {"rho_s2": colour(), "f02": colour(), "m2": width()}
        return {"kd": first["kd"], **one, **two}
    return first


# Their GLSL has nothing that the GLSL of the others lacks, and each run of OpenGL takes a second.
DOUBLE_ONLY = {"lambert_physical", "phong", "blinn_phong", "metal", "plastic"}


@cache
def both_ways(model: str) -> dict[str, tuple[dict, dict]]:
    """For each build: the model's terms for (l, v) and for (v, l) on the common table."""
    builds = [build for build in LIMITS if build == "double" or model not in DOUBLE_ONLY]
    n, l, v = directions()
    m = {name: np.concatenate([value, value]) for name, value in materials(model).items()}
    inputs = {"m": m, "n": np.concatenate([n, n]), "l": np.concatenate([l, v]), "v": np.concatenate([v, l])}
    results = [evaluate(build, ASSIGNMENT[model], model, **inputs) for build in builds]
    half = len(n)
    return {
        build: ({k: a[:half] for k, a in terms.items()}, {k: a[half:] for k, a in terms.items()})
        for build, terms in zip(builds, results)
    }


# --------------------------------------------------------------------------------------------------- reciprocity

RECIPROCAL = [
    "lambert", "lambert_physical", "phong_physical", "blinn_phong_ngan", "cook_torrance", "cook_torrance_physical", "two_lobes",
    "metal", "plastic",
]  # fmt: skip


@pytest.mark.parametrize("model", RECIPROCAL)
def test_light_and_view_may_be_exchanged(model):
    n, l, v = directions()
    for build, (there, back) in both_ways(model).items():
        f, g = light(there) / dot(n, l)[:, None], light(back) / dot(n, v)[:, None]
        assert f.max() > 0.1, build
        assert apart(f, g) <= LIMITS[build], build


@pytest.mark.parametrize("model", ["phong", "blinn_phong"])
def test_the_lectures_highlights_are_not_reciprocal(model):
    """They take no cosine: as a BRDF they are ks lobe / n.l, which is another number when l and v change places. The lobes
    themselves are symmetric."""
    n, l, v = directions()
    for build, (there, back) in both_ways(model).items():
        f, g = there["specular"] / dot(n, l)[:, None], back["specular"] / dot(n, v)[:, None]
        assert np.median(np.abs(f - g)[f > 1e-3] / f[f > 1e-3]) > 0.1, build
        assert apart(there["specular"], back["specular"]) <= LIMITS[build], build


# -------------------------------------------------------------------------------------------------------- ratios


@pytest.mark.parametrize("variant, factor", [("cook_torrance_physical", 4.0), ("cook_torrance_ngan", PI)])
def test_the_lectures_highlight_is_a_multiple_of_the_others(variant, factor):
    """The lecture's D integrates to pi and its K has no 4: 4 times the physical highlight, and pi times the one of the fits.
    Their kd is an albedo, the lecture's holds 1/pi already."""
    for build, limit in {"double": 4e-16, "glsl": 3e-7}.items():  # the factor's own rounding; there is nothing else
        lecture, other = both_ways("cook_torrance")[build][0], both_ways(variant)[build][0]
        assert lecture["specular"].max() > 0.1
        assert apart(lecture["specular"], factor * other["specular"]) <= limit, build
        assert apart(lecture["diffuse"], PI * other["diffuse"]) <= limit, build


def test_two_lobes_are_the_sum_of_two_highlights_and_one_diffuse_term():
    n, l, v = directions()
    m = materials("two_lobes")
    members = ("rho_s", "f0", "m")
    second = {"kd": m["kd"], **{name: m[f"{name}2"] for name in members}}
    for name in members:  # the table's first lobe is what cook_torrance has there
        np.testing.assert_array_equal(m[f"{name}1"], materials("cook_torrance")[name])
    for build in LIMITS:
        two = evaluate(build, "microfacet", "cook_torrance", m=second, n=n, l=l, v=v)
        one, both = both_ways("cook_torrance")[build][0], both_ways("two_lobes")[build][0]
        assert apart(both["specular"], one["specular"] + two["specular"]) <= LIMITS[build] / 10, build
        assert apart(both["diffuse"], one["diffuse"]) <= LIMITS[build] / 10, build


# -------------------------------------------------------------------------------------------------------- energy

# Of the quadrature: doubling its nodes in both directions changes no albedo below by more than 5e-4 of itself.
QUADRATURE = 1e-3
ANGLES = [0, 30, 60, 75, 85]  # of v, degrees
ALONG, AROUND = 128, 96


@cache
def hemisphere(degrees: float, along: int = ALONG, around: int = AROUND) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """v at this angle from n = z, all light directions, and their solid angles. The nodes are polar coordinates about the
    mirror image of v, densest there: radius pi u^3 with Gauss nodes in u and in half the circle (both halves are alike)."""
    u, weight_u = np.polynomial.legendre.leggauss(along)
    phi, weight_phi = np.polynomial.legendre.leggauss(around)
    u, weight_u = (u + 1) / 2, weight_u / 2
    phi, weight_phi = PI * (phi + 1) / 2, PI * weight_phi
    radius = PI * u**3
    solid = np.outer(np.sin(radius) * 3 * PI * u**2 * weight_u, weight_phi)
    a = np.radians(degrees)
    v, mirror = np.array([np.sin(a), 0, np.cos(a)]), np.array([-np.sin(a), 0, np.cos(a)])
    across, up = np.array([0, 1, 0]), np.array([np.cos(a), 0, np.sin(a)])
    ring = np.cos(phi)[:, None] * up + np.sin(phi)[:, None] * across
    l = np.cos(radius)[:, None, None] * mirror + np.sin(radius)[:, None, None] * ring
    above = l[..., 2] > 0
    return v, l[above], solid[above]


def albedos(model: str, cases: list[dict], angles: list[float] = ANGLES, **nodes: int) -> np.ndarray:
    """(cases, angles): the part of a white furnace's light that goes towards v."""
    parts = [(m, *hemisphere(angle, **nodes)) for m in cases for angle in angles]
    counts = [len(l) for _, _, l, _ in parts]
    m = {
        name: np.concatenate([np.broadcast_to(m[name], (k, *np.shape(m[name]))) for (m, *_), k in zip(parts, counts)])
        for name in cases[0]
    }
    l = np.concatenate([l for _, _, l, _ in parts])
    v = np.concatenate([np.broadcast_to(v, (k, 3)) for (_, v, _, _), k in zip(parts, counts)])
    values = light(evaluate("double", ASSIGNMENT[model], model, m=m, n=np.array([0, 0, 1.0]), l=l, v=v))[:, 0]
    solid = np.concatenate([w for *_, w in parts])
    sums = np.add.reduceat(values * solid, np.cumsum([0, *counts[:-1]]))
    return sums.reshape(len(cases), len(angles))


def grey(x: float) -> np.ndarray:
    return np.full(3, x)


def phong_material(kd: float, ks: float, q: float) -> dict:
    return {"ka": grey(0), "kd": grey(kd), "ks": grey(ks), "q": q}


def microfacet_material(m: float) -> dict:
    return {"kd": grey(0), "rho_s": grey(1), "f0": grey(1), "m": m}


def test_the_physical_lambert_returns_all_light_and_the_lectures_pi_times_as_much():
    np.testing.assert_allclose(albedos("lambert_physical", [{"kd": grey(1)}]), 1, atol=QUADRATURE)
    np.testing.assert_allclose(albedos("lambert", [{"kd": grey(1)}]), PI, atol=PI * QUADRATURE)


def test_the_physical_phong_creates_no_light():
    cases = [phong_material(kd, 1 - kd, q) for kd in (0, 0.3) for q in (0, 1, 20, 200)]
    albedo = albedos("phong_physical", cases)
    assert albedo.max() <= 1 + QUADRATURE
    np.testing.assert_allclose(albedo[:, 0], 1, atol=QUADRATURE)  # at normal incidence all of it comes back
    np.testing.assert_allclose(
        albedo[2, ANGLES.index(75) :], [0.27, 0.14], atol=5e-3 + QUADRATURE
    )  # q = 20: much is lost


def test_the_half_vector_lobe_of_the_fits_does():
    """(q + 2) / 2 pi normalises a distribution of normals. As the factor of a half-vector BRDF it is nearly 4 times too large."""
    albedo = albedos("blinn_phong_ngan", [phong_material(0, 1, 20), phong_material(0, 1, 200)], [0])
    np.testing.assert_allclose(albedo[:, 0], [3.33, 3.92], atol=5e-3 + QUADRATURE)


def test_the_lectures_phong_reflects_pi_kd_and_2_pi_ks_over_q_plus_2():
    """Of light along n. Here v is what moves, and the cosine is the viewer's."""
    cases = [(0.2, 0.5, 0.0), (0.2, 0.5, 1.0), (0.1, 0.9, 20.0), (0.0, 1.0, 500.0)]
    n, v, solid = hemisphere(0)
    rows = {"n": n, "l": n, "v": np.concatenate([v] * len(cases))}
    m = {
        "ka": grey(0),
        "kd": np.repeat([grey(kd) for kd, _, _ in cases], len(v), axis=0),
        "ks": np.repeat([grey(ks) for _, ks, _ in cases], len(v), axis=0),
        "q": np.repeat([q for _, _, q in cases], len(v)),
    }
    leaving = light(evaluate("double", "phong", "phong", m=m, **rows))[:, 0].reshape(len(cases), -1)
    reflected = leaving @ (solid * v[:, 2])
    wanted = [PI * kd + 2 * PI * ks / (q + 2) for kd, ks, q in cases]
    np.testing.assert_allclose(reflected, wanted, rtol=QUADRATURE)


WIDTHS = [0.1, 0.3, 0.6]


def test_the_physical_microfacets_create_no_light_and_the_lectures_do():
    albedo = albedos("cook_torrance_physical", [microfacet_material(m) for m in WIDTHS])
    assert albedo.max() <= 1 + QUADRATURE
    np.testing.assert_allclose(albedo[:, 0], [1.0, 0.996, 0.798], atol=5e-4 + QUADRATURE)
    lecture = albedos("cook_torrance", [microfacet_material(m) for m in WIDTHS], [0])[:, 0]
    np.testing.assert_allclose(lecture, [4.0, 3.98, 3.19], atol=5e-3 + QUADRATURE)


@pytest.mark.parametrize("distribution", ["beckmann", "trowbridge_reitz"])
def test_distributions_of_normals_integrate_to_pi(distribution):
    """The lecture's D has no 1/pi: its projected area over the hemisphere is pi, whatever m."""
    _, h, solid = hemisphere(0)
    rows = {"n": np.array([0, 0, 1.0]), "h": np.concatenate([h] * len(WIDTHS)), "m": np.repeat(WIDTHS, len(h))}
    d = evaluate("double", "microfacet", distribution, **rows)["result"].reshape(len(WIDTHS), -1)
    np.testing.assert_allclose(d @ (solid * h[:, 2]), PI, rtol=QUADRATURE)


# ------------------------------------------------------------------------------------------- widths of highlights


@cache
def ring(along: bool) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """l at 0 to 75 degrees, and v a small angle off the mirror direction, in the plane of incidence or across it. Returns the
    angle of incidence, the small angle, l and v."""
    incidence, off = (g.ravel() for g in np.meshgrid(np.radians([0, 20, 40, 60, 75]), np.linspace(0.01, 0.1, 10)))
    l = np.stack([np.sin(incidence), 0 * off, np.cos(incidence)], axis=1)
    mirror = l * [-1, 1, 1]
    side = np.stack([np.cos(incidence), 0 * off, np.sin(incidence)], axis=1) if along else np.array([[0, 1.0, 0]])
    return incidence, off, l, mirror * np.cos(off)[:, None] + side * np.sin(off)[:, None]


@pytest.mark.parametrize("along", [True, False], ids=["in-plane", "across"])
def test_four_times_the_exponent_gives_the_half_vector_lobe_the_same_width(along):
    """In the plane of incidence h turns by half of what v turns, so (n.h)^(4q) is (v.r)^q near the peak. Across it, the
    half-vector lobe is narrower by the cosine of the angle of incidence. The next order of the angle bounds what is left."""
    incidence, off, l, v = ring(along)
    rows = {"n": np.array([0, 0, 1.0]), "l": l, "v": v}
    phong = evaluate("double", "phong", "phong_lobe", **rows, q=20.0)["result"]
    blinn = evaluate("double", "phong", "blinn_lobe", **rows, q=80.0)["result"]
    squeezed = 1.0 if along else np.cos(incidence) ** 2
    ratio = np.log(blinn) * squeezed / np.log(phong)
    bound = off**2 / 7 if along else off**2 / (2 * squeezed)
    assert np.all(np.abs(ratio - 1) <= bound)


# -------------------------------------------------------------------------------------------------------- lights


@cache
def some_lights() -> tuple[dict[str, np.ndarray], np.ndarray]:
    """Lights of every kind, all but their intensities, and points that they shine on."""
    rng = np.random.default_rng(5)
    rows = 900
    x = rng.uniform(-1, 1, (rows, 3)).astype(np.float32)
    position = rng.uniform(-3, 3, (rows, 3)).astype(np.float32)
    members = {
        "kind": np.arange(rows) % 3,
        "position": position,
        "direction": unit(unit(x - position) + 0.3 * rng.normal(size=(rows, 3))).astype(np.float32),
        "attenuation": rng.uniform(0, 1, (rows, 3)).astype(np.float32),
        "hotspot": np.full(rows, 0.2),
        "falloff": np.full(rows, 0.9),
    }
    return members, x


def test_lights_are_linear():
    """I(a) + I(b) = I(a + b) to rounding; I(2^k a) = 2^k I(a) bit for bit; the direction does not change."""
    members, x = some_lights()
    rng = np.random.default_rng(6)
    # Multiples of 1/256: a + b is exact in float32.
    a, b = (rng.integers(1, 2048, (len(x), 3)) / 256 for _ in range(2))
    intensities = [a, b, a + b, a * 2.0**10, a * 2.0**-10]
    light = {name: np.concatenate([value] * len(intensities)) for name, value in members.items()}
    light["intensity"] = np.concatenate(intensities)
    points = np.concatenate([x] * len(intensities))
    for build, limit in {"double": 1e-15, "glsl": 4e-7}.items():  # two products and a sum are rounded
        incident = evaluate(build, "lights", "incident_light", light=light, x=points)
        e = incident["e"].reshape(len(intensities), len(x), 3)
        l = incident["l"].reshape(len(intensities), len(x), 3)
        for kind in range(3):  # most of the points lie in the light
            assert (e[0][members["kind"] == kind] > 0).any(axis=1).mean() > 0.5, (build, kind)
        assert np.all(np.abs(e[0] + e[1] - e[2]) <= limit * np.abs(e[2])), build
        np.testing.assert_array_equal(e[3], e[0] * 2.0**10, build)
        np.testing.assert_array_equal(e[4], e[0] * 2.0**-10, build)
        assert np.all(l == l[0]), build
