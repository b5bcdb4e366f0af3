"""Times, taken in turn: whatever else the machine does then hits all alike."""

import math
import statistics
import time
from collections.abc import Callable
from typing import Any

Progress = Callable[[str, float, float], None]

MORE_PAIRS, MORE_SECONDS = 45, 1.5  # short frames get more pairs, until one of these is reached
# Threads of OpenMP spin for a while after a frame; what is measured next must not meet them.
PAUSE = 0.025  # seconds before each of a pair's frames
SHORT_PAUSE = 0.005  # and where many are measured in turn


def alternate(
    ours: Callable[[], float],
    peer: Callable[[], float],
    least: int,
    seconds: float = MORE_SECONDS,
    pause: float = PAUSE,
) -> list[tuple[float, float]]:
    """Pairs of times, drawn in turn; who begins changes from pair to pair."""
    pairs: list[tuple[float, float]] = []
    start = time.perf_counter()
    while len(pairs) < least or (len(pairs) < MORE_PAIRS and time.perf_counter() - start < seconds):
        times = {}
        for draw in (ours, peer) if len(pairs) % 2 == 0 else (peer, ours):
            time.sleep(pause)
            times[draw] = draw()
        pairs.append((times[ours], times[peer]))
    return pairs


def pairwise_ratio(pairs: list[tuple[float, float]]) -> float:
    return statistics.median(one / other for one, other in pairs)


def interleaved(
    callables: dict[Any, Callable[[], float | None]],
    repeats: int,
    progress: Progress | None = None,
    what: str = "timing",
    pause: float = SHORT_PAUSE,
) -> dict[Any, dict[str, float]]:
    """Runs all callables in turn, `repeats` times after a round that warms up, so that a slow moment hits all alike.

    Each returns the seconds that it took, for what measures itself, or None: then the time from its call to its return counts.
    Who begins changes from round to round. Returns {median, min, max, runs} for each key.
    """
    keys = list(callables)
    times: dict[Any, list[float]] = {key: [] for key in keys}
    for turn in range(repeats + 1):
        first = turn % max(len(keys), 1)
        for done, key in enumerate(keys[first:] + keys[:first]):
            if progress:
                progress(what, turn * len(keys) + done, (repeats + 1) * len(keys))
            time.sleep(pause)
            start = time.perf_counter()
            measured = callables[key]()
            seconds = time.perf_counter() - start if measured is None else measured
            if turn > 0:
                times[key].append(seconds)
    return {key: spread(times[key]) for key in keys}


def spread(times: list[float]) -> dict[str, float]:
    return {"median": statistics.median(times), "min": min(times), "max": max(times), "runs": len(times)}


def geometric_mean(values: list[float]) -> float:
    return math.exp(statistics.fmean(math.log(value) for value in values))


def milliseconds(value: float) -> str:
    return f"{value:.0f}" if value >= 100 else f"{value:.1f}" if value >= 10 else f"{value:.2f}"
