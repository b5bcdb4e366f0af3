"""Which pictures and which values the page shows, so that it stays of a size that a browser opens."""

import os
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field
from itertools import islice
from typing import Any

import numpy as np
from markupsafe import Markup

from shadelab.grading.pictures import Pictures
from shadelab.report.html.encoding import (
    as_fractions,
    as_halves,
    as_planes,
    as_steps,
    exact,
    excess_of_planes,
    packed,
)
from shadelab.report.html.pictures import PICTURE, Figure, figures_of, named_pixel, picture_uri, srgb, thumbnail_of
from shadelab.report.wording import in_order, label
from shadelab.result import Check, Result
from shadelab.truth.expected import SceneTruth

TERMS = ("total", "ambient", "diffuse", "specular")

PAGE = 4_000_000  # bytes of the whole file
WORDS = 500_000  # of these, for all that is no picture
STATIC = 3_000_000  # of these at most, in base64, for the pictures that need no script
TOTAL = 60_000  # bytes that are set aside for the values of the total, for each check


@dataclass
class Illustrated:
    """What the page shows of the checks with pictures, by the check's id."""

    figures: dict[str, list[Figure]] = field(default_factory=dict)  # of those that failed
    thumbnails: dict[str, Figure] = field(default_factory=dict)  # of those that passed
    viewers: dict[str, dict[str, Any]] = field(default_factory=dict)  # what report.js has to know
    scenes: dict[str, dict[str, Any]] = field(default_factory=dict)  # the same of what checks share
    blobs: dict[str, Markup] = field(default_factory=dict)  # base64, by the name of a viewer's or a scene's data


def illustrate(result: Result, pictures: dict[str, Pictures], anchors: dict[str, str]) -> Illustrated:
    """First the pictures that need no script, then in the order of the data flow what viewers show, while there is room."""
    out = Illustrated()
    failed = [c for c in in_order(result, "failed", "error") if c.id in pictures]
    passed = [c for c in in_order(result, "passed") if c.id in pictures and pictures[c.id].layers is not None]
    scenes = _scenes([*failed, *passed], pictures)
    with ThreadPoolExecutor(os.cpu_count()) as pool:
        out.figures = _figures(failed, scenes, pictures, anchors, PICTURE, pool)
        if sum(len(f.uri) for figures in out.figures.values() for f in figures) > STATIC:
            least = 3 * STATIC // 4 // (3 * len(failed))  # all three of all may be noise
            out.figures = _figures(failed, scenes, pictures, anchors, least, pool)
        small = pool.map(lambda c: thumbnail_of(c, pictures[c.id], anchors[c.id]), passed)
        out.thumbnails = {c.id: figure for c, figure in zip(passed, small)}
        room = PAGE - WORDS - sum(len(f.uri) for figures in out.figures.values() for f in figures)
        room -= sum(len(f.uri) for f in out.thumbnails.values())
        for check in failed:
            # Values can be read off pictures that are exact, and of no others.
            if pictures[check.id].layers is not None and all(figure.exact for figure in out.figures[check.id]):
                height, width = pictures[check.id].expected.shape[:2]
                out.viewers[anchors[check.id]] = {
                    "width": width,
                    "height": height,
                    "pixel": named_pixel(check, (height, width)),
                }

        # A scene's data stands once, for both languages: all of a scene that fails, else, or when room is short, the total.
        groups: dict[str, list[Check]] = {}
        for check in [*failed, *passed]:
            if pictures[check.id].layers is not None:
                groups.setdefault(scenes[check.id], []).append(check)
        fails = {scenes[c.id] for c in failed}
        for whole in (True, False):
            left = iter([key for key in groups if key not in out.scenes and (key in fails or not whole)])
            full = False
            waiting = sum(len(checks) for key, checks in groups.items() if key not in out.scenes) if whole else 0
            # Some ahead, so that no processor waits, and few, so that little is done in vain once the room is used up.
            while not full and (batch := list(islice(left, 4))):
                calls = [(key, groups[key], whole, pictures, anchors) for key in batch]
                for scene in pool.map(lambda call: _packed_scene(*call), calls):
                    size = sum(len(text) for text in scene.blobs.values())
                    waiting -= len(scene.viewers) if whole else 0
                    full = full or size > room - TOTAL * waiting
                    if not full:
                        room -= size
                        out.viewers |= scene.viewers
                        out.scenes |= scene.scenes
                        out.blobs |= scene.blobs
    return out


