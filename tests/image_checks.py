"""Images as arrays, and where they have a colour."""

import numpy as np
from PIL import Image


def pixels(path):
    """(height, width, 3) of an image file."""
    with Image.open(path) as image:
        return np.asarray(image.convert("RGB")).astype(int)


def of_color(image, color, within=40):
    """(height, width) whether the pixels have about this colour, "#rrggbb"."""
    rgb = [int(color[k : k + 2], 16) for k in (1, 3, 5)]
    return (np.abs(np.asarray(image).astype(int) - rgb).max(axis=2)) < within


def fraction_of_color(image, color, within=40):
    """Fraction of the pixels of about this colour, "#rrggbb"."""
    return of_color(image, color, within).mean()
