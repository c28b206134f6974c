"""Mesh files for the tests of bodies: written, loaded, and refused with a message."""

from pathlib import Path

import numpy as np
import pytest

from scan3d.errors import InputError
from scan3d.files.meshes import load_mesh


def save(folder, mesh, name="body.ply", kind=None):
    path = Path(folder) / name
    mesh.export(path, file_type=kind or path.suffix[1:].lower())
    return path


def assert_sound(body):
    """Closed, outward, convex to rounding, without a vertex to spare."""
    assert body.is_watertight
    assert body.is_winding_consistent
    assert body.euler_number == 2
    assert body.volume > 0
    assert len(np.unique(body.faces)) == len(body.vertices)
    points = (body.vertices - body.bounds.mean(axis=0)) / np.linalg.norm(body.extents)
    a, b, c = points[body.faces[:200]].transpose(1, 0, 2)
    normal = np.cross(b - a, c - a)
    size = np.linalg.norm(normal, axis=1)
    solid = size > 1e-9  # the normal of a sliver says nothing
    height = (points @ normal[solid].T - np.einsum("ij,ij->i", a[solid], normal[solid])) / size[solid]
    assert height.max() < 1e-9


def error(path, **options):
    with pytest.raises(InputError) as caught:
        load_mesh(path, **options)
    message = str(caught.value)
    assert Path(path).name in message
    assert "\n" not in message
    assert len(message) < 300
    return message
