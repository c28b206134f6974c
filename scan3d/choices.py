"""The allowed values of the settings that are chosen by name.

Every list stands here and nowhere else: as a type, by which a type checker knows the values, and as a tuple of the same.  No
numerical library is imported, so that ``scan3d --help`` is quick.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Literal, get_args

Model = Literal["planar", "spatial"]
MODELS: tuple[str, ...] = get_args(Model)
"""Models of contact: the rod stays in its slice, or it bends where the contact force pushes it; the first is the default."""
Spacing = Literal["adaptive", "cosine", "uniform"]
SPACINGS: tuple[str, ...] = get_args(Spacing)
"""Rules for the heights of the slices."""
Probing = Literal["auto", "off", "only"]
PROBINGS: tuple[str, ...] = get_args(Probing)
"""Whether the rod is sent along itself as well: of bodies that are not convex, of none, or in the place of all sweeps."""
Method = Literal["auto", "hull", "bracket", "support", "regression", "poisson", "ball-pivoting"]
METHODS: tuple[str, ...] = get_args(Method)
"""Methods that make a surface from contacts; ``bracket`` estimates it between the certified bounds, ``regression`` fits planes
to noisy contacts."""
NOT_CONVEX = ("poisson", "ball-pivoting")
"""Those of them that need open3d, and make surfaces that need not be convex."""
View = Literal["cloud", "surface", "bound", "compare", "explain", "histogram", "forces"]
VIEWS: tuple[str, ...] = get_args(View)
"""What a picture can show."""
CHARTS = ("histogram", "forces")
"""Views that show no body: they have no camera, and need no renderer."""
WITH_OTHER = ("surface", "compare", "histogram")
"""Views that show the surface, and thereby another surface that it is compared with."""
NamedCamera = Literal["front", "back", "left", "right", "top", "bottom", "iso"]
CAMERAS: tuple[str, ...] = get_args(NamedCamera)
"""Cameras of pictures with a name: from -y, y, -x, x, z and -z, and with x, y and z equally short."""
Color = Literal["phase", "force", "friction", "error", "bending"]
COLORS: tuple[str, ...] = get_args(Color)
"""The quantities by which contacts can be coloured."""
Export = Literal["surface", "cloud"]
EXPORTS: tuple[str, ...] = get_args(Export)
"""What can be exported of a scan; the first is the default where a file can contain either."""
Tare = Literal["auto", "constant", "linear", "sweep"]
TARES: tuple[str, ...] = get_args(Tare)
"""Models of what a sensor shows in the air; the first is the default."""


def one_of(values: Sequence[str]) -> str:
    """The values as a list in a sentence: ``a, b or c``."""
    *first, last = values
    return f"{', '.join(first)} or {last}" if first else last
