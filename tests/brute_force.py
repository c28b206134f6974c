"""Distances by methods independent of the program: all triangles tried, 60 digits, support functions."""

import mpmath
import numpy as np
from shapes import spread, unit

EXACT = 1e-12  # of the diagonal: a few roundings
GAP = 1.001  # certified bounds are this close, unless time runs out


def far(points, mesh, kind=np.longdouble):
    """Distance (n,) of points to a mesh by trying all its triangles, region by region, in extended precision."""
    points = np.asarray(points, dtype=kind)[:, None]
    a, b, c = np.moveaxis(np.asarray(mesh.vertices, dtype=kind)[mesh.faces], 1, 0)
    normal = np.cross(b - a, c - a)
    square = (normal**2).sum(axis=-1)
    inside, nearest = square > 0, np.inf
    for start, end in ((a, b), (b, c), (c, a)):
        inside = inside & ((np.cross(end - start, points - start) * normal).sum(axis=-1) >= 0)
        nearest = np.minimum(nearest, from_segments(points[:, 0], start, end))
    height = np.abs(((points - a) * normal).sum(axis=-1)) / np.sqrt(np.maximum(square, 1e-300))
    return np.where(inside, np.minimum(height, nearest), nearest).min(axis=1).astype(float)


def from_segments(points, start, end):
    """Distances (n, ...) of points (n, 3) from segments (..., 3)."""
    edge = end - start
    away = points.reshape(-1, *[1] * (edge.ndim - 1), 3) - start
    along = (away * edge).sum(axis=-1) / np.maximum((edge**2).sum(axis=-1), 1e-300)
    return np.sqrt(((away - np.clip(along, 0, 1)[..., None] * edge) ** 2).sum(axis=-1))


def farthest(source, target, steps):
    """The largest distance to the target from the nodes of a grid on each of the source's faces, in double precision."""
    points = spread(source, steps)
    parts = np.array_split(points, 1 + len(points) * len(target.faces) // 100_000)
    return max(far(part, target, np.float64).max() for part in parts)


def far_in_60_digits(point, a, b, c):
    """Distance of a point to one triangle."""

    def dot(x, y):
        return x[0] * y[0] + x[1] * y[1] + x[2] * y[2]

    def cross(x, y):
        return [x[1] * y[2] - x[2] * y[1], x[2] * y[0] - x[0] * y[2], x[0] * y[1] - x[1] * y[0]]

    def minus(x, y, times=1):
        return [u - times * v for u, v in zip(x, y, strict=True)]

    with mpmath.workdps(60):
        p, a, b, c = ([mpmath.mpf(float(x)) for x in corner] for corner in (point, a, b, c))
        normal = cross(minus(b, a), minus(c, a))
        inside, nearest = dot(normal, normal) > 0, mpmath.inf
        for start, end in ((a, b), (b, c), (c, a)):
            edge, away = minus(end, start), minus(p, start)
            inside = inside and dot(cross(edge, away), normal) >= 0
            length = dot(edge, edge)
            away = minus(away, edge, min(max(dot(away, edge) / length, 0), 1) if length else 0)
            nearest = min(nearest, mpmath.sqrt(dot(away, away)))
        return float(abs(dot(minus(p, a), normal)) / mpmath.sqrt(dot(normal, normal)) if inside else nearest)


def by_support(first, second):
    """Hausdorff distance of two convex bodies: the largest difference of their support functions, over directions."""
    rng = np.random.default_rng(0)

    def difference(u):
        return np.abs((u @ first.vertices.T).max(axis=1) - (u @ second.vertices.T).max(axis=1))

    u = unit(rng.standard_normal((20_000, 3)))
    best = u[np.argsort(difference(u))[-20:]]
    spread = 0.05
    for _ in range(70):  # narrower and narrower about the best directions
        u = unit(
            np.concatenate([best, np.repeat(best, 40, axis=0) + spread * rng.standard_normal((40 * len(best), 3))])
        )
        best = u[np.argsort(difference(u))[-20:]]
        spread *= 0.7
    return difference(best).max()


def certified(result):
    assert result.hausdorff == result.lower == max(result.surface_to_mesh, result.mesh_to_surface)
    assert result.upper == max(result.surface_to_mesh_upper, result.mesh_to_surface_upper)
    for lower, upper in (
        (result.surface_to_mesh, result.surface_to_mesh_upper),
        (result.mesh_to_surface, result.mesh_to_surface_upper),
        (result.lower, result.upper),
    ):
        # the absolute gap refers to the box around both meshes, which is larger than the mesh's by their distance
        assert lower <= upper <= GAP * lower + 1e-9 * (result.diagonal + 2 * result.hausdorff)
    return result
