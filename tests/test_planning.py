"""Plans: heights, directions and frames of the slices, and impossible settings."""

import itertools
import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from scan3d import InputError, Plan
from scan3d.geometry.sections import slice_frame
from scan3d.planning.aims import AIMED_SLOPE, OPEN_FRACTION, base_fractions, first_directions, further_directions
from scan3d.planning.heights import (
    FIRST_SLICES,
    cosine_gap,
    cosine_heights_left,
    cuts_at,
    evened,
    first_heights,
    heights,
    heights_at_gaps,
    least_parts,
    parts_within,
)


def test_cosine_heights_are_chebyshevs_nodes():
    # the textbook's: the roots of the polynomial, which is cos(n arccos x)
    levels = heights(-1.0, 1.0, Plan(slices=9, spacing="cosine"))
    assert np.all(np.diff(levels) > 0)
    roots = np.sort(np.polynomial.chebyshev.chebroots([0] * 9 + [1]))
    assert levels == pytest.approx(roots, abs=1e-12)


def test_uniform_heights_are_the_middles_of_equal_slabs():
    assert heights(10.0, 20.0, Plan(slices=5, spacing="uniform")) == pytest.approx([11, 13, 15, 17, 19], rel=1e-15)


@pytest.mark.parametrize("spacing", ["cosine", "uniform"])
@pytest.mark.parametrize("slices", [1, 2, 64])
def test_heights_lie_inside_the_body_and_symmetric(spacing, slices):
    levels = heights(-3.0, 7.0, Plan(slices=slices, spacing=spacing))
    assert len(levels) == slices
    assert np.all((levels > -3) & (levels < 7))
    assert levels + levels[::-1] == pytest.approx(np.full(slices, 4.0), abs=1e-12)


def test_cosine_heights_are_dense_at_the_ends():
    gaps = np.diff(heights(0.0, 1.0, Plan(slices=64, spacing="cosine")))
    assert gaps[0] < gaps[31] / 10


@pytest.mark.parametrize("spacing", ["cosine", "uniform", "adaptive"])
@pytest.mark.parametrize("slices", [1, 4, 64])
def test_a_slice_beyond_either_end_shows_where_the_body_ends(spacing, slices):
    levels = first_heights(-3.0, 7.0, Plan(slices=slices, spacing=spacing))
    beyond = (levels < -3) | (levels > 7)
    assert beyond.sum() == 2
    assert levels[beyond].sum() == pytest.approx(4.0)
    assert np.all((levels[~beyond] > -3) & (levels[~beyond] < 7))
    assert (~beyond).sum() == (min(FIRST_SLICES, slices) if spacing == "adaptive" else slices)


def test_adaptive_spacing_begins_with_some_of_the_heights_of_cosine_spacing():
    first, all_of_them = (first_heights(-3.0, 7.0, Plan(slices=40, spacing=rule)) for rule in ("adaptive", "cosine"))
    assert np.isin(first, all_of_them).all()
    known = first[:-2]
    while len(further := cosine_heights_left(known, np.full(len(known) - 1, 99), 40)):
        assert len(further) <= len(known) - 1
        known = np.sort(np.concatenate([known, further]))
    assert known == pytest.approx(np.sort(all_of_them[:-2]), abs=1e-12)
    rest = cosine_heights_left(first[:-2], np.full(len(first) - 3, 99), 40, at_once=True)
    assert np.sort(np.concatenate([first[:-2], rest])) == pytest.approx(known, abs=1e-12)
    # slabs that are narrow enough are not divided, and those that need few parts get all heights at once
    heights_within = cosine_heights_left(first[:-2], np.array([1, 1, 2, 4, 1, 1, 1]), 40)
    assert np.histogram(heights_within, first[:-2])[0].tolist() == [0, 0, 1, 3, 0, 0, 0]
    assert parts_within(np.array([0.5, 1.0, 3.9, 4.1, np.inf]), 1.0).tolist() == [1, 1, 2, 3, 2**31 - 1]
    assert parts_within(np.ones(1), 0.0).tolist() == [2**31 - 1]


