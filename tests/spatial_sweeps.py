"""Frictionless sweeps past an ellipsoid, by scipy's root finding on the planar closed form in the bending plane."""

import numpy as np
from scipy.optimize import root

from planar.elastica import bend
from scan3d.spatial.normals import Track

AXES, CENTRE = np.array([0.9, 0.675, 0.45]), np.array([0.0, 1.075, 0.0])


def ellipsoid_normal(points):
    normal = (points - CENTRE) / AXES**2
    return normal / np.linalg.norm(normal, axis=1, keepdims=True)


def _state(unknowns):
    omega, alpha, q, s1 = unknowns
    shape = bend(np.array([alpha]), np.array([q]))
    scale = shape.length[0] / s1
    across, along = np.array([np.cos(omega), 0, np.sin(omega)]), np.array([0.0, 1.0, 0.0])
    point = (shape.x[0] * across + shape.y[0] * along) / scale
    beta = np.arcsin(2 * (np.sin(alpha / 2) ** 2 + q * q) - 1)
    tangent = np.cos(alpha - beta) * across + np.sin(alpha - beta) * along
    force = np.sin(alpha) * across - np.cos(alpha) * along
    return point, tangent, force, scale


def sweep(height, base):
    """Tangential and tip contacts (n, 4: ω, α, q, s1) of one frictionless sweep at base positions (n,), by continuation."""
    guess = np.array([0.8 * np.sign(height), 1.2, 0.3, 0.95])
    states = []
    approach = np.linspace(0.5, base[0], 30)
    for x0 in np.concatenate([approach, base]):
        origin = np.array([x0, 0, height])

        def residual(unknowns, tip=False, origin=origin):
            point, tangent, force, _ = _state(unknowns)
            offset = (point + origin - CENTRE) / AXES
            normal = offset / AXES / np.linalg.norm(offset / AXES)
            sideways = np.cross(force, normal)
            last = 1 - unknowns[3] if tip else tangent @ normal
            b = np.array([-np.sin(unknowns[0]), 0, np.cos(unknowns[0])])
            return [offset @ offset - 1, sideways @ b, sideways @ np.cross(b, force), last]

        solved = root(residual, guess, options={"xtol": 1e-13}).x
        if solved[3] > 1:
            solved = root(residual, [*solved[:3], 1.0], args=(True,), options={"xtol": 1e-13}).x
        assert np.abs(residual(solved, solved[3] > 1 - 1e-12)).max() < 1e-10
        guess = solved
        states.append(solved)
    return np.array(states[len(approach) :])


def track(heights, samples, friction=0.0):
    """Frictionless sweeps at heights over the base.

    With `friction` the force is turned against the slip, and the path stays: these are no equilibria of a rod, but the
    relations between path, slip, force and normal are those that normals are found from.
    """
    columns = {name: [] for name in ("sweep", "row", "travel", "point", "s1", "tangent", "force", "tangential")}
    base, step = np.linspace(0.72, -0.72, samples), 1e-4
    for number, height in enumerate(heights):
        states = sweep(height, (base[:, None] + [step, 0, -step]).ravel()).reshape(samples, 3, 4)
        for row, (x0, near) in enumerate(zip(base, states, strict=True)):
            (before, _, _, _), (point, tangent, force, scale), (after, _, _, _) = map(_state, near)
            point = point + np.array([x0, 0, height])
            tangential = near[1, 3] < 1 - 1e-9
            slip = (after - before) / 2 / step - [1, 0, 0] - tangential * (near[2, 3] - near[0, 3]) / 2 / step * tangent
            normal = ellipsoid_normal(point[None])[0]
            slip -= slip @ normal * normal
            force = scale**2 * (force - friction * slip / np.linalg.norm(slip))
            for column, value in zip(
                columns.values(), (number, row, -x0, point, near[1, 3], tangent, force, tangential), strict=True
            ):
                column.append(value)
    return Track(**{name: np.array(column) for name, column in columns.items()})
