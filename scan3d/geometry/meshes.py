"""What is expected of a mesh that a program hands over."""

from __future__ import annotations

from typing import Any

import numpy as np

from scan3d.errors import InputError
from scan3d.geometry.convexity import DENT_TOLERANCE, distance_to_hull
from scan3d.geometry.distance import check_mesh
from scan3d.geometry.merging import without_unused


def check_body(mesh: Any) -> None:
    """Raises InputError unless a mesh is a closed and convex `trimesh.Trimesh`, as bodies that are scanned must be."""
    check_mesh(mesh, "body")
    deviation = distance_to_hull(mesh)
    diagonal = float(
        np.linalg.norm(np.ptp(np.asarray(mesh.vertices)[without_unused(np.asarray(mesh.faces))[0]], axis=0))
    )
    # twice, because a body that `load_mesh` has judged may have been moved, which rounds its vertices
    if not deviation <= 2 * DENT_TOLERANCE * diagonal:
        raise InputError(
            f"the body isn't a closed convex surface: it lies up to {deviation:.3g} from its convex hull "
            f"({deviation / diagonal:.3g} of its diagonal, where {DENT_TOLERANCE:g} is allowed); to scan the hull instead, "
            "give mesh.convex_hull"
        )
