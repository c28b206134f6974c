"""Segments of a path: cut where the kind of contact changes and where the base position has its minima, the folds."""

import numpy as np
import pytest

import planar
from planar import segments

CONTOURS = {
    "circle": planar.Circle(0.9, (0.0, 1.3)),
    "low circle": planar.Circle(0.4, (0.2, 0.5)),
    "ellipse": planar.Ellipse((0.7, 0.4), (0.1, 1.0), 0.35),
    "thin ellipse": planar.Ellipse((0.6, 0.05), (0.0, 0.8), -0.5),
    "triangle pointing down": planar.Polygon(np.array([[0.1, 0.4], [0.5, 1.4], [-0.6, 1.2]])),
}
FRICTIONS = (0.0, 0.4, 2.0)


def cut(contour, friction):
    path = contour.path()
    piece = np.arange(path.offsets[-1])
    return path, segments.cut(path, np.zeros_like(piece), piece, np.full(len(piece), np.arctan(friction)))


def equilibria_at(path, table, rows, t):
    slope, x, y = path.at(table.piece[rows], t)
    return slope, segments.states(table.tangential[rows], slope, x, y, table.friction_angle[rows])


def rate(path, piece, slope, state):
    """Change of x0 along the path, per unit of the parameter."""
    turn, arc = path.turn[piece], path.arc_rate(piece, slope)
    with np.errstate(invalid="ignore"):
        return np.where(turn != 0, state.x0_slope * turn, 0.0) + np.where(arc != 0, state.x0_arc * arc, 0.0)


def folds(table):
    """Rows that end in a fold within a piece."""
    return np.flatnonzero((table.rate[:, 0] < 0) & (table.rate[:, 1] == 0))


@pytest.mark.parametrize("contour", CONTOURS.values(), ids=CONTOURS)
def test_folds_are_cut_on_the_side_on_which_the_base_position_falls(contour):
    # An equilibrium on the rising side of a fold is unstable: no sweep comes to it, not even by a rounding.
    for friction in FRICTIONS:
        path, table = cut(contour, friction)
        rows = folds(table)
        assert len(rows)
        slope, state = equilibria_at(path, table, rows, table.t[rows, 1])
        assert (rate(path, table.piece[rows], slope, state) <= 0).all(), friction


@pytest.mark.parametrize("contour", CONTOURS.values(), ids=CONTOURS)
def test_folds_are_minima_of_the_base_position(contour):
    for friction in FRICTIONS:
        path, table = cut(contour, friction)
        rows = folds(table)
        for step in (1e-3, 1e-4):  # x0 rises with the square of the step
            for sign in (-1, 1):
                t = table.t[rows, 1] + sign * step
                _, state = equilibria_at(path, table, rows, t)
                assert not (state.x0 < table.x0[rows, 1]).any()
        following = rows + 1
        assert not (table.x0[following, 1] < table.x0[following, 0]).any()


@pytest.mark.parametrize("contour", CONTOURS.values(), ids=CONTOURS)
@pytest.mark.slow
def test_the_last_sample_of_a_sweep_is_stable(contour):
    # the end of a sweep is a fold, or the end of the path
    for friction in FRICTIONS:
        swept = planar.sweep(contour, friction, samples=2)
        path, table = cut(contour, friction)
        row = int(np.nanargmin(table.x0[:, 1]))
        slope, state = equilibria_at(path, table, np.array([row]), table.t[[row], 1])
        assert swept.slope[-1] == slope[0]
        assert swept.x0[-1] == table.x0[row, 1]
        assert not (rate(path, table.piece[[row]], slope, state) > 0).any()


@pytest.mark.parametrize("contour", CONTOURS.values(), ids=CONTOURS)
def test_the_base_position_is_monotone_on_every_segment(contour):
    fractions = np.linspace(0, 1, 12)
    for friction in FRICTIONS:
        path, table = cut(contour, friction)
        rows = np.repeat(np.arange(len(table.owner)), len(fractions))
        (start, end), at = table.t[rows].T, np.tile(fractions, len(table.owner))
        _, state = equilibria_at(path, table, rows, start + at * (end - start))
        steps = np.diff(state.x0.reshape(-1, len(fractions)), axis=1)
        falls = table.x0[:, 1] < table.x0[:, 0]
        assert falls.any()
        assert (steps[falls] < 1e-14).all(), friction