def test_heights_at_gaps_are_those_of_the_worst_corners():
    known = np.array([-0.1, 0.2, 0.5, 0.8, 1.1])
    slab, corners = np.array([1, 1, 2, 2]), np.array([0.3, 0.4, 0.6, 0.7])
    gaps, creases = np.array([1.0, 3.0, 2.0, 0.5]), np.ones((4, 2), dtype=bool)
    # one height per slab, the slab with the widest gap first
    assert heights_at_gaps(known, slab, corners, gaps, creases, 4).tolist() == [0.4, 0.6]
    assert heights_at_gaps(known, slab, corners, gaps, creases, 1).tolist() == [0.4]
    assert len(heights_at_gaps(known, slab, corners, np.zeros(4), creases, 4)) == 0
    # a corner on an end slice gives no height; the new slice is between the end slice and the empty one
    on_end = heights_at_gaps(known, np.array([1]), known[1:2], np.ones(1), creases[:1], 4)
    assert on_end == pytest.approx([0.35])
    # not where slices stand close enough
    close = np.array([0.0, 0.5, 0.5 + 1e-8, 1.0])
    assert len(heights_at_gaps(close, np.array([1]), np.array([0.5]), np.ones(1), creases[:1], 4)) == 0


def gaps_between(thickness, curvature=2.0):
    """Distances of the corners in which the secants of each slab's neighbours meet, from the chord between its slices.

    The contour is a parabola; beyond the end slices its tangents take the place of secants.
    """
    at = np.concatenate([[0.0], np.cumsum(thickness)])
    height, chords = -curvature * at**2 / 2, np.diff(-curvature * at**2 / 2) / thickness
    below, above = np.concatenate([[0.0], chords[:-1]]), np.concatenate([chords[1:], [-curvature * at[-1]]])
    corner = (height[1:] - height[:-1] + below * at[:-1] - above * at[1:]) / (below - above)
    line = height[:-1] + below * (corner - at[:-1])
    return line - (height[:-1] + chords * (corner - at[:-1]))


@pytest.mark.parametrize("thickness", [[1.0], [1.0, 1.0, 1.0], [1.0, 3.0, 0.5, 0.5, 2.0], [0.1, 1.0, 10.0]])
def test_even_gaps_of_a_parabola_are_those_of_its_curvature(thickness):
    thickness = np.array(thickness)
    assert evened(gaps_between(thickness)) == pytest.approx(thickness**2, rel=1e-3)
    assert evened(1e-30 * gaps_between(thickness)) == pytest.approx(1e-30 * thickness**2, rel=1e-3)


def test_even_gaps_of_slabs_without_gaps_are_none():
    assert evened(np.zeros(3)) == pytest.approx(np.zeros(3), abs=1e-150)
    # a slab without a gap bounds its neighbours as tangents do
    assert evened(np.array([0.0, 1.0, 0.0]))[1] == pytest.approx(2.0)
    assert len(evened(np.empty(0))) == 0


def test_even_gaps_along_a_sphere_are_cut_as_by_cosine_spacing():
    levels = heights(-3.0, 7.0, Plan(slices=9, spacing="cosine"))
    known = np.concatenate([[-3.0 - (levels[0] + 3.0)], levels[[0, 4, 8]], [7.0 + (7.0 - levels[-1])]])
    cuts = cuts_at(known, np.array([1, 2]), np.ones(2), np.array([[0.25], [0.5], [0.75]]))
    assert cuts.T.ravel() == pytest.approx(levels[[1, 2, 3, 5, 6, 7]])


def test_a_bent_slab_is_cut_by_the_density_of_slices():
    """The density over the angle is 10 and 20/3 in the middles of two slabs, and linear between them."""
    angles = np.linspace(0.5, 1.1, 3)
    known = 5 - 5 * np.cos(np.concatenate([[-angles[0]], [angles[0]], angles[1:], [np.pi]]))
    # so that the ends of the body are at the angles 0 and pi
    known[0], known[-1] = -known[1], 20 - known[3]
    cuts = cuts_at(known, np.array([1, 2]), np.array([3.0, 2.0]), np.array([[0.25], [0.5]]))
    for column, low, ends in zip(cuts.T, angles, ((10, 25 / 3), (25 / 3, 20 / 3)), strict=False):
        for cut, below in zip(column, (0.25, 0.5), strict=True):
            u = (math.acos(1 - cut / 5) - low) / 0.3
            assert ends[0] * u + (ends[1] - ends[0]) * u**2 / 2 == pytest.approx(below * sum(ends) / 2)
    # where the neighbour's density is not known, the density is constant
    alone = cuts_at(known, np.array([1, 2]), np.array([3.0, np.nan]), np.array([[0.5]]))[0, 0]
    assert math.acos(1 - alone / 5) == pytest.approx(0.65)


