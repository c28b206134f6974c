"""Random bodies, plans, noise and digits: does what a scan states of the body hold?

    python -m tests.robustness.bounds [--count 1500] [--seed 0] [--noise 0 1e-4] [--digits 5 '10 bit'] [--model spatial]

Each draw is a right recording of a convex body.  Of its analysis is asked: the certified bound is at least the true
Hausdorff distance, no vertex of the surface lies farther from the body than its local bound, both hold of other surfaces
as well, the inner body lies inside the true one, which lies in the outer one and within the inner one's bound, extents,
volume and support function lie in the stated intervals, there are no warnings, no errors, and no contact that is not finite.
Every failure is printed with the seed that repeats it (`--seed SEED --count 1`), then the totals by noise.  Fails if anything
fails on exact data, or more often than the stated confidence allows on noisy data.

Failures that are to be expected are counted apart.  Missed slices: a slice of the body that the recording has no contact in,
because the rod does not reach it or the samples pass it by, counts as empty, and bounds the body where it goes on.  Coarse
poses: digits of the poses that are coarser than 1e-4 rod lengths are taken for those of a plan, and for exact; and slices that
are closer than those digits count as one.

Scans in space have all their digits.  Their contacts lie off the surface by what errors of the normals make of the radius, so
that the inner body is asked for its bound only.
"""

from __future__ import annotations

import collections
import dataclasses
import sys
import time
import traceback
import warnings
from unittest import mock

import numpy as np
import trimesh

import scan3d
from scan3d import comparison
from scan3d.errors import InputError
from scan3d.geometry.distance import nearest
from scan3d.geometry.hulls import hull
from scan3d.geometry.sections import slice_frame, slice_polygons
from scan3d.pipeline import analyse
from scan3d.recording import _FINE as FINE
from scan3d.recording import rounding_sd
from scan3d.report import measurands
from scan3d.rods import Rod
from scan3d.simulation.scan import width_of
from scan3d.surfaces import certificate
from scan3d.units import UNITS_M
from tests.robustness import options
from tests.sample_bodies import convex_hausdorff
from tests.shapes import unit

NOISE = (0.0, 1e-7, 1e-5, 1e-4, 1e-3, 3e-3, 1e-2)
KINDS = ("points", "plate", "needle", "box", "prism", "cone", "drop", "ellipsoid", "chamfered", "tetrahedron")
DIGITS = ("4", "5", "6", "7", "9", "12", "float32", "8 bit", "10 bit", "12 bit", "16 bit", "20 bit", "24 bit", "poses")
METHODS = ("hull", "bracket", "auto")
# In which support functions are compared: the axes, and random ones.
DIRECTIONS = unit(np.concatenate([np.eye(3), -np.eye(3), np.random.default_rng(5).normal(size=(100, 3))]))
# Rounding of distances, relative to the diagonal.
ROUNDING = 1e-9
CONFIDENCE = 0.95
# Failures that are counted apart.
MISSED, COARSE = "missed slice: ", "coarse poses: "


@dataclasses.dataclass(frozen=True)
class Draw:
    """A body, how it is scanned, and what becomes of its recording."""

    kind: str
    mesh: trimesh.Trimesh
    plan: scan3d.Plan
    digits: str
    """'' for numbers of full precision, 'float32', a number of significant digits, '12 bit' for a converter's steps, or 'poses'
    and the standard deviation of their rounding in rod lengths."""
    method: str

    def __str__(self) -> str:
        plan = {
            field.name: getattr(self.plan, field.name)
            for field in dataclasses.fields(self.plan)
            if getattr(self.plan, field.name) != field.default
        }
        return f"{self.kind}, digits {self.digits or 'all'}, {self.method}, {plan}"