def _figures(
    failed: list[Check],
    scenes: dict[str, str],
    pictures: dict[str, Pictures],
    anchors: dict[str, str],
    most: int,
    pool: ThreadPoolExecutor,
) -> dict[str, list[Figure]]:
    """None of them larger than `most` bytes."""
    one_each = {scenes[c.id]: c for c in failed}
    uris = pool.map(lambda c: picture_uri(srgb(pictures[c.id].expected), most), one_each.values())
    expected = dict(zip(one_each, uris))
    drawn = pool.map(lambda c: figures_of(c, pictures[c.id], anchors[c.id], expected[scenes[c.id]], most), failed)
    return {c.id: figures for c, figures in zip(failed, drawn)}


def _scenes(checks: list[Check], pictures: dict[str, Pictures]) -> dict[str, str]:
    """A key for each check; those that the same picture is expected of have the same."""
    keys: dict[str, str] = {}
    seen: dict[str, list[tuple[np.ndarray, str]]] = {}
    for check in checks:
        total = pictures[check.id].expected
        alike = seen.setdefault(label(check), [])
        key = next((key for other, key in alike if np.array_equal(other, total)), None)
        if key is None:
            key = f"scene-{len(set(keys.values()))}"
            alike.append((total, key))
        keys[check.id] = key
    return keys


# --- What the viewers show ---


def _packed_scene(
    key: str, checks: list[Check], whole: bool, pictures: dict[str, Pictures], anchors: dict[str, str]
) -> Illustrated:
    """`whole`: with all terms and the geometry; otherwise with the total alone."""
    out = Illustrated()
    truth = pictures[checks[0].id].truth
    height, width = truth.mask.shape
    terms = TERMS if whole else TERMS[:1]
    expected = [as_planes(truth.layers[name]) for name in terms]
    base = np.concatenate([as_halves(layer) for layer in expected])
    planes = [base, truth.mask[None].astype(np.uint16)]
    channels: list[dict[str, Any]] = [{"name": name, "planes": 3, "coding": "half"} for name in terms]
    channels.append({"name": "mask", "planes": 1, "coding": "integer"})
    if whole:
        planes.append(as_planes(truth.layers["id"]).astype(np.uint16))
        channels.append({"name": "id", "planes": 1, "coding": "integer"})
        for name in ("normal", "position"):
            fractions, low, high = as_fractions(truth.layers[name])
            planes.append(fractions)
            channels.append({"name": name, "planes": 3, "coding": "fraction", "low": low, "high": high})
    out.blobs[key], _ = packed(np.concatenate(planes))
    out.scenes[key] = {"channels": channels, "eye": exact(truth.eye), "lights": _lights(truth)}
    for check in checks:
        shown, anchor = pictures[check.id], anchors[check.id]
        layers = as_planes(shown.layers[..., : 3 * len(terms)]).reshape(len(terms), 3, height, width)
        limit = as_planes(shown.limit)
        far = [excess_of_planes(yours, layer, limit) for yours, layer in zip(layers, expected)]
        planes = [*(as_halves(yours) for yours in layers), np.stack([as_steps(ratio) for ratio in far])]
        channels = [{"name": name, "planes": 3, "coding": "half"} for name in terms]
        channels += [{"name": f"{name} excess", "planes": 1, "coding": "excess"} for name in terms]
        out.blobs[anchor], against = packed(np.concatenate(planes), base)
        viewer = {
            "width": width,
            "height": height,
            "scene": key,
            "channels": channels,
            "against": against,
            "whole": whole,
        }
        viewer["pixel"] = place = named_pixel(check, truth.mask.shape)
        if place:
            x, y = place
            yours = {name: exact(layers[k, :, y, x]) for k, name in enumerate(terms)}
            yours |= {f"{name} excess": exact([far[k][y, x]]) for k, name in enumerate(terms)}
            right = {name: exact(expected[k][:, y, x]) for k, name in enumerate(terms)}
            if whole:
                right |= {name: exact(truth.layers[name][y, x]) for name in ("normal", "position")}
            viewer["exact"] = {"yours": yours, "expected": right}
        out.viewers[anchor] = viewer
    return out


def _lights(truth: SceneTruth) -> list[dict[str, Any]]:
    out = []
    for light in getattr(truth, "lights", []):
        at = light["position"] if light["placed"] else light["direction"]
        called = {"spot": "spotlight"}.get(light["name"], f"{light['name']} light")
        out.append({"kind": called, "directional": not light["placed"], "at": exact(at)})
    return out
