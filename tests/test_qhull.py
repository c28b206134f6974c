"""Qhull ends on half-spaces on which it would not end by itself."""

import subprocess
import sys

import numpy as np

from scan3d.geometry.polytopes import half_space_intersection

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
from scan3d.geometry.polytopes import half_space_intersection
dual = np.array({})
corners = half_space_intersection(np.column_stack([dual, -np.ones(len(dual))]), np.zeros(3)).intersections
print((corners @ dual.T - 1).max())
"""


def test_half_spaces_through_one_corner_end():
    command = [sys.executable, "-c", CODE.format(DUAL.tolist())]
    done = subprocess.run(command, capture_output=True, text=True, timeout=60, check=True)
    assert abs(float(done.stdout)) < 1e-12


def test_the_point_inside_may_lie_anywhere():
    inside = np.array([0.01, 0.02, 0.03])
    box = np.vstack([np.eye(3), -np.eye(3)])
    found = half_space_intersection(np.column_stack([box, -np.ones(6)]), inside)
    assert np.allclose(np.sort(np.abs(found.intersections), axis=None), 1.0, rtol=0, atol=1e-14)