def corners(kind, draw):
    """Points (n, 3) whose hull is a body of size about 1."""
    around = np.linspace(0, 2 * np.pi, int(draw.integers(3, 40)), endpoint=False)
    circle = np.column_stack([np.cos(around), np.sin(around), 0 * around])
    if kind in ("points", "plate", "needle"):
        points = draw.standard_normal((int(draw.integers(6, 60)), 3))
        thin = 10 ** draw.uniform(-3, -1)
        stretch = {"points": draw.uniform(0.3, 1, 3), "plate": [1, 1, thin], "needle": [thin, thin, 1]}
        return points * stretch[kind]
    if kind == "tetrahedron":
        return draw.standard_normal((4, 3))
    if kind == "box":
        return np.array(np.meshgrid(*[[-1, 1]] * 3)).reshape(3, -1).T * 10 ** draw.uniform(-1, 0, 3)
    if kind == "prism":
        height = [0, 0, 10 ** draw.uniform(-1, 0.5)]
        return np.concatenate([circle + height, circle - height])
    if kind == "cone":
        return np.concatenate([circle, [[*draw.uniform(-0.5, 0.5, 2), 10 ** draw.uniform(-1, 0.5)]]])
    if kind == "drop":
        half = unit(draw.standard_normal((150, 3))) * [1, 1, -1]
        return np.concatenate([half[half[:, 2] < 0.3], [[0, 0, draw.uniform(1.5, 4)]]])
    if kind == "ellipsoid":
        return unit(draw.standard_normal((int(draw.integers(50, 400)), 3))) * draw.uniform(0.2, 1, 3)
    points = draw.standard_normal((12, 3))  # corners cut off by tiny facets
    size = 10 ** draw.uniform(-7, -2)
    return np.concatenate([points, *(points + size * draw.standard_normal(points.shape) for _ in range(3))])


def body(draw):
    """A random convex body and its kind: of any size and place, oblique or along the axes."""
    kind = str(draw.choice(KINDS))
    points = corners(kind, draw)
    if draw.random() < 0.7:
        points = points @ trimesh.transformations.random_rotation_matrix(draw.uniform(size=3))[:3, :3].T
    points = points / np.ptp(points, axis=0).max()
    if draw.random() < 0.5:
        points = points + 10 ** draw.uniform(0, 1.5) * unit(draw.standard_normal((1, 3)))
    size = 20.0 if draw.random() < 0.7 else 10 ** draw.uniform(-6, 6)
    return kind, hull(size * points)


