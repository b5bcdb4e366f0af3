"""Linearity: light adds up, I(a + b) = I(a) + I(b)."""

import numpy as np
import pytest

ROUNDING = 1e-4  # of the sum; float32 strays by less than a hundredth of that

# What a function gives is proportional to this argument.
LIGHT = {"incident_light": "light.intensity", "irradiance": "light.e", "diffuse": "e"}


@pytest.mark.points(2)
def test_linearity(evaluate, render, expected):
    for function, light in LIGHT.items():
        inputs = expected.inputs(function)
        a = inputs[light]
        b = 100 * a[::-1]  # brighter than whatever a clamp may be set to
        # One call for all three: in GLSL every call starts OpenGL anew.
        inputs = {name: np.concatenate([values] * 3) for name, values in inputs.items()}
        inputs[light] = np.concatenate([a, b, a + b])
        result = evaluate(function, inputs)
        one, other, both = np.split(result["e"] if function == "incident_light" else result, 3)
        row = farthest(both, one + other)
        assert row is None, (
            f"{function}: with {light} = {vector(a[row])} it gives {vector(one[row])}, with {vector(b[row])} it gives "
            f"{vector(other[row])}, but with the sum of the two {vector(both[row])} instead of {vector((one + other)[row])}"
        )

    both, left, right = (render(f"linearity-{lamps}") for lamps in ("both", "left", "right"))
    assert left.max() > 0 and right.max() > 0, "linearity-left or linearity-right is black, so nothing can add up"
    pixel = farthest(both, left + right)
    assert pixel is None, (
        f"the picture linearity-both is not the sum of linearity-left and linearity-right: at pixel ({pixel[1]}, {pixel[0]}) "
        f"it is {vector(both[pixel])}, and the two are {vector(left[pixel])} and {vector(right[pixel])}"
    )


def farthest(both, total):
    """The index of the vector that is off by most of its length; None when none is off by more than ROUNDING. What is not finite
    costs points where it is computed, and not here once more: only where nearly all is, nothing adds up."""
    finite = np.isfinite(both + total).all(axis=-1)
    assert finite.mean() > 0.5, f"{np.mean(~finite):.0%} of the values are not finite: nothing is left to add up"
    with np.errstate(all="ignore"):
        off = np.abs(both - total).max(axis=-1) / np.abs(total).max(axis=-1).clip(1e-30)
    off = np.where(finite, off, 0.0)
    worst = np.unravel_index(off.argmax(), off.shape)
    return worst if off[worst] > ROUNDING else None


def vector(values):
    return "(" + ", ".join(f"{value:.6g}" for value in values) + ")"
