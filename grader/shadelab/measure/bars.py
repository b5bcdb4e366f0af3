"""The JSON of a benchmark, and what it must hold."""

from collections.abc import Callable
from typing import Any

from shadelab.measure.declaration import Declaration
from shadelab.measure.standing import WITHOUT_AVX2
from shadelab.measure.timing import geometric_mean


def assemble(
    declared: Declaration,
    machine: dict[str, Any],
    settings: dict[str, Any],
    results: list[dict[str, Any]],
    skipped: list[dict[str, str]],
) -> dict[str, Any]:
    """The JSON of a run (contracts: machine, cases; the rest is ours)."""

    def section(name: str) -> list[dict[str, Any]]:
        return [r for r in results if r["name"].startswith(f"{name}/")]

    apart = {name: section(name) for name in ("full", "threads", "supersampling", "load", "omissions")}
    cases = [r for r in results if not any(r in part for part in apart.values())]
    peers = sorted({c["peer"]["name"] for c in [*cases, *apart["full"]]})
    kinds = ("name", "geometry_bytes", "framebuffer_bytes", "peak_bytes")
    memory = [{kind: c[kind] for kind in kinds} for c in cases if c["mesh"].endswith("-1m")]
    beside = [m["peak_bytes"] - m["geometry_bytes"] - m["framebuffer_bytes"] for m in memory]
    bars = held_against_bars(declared, cases, apart, settings["level"], beside)
    return {"machine": {**machine, "peer": peers}, "settings": settings, "cases": cases, **apart,
            "memory": memory, "skipped": skipped, "bars": bars}  # fmt: skip


def held_against_bars(
    declared: Declaration,
    cases: list[dict[str, Any]],
    apart: dict[str, list[dict[str, Any]]],
    level: str,
    memory: list[int],
) -> list[dict[str, Any]]:
    """What must hold, what came out, and whether it does. Bars of which nothing was measured are left out."""
    ratios = [c["ratio"] for c in cases]
    unshaded = {look.name for look in declared.look if not look.shaded}
    depth = [c["ratio"] for c in cases if c["shading"] in unshaded]
    four = [c["ratio"] for c in cases if c["samples"] == 4]
    bars = [bar("geometric mean of ours/llvmpipe", ratios, geometric_mean, 0.75 if level in WITHOUT_AVX2 else 0.33)]
    if level not in WITHOUT_AVX2:
        bars += [
            bar("the same, depth only", depth, geometric_mean, 0.25),
            bar("the same, 4 samples", four, geometric_mean, 0.28),
            bar("the largest ours/llvmpipe", ratios, max, 0.75),
            bar("--full: the largest ours/llvmpipe, all layers", [c["ratio"] for c in apart["full"]], max, 0.45),
        ]
    bars.append(bar("the largest image error, ours/llvmpipe", [error_ratio(c) for c in cases], max, 1.0))
    bars.append(
        bar("two threads over one, of arithmetic's gain", [t["share"] for t in apart["threads"]], min, 0.9, True)
    )
    omitted = apart["omissions"]
    bars.append(
        bar(
            "leaving out, frame and set-up: --full over needed",
            [1 / o["ratio"] for o in omitted],
            geometric_mean,
            1.3,
            True,
        )
    )
    bars.append(
        bar("leaving out, the slowest frame: needed over --full", [o["frame_ratio"] for o in omitted], max, 1.03)
    )
    bars.append(bar("memory beside geometry and framebuffers, MiB", [m / 2**20 for m in memory], max, 64.0))
    bars.append(bar("loading a million triangles, ms", [t["median"] for t in apart["load"]], max, 1500.0))
    return [b for b in bars if b is not None]


def bar(
    name: str, values: list[float], reduce: Callable, limit: float, at_least: bool = False
) -> dict[str, Any] | None:
    if not values:
        return None
    value = reduce(values)
    met = value >= limit if at_least else value <= limit
    return {"name": name, "value": value, "limit": limit, "sense": "at least" if at_least else "at most", "met": met}


def error_ratio(case: dict[str, Any]) -> float:
    return case["ours"]["error"] / max(case["peer"]["error"], 1e-30)  # none may be without any error
