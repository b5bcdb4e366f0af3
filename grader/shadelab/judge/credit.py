"""Points for what is wrong: by its share or by its size, whichever leaves more."""

import numpy as np

# By the share of inputs or pixels that are wrong, falling with its logarithm from LITTLE to NO_MARKS; by how far most of those
# are off, relative to what is expected, from NEAR to FAR. Something that is wrong loses at least MISTAKE of the points.
LITTLE, NO_MARKS = 1e-3, 1e-1
NEAR, FAR = 1e-3, 1e-1
MISTAKE = 0.25
MOST = 90  # percent of what is wrong are off by at most the size


def credit(share: float, size: float = np.inf) -> float:
    """The share of the points: three quarters where up to 0.1 % are wrong, or are off by up to 0.1 %; half of that at 1 %, none
    from 10 % on."""
    return (1 - MISTAKE) * max(_left(share, LITTLE, NO_MARKS), _left(size, NEAR, FAR))


def size_of(errors: np.ndarray) -> float:
    """How far most of what is wrong is off. errors: relative, of each wrong input or pixel; infinite for what is not finite."""
    return float(np.percentile(errors, MOST, method="higher")) if len(errors) else 0.0


def _left(value: float, full: float, none: float) -> float:
    return float(np.clip(1 - np.log(max(value, full) / full) / np.log(none / full), 0, 1))
