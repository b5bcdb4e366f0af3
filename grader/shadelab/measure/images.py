"""How far one image lies from another."""

import numpy as np

from shadelab.truth.measures import rmse


def image_error(image: np.ndarray, reference: np.ndarray) -> dict[str, float]:
    """Root mean square and largest difference over all pixels, of the total's three channels or of the depth."""
    difference = image[..., :3].astype(float) - reference[..., :3]
    return {"rmse": rmse(difference), "max": float(np.abs(difference).max())}
