"""Normals of smooth bodies and of bodies with edges, against the bodies' own formulas."""

import numpy as np
import pytest
import trimesh
from sample_bodies import formulas
from shapes import unit

import planar
import scan3d
from scan3d.cloud import NormalSource
from scan3d.reconstruction.contacts import contacts
from scan3d.reconstruction.normals import height_slopes, with_slice_normals
from scan3d.reconstruction.slices import stacks

pytestmark = pytest.mark.slow


def degrees_between(a, b):
    return np.degrees(np.arccos(np.clip((a * b).sum(axis=1), -1, 1)))


@pytest.fixture(
    scope="module", params=["ellipsoid", *(pytest.param(name, marks=pytest.mark.trust) for name in ("egg", "pebble"))]
)
def smooth(request):
    # the pebble is most curved where its facets are largest
    subdivisions = {"ellipsoid": 60, "egg": 100, "pebble": 200}[request.param]
    mesh = formulas.make(request.param, subdivisions=subdivisions)
    cloud = scan3d.reconstruct(scan3d.simulate(mesh, scan3d.Plan(slices=32, friction=(0.0, 0.4))))
    return request.param, mesh, cloud


def test_normals_of_a_smooth_body_come_from_the_fit(smooth):
    """The facets are inclined up to 1° to the smooth body; the fit averages them out, end slices included."""
    name, _, cloud = smooth
    deviation = degrees_between(cloud.normals, formulas.normal(name, cloud.points))
    assert (cloud.normal_source == NormalSource.FIT).all()
    assert np.median(deviation) < 0.1
    assert np.percentile(deviation, 95) < 1.0
    for end in (cloud.slice.min(), cloud.slice.max()):
        assert np.median(deviation[cloud.slice == end]) < 0.2


def test_slices_alone_give_normals_to_within_a_facets_inclination(smooth):
    name, _, cloud = smooth
    for stack in stacks(cloud):
        for section, (slope, _) in zip(stack.slices[::7], height_slopes(stack)[::7], strict=True):
            normals = unit(np.column_stack([section.normals, -slope]) @ stack.frame)
            exact = formulas.normal(name, cloud.points[section.rows[section.tangential]])
            assert np.median(degrees_between(normals, exact)) < 0.6


def test_bodies_with_edges_are_not_fitted():
    cloud = scan3d.reconstruct(
        scan3d.simulate(trimesh.creation.box((20, 30, 40)), scan3d.Plan(slices=24, spacing="cosine"))
    )
    assert cloud.fit is None
    assert scan3d.surface(cloud).metadata["method"] != "support"
    # on the faces of a box the normals are exact
    known = np.isin(cloud.normal_source, (NormalSource.SLICES, NormalSource.FACET))
    on_face = known & (np.abs(np.abs(cloud.points) - [10, 15, 20]) < 1e-9).sum(axis=1).astype(bool)
    in_plane = np.abs(cloud.in_plane_normals[on_face]).max(axis=1) > 1 - 1e-12
    assert in_plane.sum() > 1000
    assert np.abs(cloud.normals[on_face][in_plane]).max(axis=1).min() > 1 - 1e-12
    with pytest.raises(scan3d.InputError, match="not smooth enough"):
        scan3d.surface(cloud, "support")


@pytest.mark.parametrize("noise", [0.0, pytest.param(1e-3, marks=pytest.mark.trust)])
def test_tip_contacts_get_normals_by_the_friction_that_the_tangential_contacts_agree_on(noise):
    plan = scan3d.Plan(slices=24, samples=32, friction=0.3, noise=noise)
    cloud = with_slice_normals(contacts(scan3d.simulate(formulas.make("ellipsoid", subdivisions=60), plan)))
    tip = cloud.phase == planar.Phase.TIP
    assert tip.sum() > 100
    assert (cloud.normal_source[tip] == NormalSource.FRICTION).all()
    assert (cloud.normal_source[~tip] == NormalSource.SLICES).all()
    deviation = degrees_between(cloud.normals, formulas.normal("ellipsoid", cloud.points))
    assert np.percentile(deviation[tip], 95) < 1.5  # of which 1 is due to the facets
