"""Points for a share of what is wrong."""

import numpy as np

# Partial credit: by the share of inputs or pixels that are wrong, falling with its logarithm from LITTLE to NO_MARKS. Something
# that is wrong loses at least MISTAKE of the points.
LITTLE, NO_MARKS = 1e-3, 1e-1
MISTAKE = 0.25


def credit(share: float) -> float:
    """The share of the points for a share of wrong inputs or pixels: three quarters up to 0.1 %, half of that at 1 %, none from
    10 % on."""
    fallen = np.log(max(share, LITTLE) / LITTLE) / np.log(NO_MARKS / LITTLE)
    return (1 - MISTAKE) * float(np.clip(1 - fallen, 0, 1))
