"""The distance from a segment, as geometry defines it."""

import numpy as np


def distance_to_segment(points, start, end):
    """Distance of `points (..., D)` from the segment between `start` and `end`, `(...)`."""
    along = (points - start) @ (end - start) / ((end - start) ** 2).sum()
    nearest = start + np.clip(along, 0, 1)[..., None] * (end - start)
    return np.linalg.norm(points - nearest, axis=-1)