def test_bent_slabs_are_halved_and_creases_cut_at_their_corners():
    known = np.array([-0.1, 0.1, 0.5, 0.9, 1.1])
    slab, corners, gaps = np.array([1, 2]), np.array([0.24, 0.66]), np.array([9.0, 4.0])
    bent, creased = np.zeros((2, 2), dtype=bool), np.ones((2, 2), dtype=bool)
    halves = heights_at_gaps(known, slab, corners, gaps, bent, 3)
    assert (known[1:3] < halves).all()
    assert (halves < known[2:4]).all()
    assert heights_at_gaps(known, slab, corners, gaps, creased, 3) == pytest.approx([0.24, 0.66])
    # of both, the wider one comes first, and gaps within the tolerance none
    assert heights_at_gaps(known, slab, corners, gaps, bent, 1) == pytest.approx(halves[:1])
    assert len(heights_at_gaps(known, slab, corners, gaps, bent, 3, 5.0)) == 1


def test_a_slab_bent_all_around_gets_all_heights_of_the_parts_that_make_the_largest_gap_least():
    known = np.array([-0.1, 0.1, 0.5, 0.9, 1.1])
    slab, corners, bent = np.array([1, 2]), np.array([0.3, 0.7]), np.zeros((2, 2), dtype=bool)
    angles = np.arccos(1 - 2 * known[1:-1])
    third = (1 - np.cos(angles[0] + (angles[1] - angles[0]) * np.array([1, 2]) / 3)) / 2
    half = (1 - np.cos(angles[1:].mean())) / 2
    # with three slices left, one slab gets three parts and the other two; the density of slices is nearly the same in both
    gaps = np.array([1.0, 0.999])
    assert heights_at_gaps(known, slab, corners, gaps, bent, 3, left=3) == pytest.approx([*third, half], rel=1e-3)
    # a round gets whole slabs, but no more heights than are left
    assert heights_at_gaps(known, slab, corners, gaps, bent, 1, left=3) == pytest.approx(third, rel=1e-3)
    assert len(heights_at_gaps(known, slab, corners, gaps, bent, 1, left=1)) == 1
    # a slab that needs more parts is cut into two, where five of eleven parts are below
    fifth = (1 - np.cos(angles[0] + (angles[1] - angles[0]) * 5 / 11)) / 2
    assert heights_at_gaps(known, slab, corners, gaps, bent, 1, left=19) == pytest.approx([fifth], rel=1e-3)
    # a tolerance that two parts meet is not divided further
    assert heights_at_gaps(known, slab, corners, gaps, bent, 1, 0.4, left=3) == pytest.approx([1 - half], rel=1e-3)
    # a slab that is straight somewhere is cut in two, and a quarter of the slices is kept for it
    slab, corners, gaps = np.array([1, 1, 2]), np.array([0.3, 0.31, 0.7]), np.array([1.0, 0.5, 0.999])
    straight = np.array([[False, False], [True, False], [False, False]])
    assert heights_at_gaps(known, slab, corners, gaps, straight, 1, left=3) == pytest.approx([1 - half], rel=1e-3)


def test_parts_are_shared_so_that_the_largest_gap_is_least():
    """The numbers of parts by trying all of them."""
    gaps = np.array([1.0, 0.2, 3.0, 0.0])
    for left in range(7):
        parts, gap = least_parts(gaps, left)
        every = np.array(list(itertools.product(range(1, left + 2), repeat=4)))
        allowed = every[(every - 1).sum(axis=1) <= left]
        assert (parts - 1).sum() <= left
        assert gap == pytest.approx((gaps / allowed**2).max(axis=1).min())
        assert (gaps / parts**2).max() == pytest.approx(gap)
    # the third has its two parts, and five slices are left for the others
    assert least_parts(gaps, 6, np.array([9, 9, 2, 9]))[0].tolist() == [5, 2, 2, 1]
    assert least_parts(np.zeros(2), 3) == (pytest.approx([1, 1]), 0.0)


