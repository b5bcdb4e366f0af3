"""How far one image lies from another."""

import numpy as np


def image_error(image: np.ndarray, reference: np.ndarray) -> dict[str, float]:
    """Root mean square and largest difference over all pixels, of the total's three channels or of the depth."""
    difference = image[..., :3].astype(float) - reference[..., :3]
    return {"rmse": float(np.sqrt(np.mean(difference**2))), "max": float(np.abs(difference).max())}
