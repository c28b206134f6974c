"""Contacts of a growing recording agree with those of the whole recording at once."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import planar
import scan3d
from scan3d import Plan
from scan3d.reconstruction import NoContactError
from scan3d.reconstruction.contacts import GrowingContacts, contacts

GEM = Path(__file__).parents[1] / "meshes" / "gem.glb"


@pytest.fixture(scope="module")
def recording():
    return scan3d.simulate(scan3d.load_mesh(GEM), Plan(slices=7, spacing="uniform", sweeps=4, samples=16, friction=0.3))


def of_slices(recording, numbers):
    """The part of a recording in some slices, by their numbers in the order of their appearance."""
    heights = recording.position_m[:, 2]
    distinct = heights[np.sort(np.unique(heights, return_index=True)[1])]
    rows = np.isin(heights, distinct[list(numbers)])
    columns = "sweep", "position_m", "quaternion", "force_N", "moment_Nm"
    return replace(recording, **{name: getattr(recording, name)[rows] for name in columns})


def test_parts_have_the_contacts_of_the_whole(recording):
    whole, grown = contacts(recording), GrowingContacts()
    for numbers in ((0, 1, 2), (3,), (4, 5, 6, 7), (8,)):
        grown.add(of_slices(recording, numbers))
    found = grown.cloud()
    for name in ("points", "phase", "slice", "sweep", "row", "force_N", "friction", "slice_height", "slice_axis"):
        assert np.array_equal(getattr(found, name), getattr(whole, name), equal_nan=True), name
    along = whole.phase == planar.Phase.TANGENTIAL
    assert np.array_equal(found.in_plane_normals[along], whole.in_plane_normals[along])
    assert np.isnan(found.in_plane_normals[~along]).all()
    assert found.unresolved is None is whole.unresolved


def test_slices_that_prove_no_end_are_judged_by_all_contacts_so_far(recording):
    grown = GrowingContacts()
    with pytest.raises(NoContactError, match=r"^there is no contact yet$"):
        grown.cloud()
    # an empty slice and one with contacts bound nothing; with the others the empty slices prove the ends
    grown.add(of_slices(recording, (7, 3)))
    assert grown.cloud().unresolved.sum() == 1
    grown.add(of_slices(recording, (0, 1, 2, 4, 5, 6, 8)))
    assert grown.cloud().unresolved is None