@pytest.mark.parametrize("slices", [8, 13, 64])
def test_the_gap_of_cosine_spacing_is_that_of_its_slabs(slices):
    """Each slab's gap falls with the square of the number of parts into which the nodes divide it."""
    nodes = heights(-3.0, 7.0, Plan(slices=slices, spacing="cosine"))
    known = nodes[np.unique(np.linspace(0, slices - 1, 8).round().astype(int))]
    parts = np.diff(np.flatnonzero(np.isin(nodes, known)))
    gaps = np.linspace(1.0, 2.0, len(known) - 1)
    assert cosine_gap(known * (1 + 1e-9), gaps, slices) == pytest.approx((gaps / parts**2).max())


def test_an_unknown_end_is_sliced_in_the_middle():
    known = np.array([0.0, 1.0, 2.0, 3.0])
    for corner, middle in ((0.0, 0.5), (3.0, 2.5)):
        slab, creases = np.array([0 if corner == 0 else 2]), np.zeros((1, 2), dtype=bool)
        assert heights_at_gaps(known, slab, np.array([corner]), np.ones(1), creases, 4) == pytest.approx([middle])


@pytest.mark.parametrize("samples", [2, 3, 64])
def test_samples_go_from_touch_down_to_the_end_denser_at_the_start(samples):
    shares = base_fractions(samples)
    assert (shares[0], shares[-1]) == (0.0, pytest.approx(1.0))
    assert np.all(np.diff(shares) > 0)
    assert np.all(np.diff(shares, 2) > 0)


directions = st.tuples(*[st.floats(-1, 1)] * 3).map(np.array).filter(lambda v: np.linalg.norm(v) > 1e-3)


@given(directions)
def test_frames_are_orthonormal_right_handed_with_z_along_the_axis(axis):
    frame = slice_frame(axis)
    assert frame @ frame.T == pytest.approx(np.eye(3), abs=1e-14)
    assert np.linalg.det(frame) == pytest.approx(1.0, abs=1e-14)
    assert frame[2] == pytest.approx(axis / np.linalg.norm(axis), abs=1e-14)


def test_the_frame_of_the_z_axis_is_the_worlds():
    assert np.array_equal(slice_frame(Plan().axes()[0]), np.eye(3))


@pytest.mark.parametrize("axis", ["x", "y", "z"])
def test_the_named_axes(axis):
    assert np.array_equal(Plan(axis=axis).axes()[0], np.eye(3)["xyz".index(axis)])


def test_the_axis_has_unit_length():
    assert Plan(axis=(1, 1, 0)).axes() == pytest.approx(np.array([[math.sqrt(0.5), math.sqrt(0.5), 0]]), abs=1e-15)


@pytest.mark.parametrize("sweeps", [1, 4, 7])
def test_first_directions_are_evenly_spaced(sweeps):
    angles = first_directions(Plan(sweeps=sweeps))
    assert angles == pytest.approx(np.arange(sweeps) * 2 * np.pi / sweeps, abs=1e-15)


def circle(angles):
    normals = np.stack([np.cos(angles), np.sin(angles)], axis=1)
    return normals, normals


def test_a_circle_touched_all_round_needs_no_further_directions():
    # the triangle between a chord and its tangents is (gap/2)²/2 high: 720 contacts leave 1e-5
    points, normals = circle(2 * np.pi * np.arange(720) / 720)
    assert len(further_directions(points, normals, 2.0)) == 0


def test_a_gap_is_aimed_at_in_its_middle():
    angles = np.deg2rad(np.arange(0, 300.5, 0.5))  # nothing between 300° and 360°
    (direction,) = further_directions(*circle(angles), width=2.0)
    # the rod, pointing along the direction, meets the normal n = (sin α̃, -cos α̃) of the clamp's frame at the slope aimed at
    y = np.array([np.cos(direction), np.sin(direction)])
    x = np.array([y[1], -y[0]])
    met = np.sin(AIMED_SLOPE) * x - np.cos(AIMED_SLOPE) * y
    assert met == pytest.approx([np.cos(np.deg2rad(330)), np.sin(np.deg2rad(330))], abs=2e-3)  # rounded to 0.001 rad


