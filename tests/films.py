"""Frames of an animation."""

import numpy as np
from PIL import Image


def film_of(path):
    """Number of frames of a GIF, and the share of pixels below its title that change from the first one to the last."""
    with Image.open(path) as film:
        assert film.format == "GIF"
        frames, count = [], getattr(film, "n_frames", 1)
        for number in (0, count - 1):
            film.seek(number)
            frames.append(np.asarray(film.convert("RGB")).astype(int))
        return count, (np.abs(frames[0] - frames[1]).max(axis=-1) > 40)[len(frames[0]) // 8 :].mean()
