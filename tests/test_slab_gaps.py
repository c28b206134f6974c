"""Distances of slabs' corners from the hull of the contacts agree with the search over all of its faces."""

from pathlib import Path

import numpy as np
import pytest
from scipy.spatial import QhullError

import scan3d
from scan3d import Plan
from scan3d.bounds import slabs as slab_gaps
from scan3d.bounds.slabs import SlabGaps, slabs
from scan3d.geometry.hulls import hull
from scan3d.reconstruction.contacts import contacts
from scan3d.reconstruction.slices import stacks
from tests.sample_bodies import outside

MESHES = Path(__file__).parents[1] / "meshes"


@pytest.fixture(scope="module", params=["gem.glb", "egg.stl", "cylinder.off", "cube.stl"])
def cloud(request):
    mesh = scan3d.load_mesh(MESHES / request.param)
    return contacts(scan3d.simulate(mesh, Plan(slices=6, spacing="cosine", sweeps=5, samples=16)))


@pytest.mark.parametrize("few", [slab_gaps._FEW, 0], ids=["faces first", "search only"])
def test_the_distances_are_those_of_the_nearest_points(cloud, few, monkeypatch):
    monkeypatch.setattr(slab_gaps, "_FEW", few)
    (stack,) = stacks(cloud)
    gaps, inner = SlabGaps(stack), hull(cloud.points)
    for i, slab in enumerate(slabs(stack)):
        found = gaps.at(i, slab.corners)
        # some hundred units in the last place of coordinates
        assert found == pytest.approx(outside(slab.corners, inner), abs=1e-13 * inner.scale)


def test_points_inside_have_no_distance(cloud):
    (stack,) = stacks(cloud)
    middle = cloud.points.mean(axis=0)[None]
    for i in range(len(stack.slices) + 1):
        assert SlabGaps(stack).at(i, middle) == [0.0]


def test_contacts_in_one_plane_span_no_body(cloud):
    (stack,) = stacks(cloud.select(cloud.slice == np.unique(cloud.slice)[2]))
    with pytest.raises(QhullError):
        SlabGaps(stack)