def test_half_a_circle_unseen_is_a_gap_however_narrow_the_slice():
    assert len(further_directions(*circle(np.deg2rad(np.arange(0, 170.5, 0.5))), width=2.0)) == 1


def square(reach):
    """Contacts on the sides of the square from -1 to 1, as far as `reach` from their middles."""
    along, side = np.linspace(-reach, reach, 11), np.ones(11)
    sides = [(side, along), (-along, side), (-side, -along), (along, -side)]
    normals = np.repeat([[1.0, 0.0], [0.0, 1.0], [-1.0, 0.0], [0.0, -1.0]], 11, axis=0)
    return np.concatenate([np.stack(places, axis=1) for places in sides]), normals


def test_a_corner_between_two_fully_touched_sides_is_not_open():
    # the tangents of the last contacts are the sides themselves
    assert len(further_directions(*square(1.0), width=2.0)) == 0


def test_a_corner_that_was_not_reached_is_open():
    # its triangle is (1 - reach) / sqrt(2) high
    closed, open_ = (1 - fraction * OPEN_FRACTION * 2.0 * math.sqrt(2) for fraction in (0.9, 1.1))
    assert len(further_directions(*square(closed), width=2.0)) == 0
    assert len(further_directions(*square(open_), width=2.0)) == 4


def test_without_tangential_contacts_there_are_no_further_directions():
    assert further_directions(np.empty((0, 2)), np.empty((0, 2)), 1.0).shape == (0,)


@pytest.mark.parametrize(
    ("setting", "sentence"),
    [
        (dict(slices=0), "slices must be a whole number of at least 1, got 0"),
        (dict(slices=-3), "slices must be a whole number of at least 1, got -3"),
        (dict(slices=2.5), "slices must be a whole number of at least 1, got 2.5"),
        (dict(slices=True), "slices must be a whole number of at least 1, got True"),
        (dict(samples=0), "samples must be a whole number of at least 2, got 0"),
        (dict(samples=1), "samples must be a whole number of at least 2, got 1"),
        (dict(seed=-1), "seed must be a whole number of at least 0, got -1"),
        (dict(sweeps=0), "sweeps must be a whole number of at least 1, got 0"),
        (dict(spacing="random"), "spacing must be one of adaptive, cosine, uniform, got 'random'"),
        (dict(unit="furlong"), "unit must be one of m, cm, mm, um, in, got 'furlong'"),
        (dict(friction=-0.1), "friction must be a number >= 0 or a rising range LOW:HIGH of such, got -0.1"),
        (dict(friction=math.nan), "friction must be .*, got nan"),
        (dict(friction=(0.4, 0.0)), r"friction must be .*, got \(0.4, 0.0\)"),
        (dict(friction=(0.0, math.inf)), r"friction must be .*, got \(0.0, inf\)"),
        (dict(friction=(0.0, 0.2, 0.4)), r"a range of friction has two ends, got \(0.0, 0.2, 0.4\)"),
        (dict(noise=-0.1), "noise must be a number >= 0, got -0.1"),
        (dict(noise=math.nan), "noise must be a number >= 0, got nan"),
        (dict(clearance=0.0), "clearance must lie between 0 and 1 rod lengths, got 0.0"),
        (dict(clearance=1.0), "clearance must lie between 0 and 1 rod lengths, got 1.0"),
        (dict(clearance=math.nan), "clearance must lie between 0 and 1 rod lengths, got nan"),
        (dict(tolerance=-1e-3), "tolerance must be a number >= 0, got -0.001"),
        (dict(tolerance=math.nan), "tolerance must be a number >= 0, got nan"),
        (dict(axis="w"), "axis must be x, y, z, several .*, or a vector of three numbers that is not zero, got 'w'"),
        (dict(axis=""), "axis must be .*, got ''"),
        (dict(axis="xyx"), "axis must be .*, got 'xyx'"),
        (dict(axis=(0, 0, 0)), r"axis must be .*, got \(0, 0, 0\)"),
        (dict(axis=(1, 0)), r"axis must be .*, got \(1, 0\)"),
        (dict(axis=(1, 0, math.nan)), r"axis must be .*, got \(1, 0, nan\)"),
    ],
    ids=str,
)
def test_impossible_settings_are_refused(setting, sentence):
    with pytest.raises(InputError, match=f"^{sentence}$"):
        Plan(**setting)
