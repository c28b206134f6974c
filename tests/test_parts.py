"""Parts of a scene as they are drawn: what is seen is what was scanned."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from small_scans import CUBE, EGG, scanned, scanned_in_space
from spatial_scans import SEMI_AXES

import planar
import scan3d
from scan3d.pictures.parts import contact_paths, outlines, shown_surface, shown_sweep, sweep_direction
from scan3d.pictures.scene import of_cloud


@pytest.fixture(scope="module")
def egg():
    return scanned(EGG)


@pytest.fixture(scope="module")
def cube():
    return scanned(CUBE)


def test_slices_are_closed_lines_through_their_contacts(egg):
    slice_of_contact, drawn = egg.column("slice"), outlines(egg)
    assert [number for _, number in drawn] == sorted(set(slice_of_contact))
    for outline, number in drawn:
        points = egg.points[slice_of_contact == number]
        assert np.array_equal(outline[0], outline[-1])
        assert len(outline) == len(points) + 1
        assert np.ptp(outline[:, 2]) < 1e-9
        # in order: the egg's slices are circles, and a polygon in any other order is far longer
        length = np.linalg.norm(np.diff(outline, axis=0), axis=1).sum()
        assert length <= np.pi * np.ptp(outline[:, 0]) * 1.05


def test_rods_touch_where_the_contacts_are_and_keep_their_length(egg):
    sweep = shown_sweep(egg, points=2000)
    rows = egg.column("sweep") == sweep.number
    assert sweep.contact == pytest.approx(egg.points[rows], abs=1e-9 * egg.diagonal)
    length = egg.recording.rod.length_m * 1e3
    along = [np.linalg.norm(np.diff(lines, axis=1), axis=2).sum(axis=1) for lines in (sweep.curved, sweep.straight)]
    assert sum(along) == pytest.approx(np.full(rows.sum(), length), rel=1e-6)
    # the rod starts along the clamp's y axis, and the base moves in -x
    start = sweep.curved[:, 1] - sweep.curved[:, 0]
    assert (start @ sweep.axes[1] > 0.999 * np.linalg.norm(start, axis=1)).all()
    assert (np.diff(sweep.base @ sweep.axes[0]) < 0).all()


def test_the_most_informative_sweep_lies_in_the_middle_and_has_distant_contacts(cube):
    sweep = shown_sweep(cube)
    assert abs(sweep.contact[0, 2]) < 10  # of ±20
    assert np.linalg.norm(np.ptp(sweep.contact, axis=0)) > 35


def test_rods_of_a_noisy_recording_stay_near_the_body():
    noisy = scanned(CUBE, noise=1e-3)
    sweep = shown_sweep(noisy)
    assert len(sweep.base) == (noisy.column("sweep") == sweep.number).sum()
    assert np.linalg.norm(np.ptp(sweep.curved.reshape(-1, 3), axis=0)) < 10 * noisy.diagonal


def test_a_sweep_that_does_not_exist(egg):
    with pytest.raises(scan3d.InputError, match="sweep 4711 has no contact; choose one of the 48"):
        shown_sweep(egg, 4711)
    with pytest.raises(scan3d.InputError, match="egg has no recording, which rods are drawn from"):
        shown_sweep(replace(egg, recording=None))


def test_samples_with_equal_forces_are_distinguished_by_their_rows(egg):
    sweep = shown_sweep(egg)
    contacts = np.flatnonzero(egg.column("sweep") == sweep.number)[:2]
    first, second = egg.contacts["row"][contacts]
    force, moment = egg.recording.force_N.copy(), egg.recording.moment_Nm.copy()
    force[second], moment[second] = force[first], moment[first]
    columns = egg.contacts.copy()
    columns["force"][contacts[1]] = columns["force"][contacts[0]]
    equal = replace(egg, contacts=columns, recording=replace(egg.recording, force_N=force, moment_Nm=moment))
    shown = shown_sweep(equal, sweep.number)
    assert np.array_equal(shown.reactions[0], shown.reactions[1])
    # each rod begins at its own clamp, and has the shape that its force gives it
    assert np.array_equal(shown.base, sweep.base)
    assert not np.array_equal(shown.base[0], shown.base[1])
    shapes = shown.rods - shown.base[:, None]
    assert shapes[0] == pytest.approx(shapes[1], abs=1e-9 * egg.diagonal)


def test_contacts_in_any_order_have_their_rods(egg):
    number = shown_sweep(egg).number
    order = np.random.default_rng(5).permutation(len(egg.contacts))
    shuffled = replace(egg, contacts=egg.contacts[order])
    expected = shuffled.points[shuffled.column("sweep") == number]
    assert shown_sweep(shuffled, number).contact == pytest.approx(expected, abs=1e-6 * egg.diagonal)


# --- the rod in space ---


@pytest.fixture(scope="module")
def ellipsoid():
    return scanned_in_space()


def test_rods_in_space_touch_where_the_contacts_are_and_keep_their_length(ellipsoid):
    cloud = scan3d.reconstruct(ellipsoid.recording)
    for number in np.unique(cloud.sweep)[::5]:
        sweep = shown_sweep(ellipsoid, number, points=2000)
        rows = cloud.sweep == number
        assert sweep.slice is None
        assert sweep.contact == pytest.approx(cloud.centre_points[rows], abs=1e-9 * ellipsoid.diagonal)
        length = ellipsoid.recording.rod.length_m * 1e3
        along = [np.linalg.norm(np.diff(lines, axis=1), axis=2).sum(axis=1) for lines in (sweep.curved, sweep.straight)]
        assert sum(along) == pytest.approx(np.full(rows.sum(), length), rel=1e-6)
        # the rod starts along the clamp's y axis, and past a tangential contact goes straight on along its tangent
        start = sweep.curved[:, 1] - sweep.curved[:, 0]
        assert (start @ sweep.axes[1] > 0.999 * np.linalg.norm(start, axis=1)).all()
        tangential = cloud.phase[rows] == planar.Phase.TANGENTIAL
        rest = np.diff(sweep.straight, axis=1)[tangential, 0]
        rest /= np.linalg.norm(rest, axis=1, keepdims=True)
        assert rest == pytest.approx(cloud.tangents[rows][tangential], abs=1e-6)


def test_clamps_may_turn_during_a_sweep(ellipsoid):
    recording, number = ellipsoid.recording, shown_sweep(ellipsoid).number
    # turned about the world's z axis, as far as the sample's number says; contacts turn about the clamps
    turns = Rotation.from_rotvec(np.outer(1e-3 * np.arange(len(recording)), [0, 0, 1]))
    quaternion = (turns * Rotation.from_quat(recording.quaternion, scalar_first=True)).as_quat(scalar_first=True)
    turned = replace(recording, quaternion=quaternion)
    cloud = scan3d.reconstruct(turned)
    sweep = shown_sweep(of_cloud(cloud, recording=turned), number)
    rows = cloud.sweep == number
    assert sweep.turns == pytest.approx(turned.axes()[cloud.row[rows]])
    assert not np.allclose(sweep.turns[0], sweep.turns[-1])
    assert sweep.contact == pytest.approx(cloud.centre_points[rows], abs=1e-9 * ellipsoid.diagonal)


def test_rods_in_space_stay_outside_of_the_fattened_body(ellipsoid):
    semi_axes = np.array(SEMI_AXES) * 50  # mm
    for number in np.unique(ellipsoid.column("sweep"))[::5]:
        points = shown_sweep(ellipsoid, number).rods.reshape(-1, 3)
        assert (np.linalg.norm(points / semi_axes, axis=1) > 1.0).all()


def test_rods_of_a_noisy_recording_in_space_reach_their_contacts():
    noisy = scanned_in_space(noise=(1e-3, 1e-3))
    cloud = scan3d.reconstruct(noisy.recording)
    sweep = shown_sweep(noisy)
    assert sweep.contact == pytest.approx(cloud.centre_points[cloud.sweep == sweep.number], abs=1e-9 * noisy.diagonal)


def test_paths_of_contacts_are_broken_where_the_rod_leaves_the_body(ellipsoid):
    row, sweep = ellipsoid.column("row"), ellipsoid.column("sweep")
    paths = contact_paths(ellipsoid)
    assert {number for _, number in paths} <= set(sweep)
    for line, number in paths:
        mine = np.flatnonzero(sweep == number)
        index = [mine[np.argmin(np.linalg.norm(ellipsoid.points[mine] - point, axis=1))] for point in line]
        assert (np.diff(row[index]) == 1).all()
    assert max(np.linalg.norm(np.diff(line, axis=0), axis=1).max() for line, _ in paths) < 0.2 * ellipsoid.diagonal


def test_rods_that_bend_downward_are_seen_from_below(ellipsoid):
    sides = set()
    for number in np.unique(ellipsoid.column("sweep")):
        sweep = shown_sweep(ellipsoid, number)
        up = ((sweep.contact - sweep.base) @ sweep.axes[2]).mean()
        assert np.sign(sweep_direction(sweep) @ sweep.axes[2]) == np.sign(up)
        sides.add(np.sign(up))
    assert sides == {-1.0, 1.0}


def test_a_recording_of_the_plane_has_no_rods_in_space(ellipsoid):
    without = dict.fromkeys(("force_z_N", "moment_x_Nm", "moment_y_Nm"))
    flat = replace(ellipsoid, recording=replace(ellipsoid.recording, **without))
    with pytest.raises(scan3d.InputError, match="the contacts of ellipsoid do not belong to its recording"):
        shown_sweep(flat)


# --- contacts of another recording ---


def without_rows(scene):
    columns = [name for name in scene.contacts.dtype.names if name != "row"]
    return replace(scene, contacts=scene.contacts[columns])


def with_shorter_recording(scene):
    recording = scene.recording
    first_half = {
        name: getattr(recording, name)[: len(recording) // 2]
        for name in ("sweep", "position_m", "quaternion", "force_N", "moment_Nm")
    }
    return replace(scene, recording=replace(recording, **first_half))


def with_another_recording(scene):
    return replace(scene, recording=scanned(EGG, sweeps=7).recording)


@pytest.mark.parametrize("change", [without_rows, with_shorter_recording, with_another_recording])
def test_contacts_that_do_not_come_from_the_recording(egg, change):
    message = "the contacts of egg do not belong to its recording, which rods are drawn from: reconstruct it again"
    with pytest.raises(scan3d.InputError, match=message):
        shown_sweep(change(egg))


def test_the_deviation_is_looked_up_inside_large_facets(cube):
    mesh, deviation, bound = shown_surface(cube)
    assert mesh.edges_unique_length.max() <= cube.diagonal / 60 * (1 + 1e-9)
    assert mesh.volume == pytest.approx(cube.surface.volume)
    # the hull of the contacts lies inside: its lid below the cube's, its sides in the cube's
    lid = mesh.vertices[:, 2] > mesh.vertices[:, 2].max() - 1e-6
    inner = lid & (np.abs(mesh.vertices[:, :2]).max(axis=1) < 15)
    assert deviation[inner] == pytest.approx(mesh.vertices[inner, 2] - 20, abs=1e-6)
    assert deviation.max() < 1e-9
    # at old vertices the bound is unchanged, and elsewhere it lies between those of old vertices
    old = np.linalg.norm(mesh.vertices[:, None] - cube.surface.vertices, axis=2)
    same = np.argwhere(old < 1e-9)
    assert bound[same[:, 0]] == pytest.approx(cube.bound[same[:, 1]], abs=1e-6)
    assert cube.bound.min() - 1e-6 <= bound.min() <= bound.max() <= cube.bound.max() + 1e-6