def drawn(seed, noise=NOISE, fewest=(4, 16), most=(40, 80), model="planar"):
    """The draw of a seed; slices and samples per sweep lie between `fewest` and `most`."""
    draw = np.random.default_rng([seed, 11])
    kind, mesh = body(draw)
    several = draw.random() < 0.15
    slices, samples = (int(a * (b / a) ** (draw.uniform() ** 1.5)) for a, b in zip(fewest, most, strict=True))
    friction = sorted(float(value) for value in draw.choice([0.0, 0.05, 0.2, 0.3, 0.6, 1.0], 2))
    plan = scan3d.Plan(
        slices=min(slices, 12) if several else slices,
        samples=samples,
        sweeps=None if draw.random() < 0.5 else int(draw.integers(3, 9)),
        spacing=str(draw.choice(["cosine", "uniform", "adaptive"], p=[0.5, 0.3, 0.2])),
        axis="xyz" if several else str(draw.choice(["x", "y", "z"])),
        friction=(friction[0], friction[1]) if draw.random() < 0.4 else friction[0],
        clearance=float(draw.choice([0.3, draw.uniform(0.02, 0.6)])),
        noise=float(draw.choice(noise)),
        seed=seed,
        unit=str(draw.choice(["mm", "mm", "um", "m", "in"])),
    )
    if seed % 7 == 0:
        plan = dataclasses.replace(plan, axis="xy" if several else (1.0, 2.0, 0.5))
    if draw.random() < 0.6:
        width = max(width_of(mesh, slice_frame(axis)) for axis in plan.axes())
        length = float(np.exp(draw.uniform(np.log(0.4), np.log(2)))) * width * UNITS_M[plan.unit]
        plan = dataclasses.replace(plan, rod=Rod.of_length(length))
    if draw.random() < 0.1:  # few and long sweeps
        plan = dataclasses.replace(plan, slices=min(plan.slices, 5), samples=4 * most[1], sweeps=4)
    if model == "spatial":
        default = scan3d.Plan()
        unused = {name: getattr(default, name) for name in ("sweeps", "spacing", "axis")}
        plan = dataclasses.replace(plan, model=model, slices=min(slices, most[0] // 3), **unused)
        return Draw(kind, mesh, plan, "", str(draw.choice(METHODS)))
    digits = str(draw.choice(DIGITS))
    if digits == "poses":
        digits = f"poses {10 ** draw.uniform(-8, -4):.2g}"
    return Draw(kind, mesh, plan, digits if draw.random() < 0.35 else "", str(draw.choice(METHODS)))


def rounded(recording, digits):
    """The recording with limited digits: all of its columns, force and moment in steps of a converter, or the positions."""
    if not digits:
        return recording
    if digits.startswith("poses"):
        step = float(digits.split()[1]) * np.sqrt(12) * recording.rod.length_m
        return dataclasses.replace(recording, position_m=step * np.round(recording.position_m / step))
    if digits.endswith("bit"):
        columns = {}
        for name in ("force_N", "moment_Nm"):
            values = getattr(recording, name)
            step = np.abs(values).max() * 2.0 ** (1 - int(digits.split()[0]))
            columns[name] = step * np.round(values / step)
        return dataclasses.replace(recording, **columns)
    columns = {name: getattr(recording, name) for name in ("position_m", "quaternion", "force_N", "moment_Nm")}
    if digits == "float32":
        return dataclasses.replace(recording, **{name: column.astype(np.float32) for name, column in columns.items()})
    shortened = np.vectorize(lambda value: float(f"{value:.{int(digits) - 1}e}"))
    return dataclasses.replace(recording, **{name: shortened(column) for name, column in columns.items()})


def failures(draw, changed=lambda recording: recording):
    """What fails of a draw, as pairs of a word and the numbers; None if the scan is refused in a sentence.

    changed
        what is done to the recording.
    """
    # averages over the surfaces, which are not asked for here, take most of a comparison's time
    with warnings.catch_warnings(record=True) as caught, mock.patch.object(comparison, "SOME", 200):
        warnings.simplefilter("always")
        try:
            exact = scan3d.simulate(draw.mesh, draw.plan)
            recording = changed(rounded(exact, draw.digits))
            analysis = analyse(recording, draw.mesh, draw.method)
        except InputError:
            return None
        except Exception:
            return [("error", traceback.format_exc())]
        if not analysis.has_surface:  # of contacts that span no body nothing is stated
            return None
        found = [("warning of numpy", str(warning.message)) for warning in caught]
    found += [("warning", f"{warning.code}: {warning.message}") for warning in analysis.warnings]
    cloud, axes = analysis.cloud, exact.axes()[:, 2]
    heights = (exact.position_m * axes).sum(axis=1) / exact.rod.length_m
    exact_slices = len(np.unique(np.round(np.column_stack([axes, heights]), 9), axis=0))
    names = ["points", "force_N", "covariance", "place_sd"]
    columns = [getattr(cloud, name) for name in names if getattr(cloud, name) is not None]
    if not all(np.isfinite(column).all() for column in columns) or (
        cloud.normal_sd is not None and not (cloud.normal_sd >= 0).all()
    ):
        found.append(("contacts not finite", ""))
    false = false_statements(draw.mesh, analysis) if not analysis.warnings else []
    if draw.plan.model == "spatial":
        return found + false
    if false and _missed(draw.mesh, analysis):
        false = [(f"{MISSED}{name}", numbers) for name, numbers in false]
    coarse = rounding_sd(recording.position_m.ravel()) > FINE * recording.rod.length_m
    if coarse or len(cloud.slice_height) < exact_slices:
        return [(f"{COARSE}{name}", numbers) for name, numbers in found + false]
    return found + false


def counts(name):
    """Whether a failure is one that must not be."""
    return not name.startswith((MISSED, COARSE))


def false_statements(mesh, analysis):
    """The statements about the body that are false."""
    off = np.abs(nearest(np.asarray(analysis.surface.vertices), mesh)[0])
    worst = np.argmax(off - analysis.certificate.at_vertices)
    claims = {
        "bound": (analysis.comparison.hausdorff, analysis.certificate.bound),
        "local bound": (float(off[worst]), float(analysis.certificate.at_vertices[worst])),
    }
    stated = measurands(analysis.cloud, analysis.bounds, analysis.surface, analysis.certificate)
    for extent, known in zip(mesh.extents, stated[:3], strict=True):
        low, high = known["interval"]
        claims |= {f"least {known['quantity']}": (low, extent), f"largest {known['quantity']}": (extent, high)}
    found = wrong(claims, mesh) + false_bounds(mesh, analysis.bounds, analysis.cloud.model == "spatial")
    return found + false_certificates(mesh, analysis.bounds)


def false_certificates(mesh, bounds, *more):
    """What is false of the certificates of surfaces: of the inner body, larger and moved ones, and of `more`."""
    vertices, claims = np.asarray(bounds.inner.vertices), {}
    moved = hull(1.05 * vertices), hull(0.9 * vertices + 0.05 * float(np.linalg.norm(mesh.extents)))
    for k, shape in enumerate((bounds.inner, *moved, *more)):
        certified = certificate(bounds, shape)
        claims[f"bound of surface {k}"] = convex_hausdorff(shape, mesh), certified.bound
        claims[f"bound at vertices of {k}"] = float(certified.at_vertices.max()), certified.bound
        off = np.abs(nearest(shape.vertices, mesh)[0])
        claims[f"local bound of surface {k}"] = float((off - certified.at_vertices).max()), 0.0
    return wrong(claims, mesh)


def wrong(claims, mesh):
    """Those claims, as pairs of a true value and the largest that is claimed, by their name, that do not hold."""
    rounding = ROUNDING * float(np.linalg.norm(mesh.extents))
    return [
        (name, f"true {true:.4g}, claimed {claimed:.4g}")
        for name, (true, claimed) in claims.items()
        if not true <= claimed + rounding
    ]


def false_bounds(mesh, bounds, spatial=False):
    """The statements of an enclosure that are false."""
    vertices, rounding = np.asarray(mesh.vertices), ROUNDING * float(np.linalg.norm(mesh.extents))
    claims = {"inner body's bound": (float(nearest(vertices, bounds.inner)[0].max()), bounds.bound)}
    # contacts that prove nothing claim nothing
    if not spatial and not bounds.bound == bounds.margin == np.inf:
        claims["inner body"] = float(nearest(np.asarray(bounds.inner.vertices), mesh)[0].max()), bounds.excess
    if len(planes := bounds.outer_planes()):
        claims["outer body"] = float((vertices @ planes[:, :3].T - planes[:, 3]).max()), 0.0
    found = wrong(claims, mesh)
    low, high = bounds.support(DIRECTIONS)
    reach = (vertices @ DIRECTIONS.T).max(axis=0)
    if not ((low <= reach + rounding) & (reach <= high + rounding)).all():
        found.append(("support", f"beyond by {(low - reach).max():.4g} or {(reach - high).max():.4g}"))
    volume, (lower, upper) = mesh.volume, bounds.volume
    slack = rounding * mesh.area
    if not lower - slack <= volume <= upper + slack:
        found.append(("volume", f"true {volume:.6g}, claimed {lower:.6g} to {upper:.6g}"))
    return found


def _missed(mesh, analysis):
    """Whether the body reaches into a slice that counts as empty."""
    cloud = analysis.cloud
    empty = np.setdiff1d(np.arange(len(cloud.slice_height)), cloud.slice)
    if cloud.unresolved is not None:
        empty = empty[~cloud.unresolved[empty]]
    heights = np.asarray(mesh.vertices) @ cloud.slice_axis[empty].T
    rounding = 1e-9 * np.ptp(heights, axis=0)
    inside = (heights.min(axis=0) + rounding < cloud.slice_height[empty]) & (
        heights.max(axis=0) - rounding > cloud.slice_height[empty]
    )
    return any(
        len(polygon)
        for number in empty[inside]
        for polygon in slice_polygons(
            mesh, slice_frame(cloud.slice_axis[number]), cloud.slice_height[number : number + 1]
        )
    )


def main() -> int:
    arguments = options(__doc__, count=1500, seed=0, digits=[""], noise=NOISE, model="planar")
    totals, failed, names = collections.Counter(), collections.Counter(), collections.Counter()
    start = time.monotonic()
    for seed in range(arguments.seed, arguments.seed + arguments.count):
        draw = drawn(seed, arguments.noise, model=arguments.model)
        if any(arguments.digits):
            draw = dataclasses.replace(draw, digits=arguments.digits[seed % len(arguments.digits)])
        found = failures(draw)
        if found is None:
            names["refused in a sentence"] += 1
            continue
        key = (draw.plan.noise, bool(draw.digits))
        totals[key] += 1
        failed[key] += any(counts(name) for name, _ in found)
        names.update(name for name, _ in found)
        if seed % 100 == 99:
            print(f"{seed - arguments.seed + 1} draws in {time.monotonic() - start:.0f} s", file=sys.stderr, flush=True)
        for name, numbers in found:
            print(f"seed {seed}: {name}: {numbers}\n    {draw}", flush=True)
    print(f"{arguments.count} draws in {time.monotonic() - start:.0f} s")
    for key in sorted(totals):
        print(f"noise {key[0]:.0e}{', limited digits' if key[1] else '':16}: {failed[key]} of {totals[key]} fail")
    for name, count in sorted(names.items()):
        print(f"{name}: {count}")
    allowed = {key: 0 if key == (0.0, False) else (1 - CONFIDENCE) * total for key, total in totals.items()}
    return int(any(failed[key] > allowed[key] for key in totals))


if __name__ == "__main__":
    sys.exit(main())
