"""Plane faces of hulls, polytopes of planes, and half-spaces on which Qhull would not end by itself."""

import subprocess
import sys

import numpy as np
import pytest
import trimesh
from scipy.spatial import ConvexHull, QhullError
from spatial_bodies import unit

from scan3d.geometry import hulls
from scan3d.geometry.hulls import clipped, cut_polytope


def test_tangent_planes_cut_what_faces_leave_open():
    normals = unit(np.random.default_rng(2).normal(size=(3000, 3)))
    normals = normals[np.abs(normals[:, 2]) < 0.8]
    caps = np.array([[0.0, 0, 1, 0.8], [0, 0, -1, 0.8]])
    corners = cut_polytope(caps, np.column_stack([normals, np.ones(len(normals))]), np.zeros(3), 2.0, 1e-3)
    assert np.abs(corners[:, 2]).max() == pytest.approx(0.8)
    assert np.linalg.norm(corners, axis=1).min() > 0.99
    assert np.linalg.norm(corners, axis=1).max() < 1.01
    # every remaining cut is shallower than the tolerance
    assert (corners @ normals.T - 1).max() < 1e-3


def test_planes_cut_the_hull_of_points():
    corners = trimesh.creation.box((2, 2, 2)).vertices.view(np.ndarray)
    assert clipped(corners, np.array([[1.0, 0, 0, 1.0], [0, 1.0, 0, 3.0]])) is corners
    cut = clipped(corners, np.array([[1.0, 0, 0, 0.5], [0, 1.0, 0, 3.0]]))
    assert np.ptp(cut, axis=0) == pytest.approx([1.5, 2.0, 2.0])
    assert ConvexHull(cut).volume == pytest.approx(6.0)
    # planes with most of the points beyond them contradict the points
    assert clipped(corners, np.array([[1.0, 0, 0, -0.5]])) is corners


def test_planes_at_which_qhull_fails_still_leave_their_corners(monkeypatch):
    """Qhull calls some hulls of dual points imprecise: the middle alone was then left, which would prove any bound."""

    def fails(*_, **__):
        raise QhullError("large increase in qh.max_outside")

    corners = trimesh.creation.box((2, 2, 2)).vertices.view(np.ndarray)
    faces = np.column_stack([np.concatenate([np.eye(3), -np.eye(3)]), np.ones(6)])
    monkeypatch.setattr(hulls, "ConvexHull", fails)
    found = cut_polytope(faces, np.array([[1.0, 0, 0, 0.5]]), np.zeros(3), 2.0, 1e-9)
    assert len(found) == 8
    assert found.max(axis=0) == pytest.approx([0.5, 1, 1])
    assert found.min(axis=0) == pytest.approx(corners.min(axis=0))


# Dual points of half-spaces of a slab of the Stanford bunny's hull, of which two would replace each other without end.
DUAL = np.array([
    (-3.5659592792585095, -0.4665384984202012, 0.009723910110846544),
    (-1.0346574326683502, -6.3064320164275625, 0.012319606889770239),
    (-0.055112845774426135, -5.681344830034815, 0.01118693867723726),
    (0.3275470854339885, -5.431157381448858, 0.010719070116439851),
    (-0.10078651676191618, -5.711206799579892, 0.011242782712551741),
    (0.37427385544545577, -5.4006068836923795, 0.010661938483750077),
    (0.45396488286981246, -5.3472848058451214, 0.010559340093043776),
    (0.5295081575429131, -5.2967380315952655, 0.010462081735855413),
    (4.9386108250327, 2.605407545523127, 0.0014855202413321775),
    (0.0, 0.0, 2.0),
    (0.0, 0.0, -2.0),
])  # fmt: skip
# In a process of its own, which can be ended; the largest value by which a corner lies outside of a half-space.
CODE = """
import numpy as np
from scan3d.geometry.hulls import half_space_intersection
dual = np.array({})
corners = half_space_intersection(np.column_stack([dual, -np.ones(len(dual))]), np.zeros(3)).intersections
print((corners @ dual.T - 1).max())
"""


@pytest.mark.slow
def test_half_spaces_through_one_corner_end():
    command = [sys.executable, "-c", CODE.format(DUAL.tolist())]
    done = subprocess.run(command, capture_output=True, text=True, timeout=60, check=True)
    assert abs(float(done.stdout)) < 1e-12
