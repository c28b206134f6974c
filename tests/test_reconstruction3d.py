"""Normals and surfaces of smooth bodies, against the bodies' own formulas."""

import dataclasses
import importlib.util
from pathlib import Path

import numpy as np
import pytest
import trimesh

import planar
import scan3d
from scan3d.bracket import bracket
from scan3d.cloud import NormalSource, contacts
from scan3d.layers import height_slopes, stacks
from scan3d.reconstruction import with_slice_normals
from scan3d.support import fit_support, harmonics

MESHES = Path(__file__).parents[1] / "meshes"
spec = importlib.util.spec_from_file_location("make_meshes", MESHES / "make_meshes.py")
bodies = importlib.util.module_from_spec(spec)
spec.loader.exec_module(bodies)


def degrees_between(a, b):
    return np.degrees(np.arccos(np.clip((a * b).sum(axis=1), -1, 1)))


@pytest.fixture(scope="module", params=["ellipsoid", "egg", "pebble"])
def smooth(request):
    # the pebble is bent most where its facets are largest
    mesh = bodies.make(request.param, subdivisions=200 if request.param == "pebble" else 100)
    cloud = scan3d.reconstruct(scan3d.simulate(mesh, scan3d.Plan(friction=(0.0, 0.4))))
    return request.param, mesh, cloud


def test_normals_are_the_surfaces_own(smooth):
    """80,000 facets stand up to 0.6° off the smooth body; the fit sees through them, end slices included."""
    name, _, cloud = smooth
    off = degrees_between(cloud.normals, bodies.normal(name, cloud.points))
    assert (cloud.normal_source == NormalSource.FIT).all()
    assert np.median(off) < 0.1
    assert np.percentile(off, 95) < 1.0
    for end in (cloud.slice.min(), cloud.slice.max()):
        assert np.median(off[cloud.slice == end]) < 0.2


def test_slices_alone_give_normals_to_a_facet(smooth):
    name, _, cloud = smooth
    for stack in stacks(cloud):
        for layer, (slope, _) in zip(stack.layers[::7], height_slopes(stack)[::7], strict=True):
            leaning = np.column_stack([layer.normals, -slope]) @ stack.frame
            leaning /= np.linalg.norm(leaning, axis=1, keepdims=True)
            true = bodies.normal(name, cloud.points[layer.rows[layer.lying]])
            assert np.median(degrees_between(leaning, true)) < 0.6


def test_the_fitted_surface_beats_the_hull(smooth):
    name, mesh, cloud = smooth
    fitted, hull = (scan3d.compare(scan3d.surface(cloud, method), mesh).relative for method in ("auto", "hull"))
    assert fitted < 1e-4
    assert fitted < hull


def test_bodies_with_edges_are_not_fitted():
    cloud = scan3d.reconstruct(scan3d.simulate(trimesh.creation.box((20, 30, 40)), scan3d.Plan(slices=24)))
    assert cloud.fit is None
    assert scan3d.surface(cloud).metadata["method"] == "bracket"
    # on the faces of a box the normals are exact
    known = cloud.normal_source == NormalSource.SLICES
    on_face = known & (np.abs(np.abs(cloud.points) - [10, 15, 20]) < 1e-9).sum(axis=1).astype(bool)
    in_plane = np.abs(cloud.in_plane_normals[on_face]).max(axis=1) > 1 - 1e-12
    assert in_plane.sum() > 1000
    assert np.abs(cloud.normals[on_face][in_plane]).max(axis=1).min() > 1 - 1e-12
    with pytest.raises(scan3d.InputError, match="not smooth enough"):
        scan3d.surface(cloud, "support")


def test_an_unknown_method_and_contacts_in_one_plane_are_refused():
    cloud = contacts(scan3d.simulate(trimesh.creation.box((20, 30, 40)), scan3d.Plan(slices=1, samples=16)))
    with pytest.raises(scan3d.InputError, match="method must be one of"):
        scan3d.surface(cloud, "magic")
    with pytest.raises(scan3d.InputError, match="span no body"):
        scan3d.surface(cloud, "hull")


def test_harmonics_have_their_gradients():
    """Against central differences of the functions themselves, continued off the sphere as |u|^(1-l) R_lm."""
    rng = np.random.default_rng(0)
    u = rng.normal(size=(20, 3))
    u /= np.linalg.norm(u, axis=1)[:, None]
    degree, step = 6, 1e-6
    value, gradient = harmonics(u, degree)

    def continued(points):
        # homogeneous of degree 1
        length = np.linalg.norm(points, axis=1)
        return length * harmonics(points / length[:, None], degree)[0]

    np.testing.assert_allclose((gradient * u.T).sum(axis=1), value, atol=1e-12)
    for axis in range(3):
        shift = step * np.eye(3)[axis]
        np.testing.assert_allclose(
            (continued(u + shift) - continued(u - shift)) / (2 * step), gradient[:, axis], atol=1e-7
        )


@pytest.mark.parametrize("axes", [(1.0, 1.0, 1.0), (40.0, 2.0, 2.0), (40.0, 40.0, 2.0)])
def test_an_ellipsoid_of_any_aspect_is_fitted_exactly(axes):
    rng = np.random.default_rng(1)
    normals = rng.normal(size=(4000, 3))
    normals /= np.linalg.norm(normals, axis=1)[:, None]
    scaled = normals * np.array(axes) ** 2
    points = scaled / np.sqrt((normals * scaled).sum(axis=1))[:, None]
    # the moments of inertia are those of the points' hull: the degrees above 1 make up for what it lacks
    fitted = fit_support(points, normals, 8)
    assert np.abs(fitted.points(normals) - points).max() < 1e-3 * min(axes)


@pytest.mark.parametrize("noise", [0.0, 1e-3])
def test_tip_contacts_get_normals_by_the_friction_that_the_others_agree_on(noise):
    plan = scan3d.Plan(slices=24, samples=32, friction=0.3, noise=noise)
    cloud = with_slice_normals(contacts(scan3d.simulate(bodies.make("ellipsoid", subdivisions=60), plan)))
    tips = cloud.phase == planar.Phase.TIP
    assert tips.sum() > 100
    assert (cloud.normal_source[tips] == NormalSource.FRICTION).all()
    assert (cloud.normal_source[~tips] == NormalSource.SLICES).all()
    off = degrees_between(cloud.normals, bodies.normal("ellipsoid", cloud.points))
    assert np.percentile(off[tips], 95) < 1.5  # of which the facets' share is 1


def test_where_friction_varies_tip_contacts_have_no_normal_of_their_own():
    plan = scan3d.Plan(slices=12, samples=32, friction=(0.0, 0.4))
    cloud = with_slice_normals(contacts(scan3d.simulate(trimesh.creation.icosphere(4, 20.0), plan)))
    tips = cloud.phase == planar.Phase.TIP
    assert (cloud.normal_source[tips] == NormalSource.UNKNOWN).all()
    assert np.isnan(cloud.normals[tips]).all()


def test_the_certificate_does_not_rest_on_an_inferred_friction():
    """Were it wrong, so would the bound be: the bracket is that of the tangential contacts alone."""
    recording = scan3d.simulate(trimesh.creation.icosphere(3, 20.0), scan3d.Plan(slices=8, samples=16, friction=0.3))
    cloud = contacts(recording)
    tips = cloud.phase == planar.Phase.TIP
    assert np.isfinite(cloud.in_plane_normals[tips]).all()
    without = cloud.in_plane_normals.copy()
    without[tips] = np.nan
    assert bracket(cloud).bound == bracket(dataclasses.replace(cloud, in_plane_normals=without)).bound
