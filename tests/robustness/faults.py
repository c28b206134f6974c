"""Rods, clamps and sensors that are not quite the stated ones: is anything false that a planar scan states?

    python -m tests.robustness.faults [--seeds 10] [--slices 13 40] [--noise 1e-3 1e-4] [--faults taper curvature] [--jobs 1]
                                      [--group strong] [--first 0] [--verbose]

The recordings are those of `shot_rods`, which integrates each rod on its own.  Each seed is a body of one of four kinds.  Of
each analysis is asked: does a statement on the body fail, as in `bounds`; does the diagnosis name a cause that is none, alone
or without the true one; is the true cause named; is there a certificate, and how wide.  Every false statement is printed with
its seed, then a table by fault, slices and noise.  Fails if anything is false.
"""

from __future__ import annotations

import functools
import itertools
import sys
import time
from collections.abc import Callable
from concurrent.futures import ProcessPoolExecutor
from dataclasses import replace
from typing import NamedTuple
from unittest import mock

import numpy as np
import trimesh

import scan3d
from scan3d import comparison
from scan3d.errors import InputError
from scan3d.geometry.hulls import hull
from scan3d.pipeline import analyse
from scan3d.reconstruction import diagnose
from tests.robustness import options
from tests.robustness.bounds import false_statements
from tests.robustness.shot_rods import Bent, noisy, swept
from tests.sample_bodies import MESHES
from tests.wrong_recordings import offset, scaled, turned

SLICES, NOISE = (13, 40), (1e-3, 1e-4)


class Fault(NamedTuple):
    """What is wrong, and the codes by which a diagnosis names it."""

    rod: Bent = Bent()
    change: Callable[[scan3d.Recording], scan3d.Recording] = lambda recording: recording
    named: tuple[str, ...] = ()
    small: bool = False
    """Whether it costs less than 0.5 % of the rod's length, so that a certificate should remain."""
    tared: bool = True


def steel(diameter_mm, length_mm):
    """Weight of a rod of steel, 7850 kg/m³, in EI/L²."""
    d, length = diameter_mm / 1e3, length_mm / 1e3
    return 16 * 7850 * 9.81 * length**3 / (210e9 * d**2)


def _gain(channel, factor):
    names = (("fx-scale", "force-scale"), ("fy-scale", "force-scale"), ("moment-scale",))[channel]
    return Fault(change=scaled(*np.where(np.arange(3) == channel, factor, 1.0)), named=names, small=factor < 1.005)


FAULTS = {
    "none": Fault(small=True),
    **{f"taper {part:g} %": Fault(Bent(tip=1 - part / 100), named=("taper",), small=part < 1.5) for part in (10, 2, 1)},
    **{
        f"curvature {part:+g} %": Fault(Bent(curvature=part / 100), named=("curvature",), small=abs(part) < 1)
        for part in (2, -2, 0.5, -0.5)
    },
    **{
        f"weight of steel 0.3x{length}": Fault(Bent(weight=steel(0.3, length)), named=("weight",), small=length < 60)
        for length in (50, 100)
    },
    **{
        f"clamp {angle:g} deg": Fault(
            Bent(compliance=np.radians(angle)), named=("clamp-compliance",), small=angle < 0.2
        )
        for angle in (0.5, 0.1)
    },
    **{
        f"gain of {name} {100 * factor - 100:g} %": _gain(channel, factor)
        for factor in (1.003, 1.01)
        for channel, name in enumerate(("fx", "fy", "mz"))
    },
}
STRONG = {
    "weight 0.05, not tared": Fault(Bent(weight=0.05), named=("weight",), tared=False),
    "taper to 0.4": Fault(Bent(tip=0.4), named=("taper",)),
    "curvature -0.3": Fault(Bent(curvature=-0.3), named=("curvature",)),
    "weight 0.1": Fault(Bent(weight=0.1), named=("weight",)),
    "weight 0.1, not tared": Fault(Bent(weight=0.1), named=("weight",), tared=False),
}


def moved(x, y):
    """A sensor that shows the moment about a place beside the clamp, in rod lengths."""

    def change(r):
        arm = r.rod.length_m * (x * r.force_N[:, 1] - y * r.force_N[:, 0])
        return replace(r, moment_Nm=r.moment_Nm - arm)

    return change


def late(way):
    """A wrench that is that of a pose which lay back by a way, in rod lengths."""
    return lambda r: replace(r, position_m=r.position_m - way * r.rod.length_m * r.axes()[:, 0])


def in_world(r):
    force = (r.force_N[:, :, None] * r.axes()[:, :2]).sum(axis=1)
    return replace(r, force_N=force[:, :2], moment_Nm=r.moment_Nm * r.axes()[:, 2, 2])


def jittered(sd):
    """Poses with errors that the recording does not state, in rod lengths."""

    def change(r):
        draw = np.random.default_rng(len(r))
        return replace(r, position_m=r.position_m + sd * r.rod.length_m * draw.standard_normal(r.position_m.shape))

    return change


RIG = {
    **{f"sensor turned by {a:g} deg": Fault(change=turned(a), named=("turned-z",)) for a in (2, 10, -30)},
    **{
        f"moment of a point beside by {d:g} L": Fault(change=moved(0.3 * d, -d), named=("moment-not-moved",))
        for d in (0.02, 0.2)
    },
    **{
        f"gain of {name} {100 * factor - 100:+.0f} %": _gain(channel, factor)
        for factor in (1.1, 0.95)
        for channel, name in enumerate(("fx", "fy", "mz"))
    },
    **{
        f"wrench {100 * factor - 100:+.0f} %": Fault(change=scaled(*[factor] * 3), named=("stiffness",))
        for factor in (1.05, 2)
    },
    **{f"delay by {way:g} L": Fault(change=late(way), named=("delay",)) for way in (0.01, 0.06)},
    "wrench in the world": Fault(change=in_world, named=("wrench-in-world",)),
    "zero off by 1 %": Fault(change=offset(0.01, 0.01, 0.01), named=("not-tared", "drift")),
    "poses off by 0.2 % L": Fault(change=jittered(0.002)),
    "poses off by 2 % L": Fault(change=jittered(0.02), named=("poses",)),
}
GROUPS = {"small": FAULTS, "strong": STRONG, "rig": RIG}


def body(seed):
    """A convex body of about 40 mm: an ellipsoid, a polytope, a rounded box or an egg, turned at random."""
    draw = np.random.default_rng([seed, 41])
    ball = np.asarray(trimesh.creation.icosphere(subdivisions=3).vertices)
    kind = ("ellipsoid", "polytope", "rounded box", "egg")[seed % 4]
    if kind == "ellipsoid":
        points = ball * draw.uniform(0.5, 1.0, 3)
    elif kind == "polytope":
        points = draw.standard_normal((int(draw.integers(12, 40)), 3)) * draw.uniform(0.6, 1.0, 3)
        points /= np.linalg.norm(points, axis=1).max()
    elif kind == "rounded box":
        corners = np.array(np.meshgrid(*[[-1, 1]] * 3)).reshape(3, -1).T * draw.uniform(0.3, 0.6, 3)
        points = (corners[:, None] + draw.uniform(0.1, 0.4) * ball[::2]).reshape(-1, 3)
    else:
        points = ball * [0.7, 0.7, 1.0] * (1 + draw.uniform(0.1, 0.3) * ball[:, [2]])
    turn = trimesh.transformations.random_rotation_matrix(draw.uniform(size=3))[:3, :3]
    return hull(20.0 * points @ turn.T)


def egg_or_pebble(seed):
    mesh = scan3d.load_mesh(MESHES / ("egg.stl", "pebble.obj")[seed % 2])
    mesh.apply_transform(
        trimesh.transformations.rotation_matrix(np.random.default_rng([seed, 44]).uniform(0, 6), [0, 0, 1])
    )
    return mesh


@functools.cache
def template(seed, slices, group="small"):
    """The sweeps of a scan of the body; gravity, along -z, lies in their planes, but for faults of the rig."""
    mesh = egg_or_pebble(seed) if group == "strong" else body(seed)
    plan = scan3d.Plan(slices=slices, samples=8, sweeps=8, friction=0.3, axis="z" if group == "rig" else "x")
    return mesh, scan3d.simulate(mesh, plan)


@functools.lru_cache(2)
def exact(seed, slices, rod, tared, group="small"):
    mesh, recording = template(seed, slices, group)
    return swept(recording, mesh, rod, tared=tared, homotopy=4 if group == "strong" else 1)


class Outcome(NamedTuple):
    false: list[tuple[str, str]]
    cause: str
    """'agrees', 'right', 'unknown', or 'FALSE'."""
    named: str
    bound: float
    """Relative to the body's diagonal, as the next ones."""
    error: float
    relative: float
    """Relative error of the wrench that the bounds allow for."""


def outcome(seed, slices, noise, name):
    """What an analysis of the recording with a fault says, and what of that is false."""
    fault = (FAULTS | STRONG | RIG)[name]
    group = next(group for group, faults in GROUPS.items() if name in faults)
    mesh, _ = template(seed, slices, group)
    found = exact(seed, slices, fault.rod, fault.tared, group)
    recording = noisy(fault.change(found), noise, np.random.default_rng([seed, slices]))
    diagonal = float(np.linalg.norm(mesh.extents))
    with mock.patch.object(comparison, "SOME", 200):
        try:
            analysis = analyse(recording, mesh, "hull")
        except InputError:
            return Outcome([], *judged(diagnose(recording, "planar"), fault), np.inf, np.inf, 0.0)
    false = [] if analysis.warnings else false_statements(mesh, analysis)
    rig = analysis.cloud.calibration
    return Outcome(
        false,
        *judged(analysis.diagnosis, fault),
        analysis.certificate.bound / diagonal,
        analysis.comparison.hausdorff / diagonal,
        0.0 if rig is None else rig.relative,
    )


def judged(found, fault):
    """Whether a diagnosis is right, and what it names."""
    if found is None:
        return "agrees", ""
    if found.fault == "unknown":
        return "unknown", ""
    listed = found.alike or (found.fault,)
    return "right" if set(listed) & set(fault.named) else "FALSE", " or ".join(listed)


def of_fault(seed, slices, name, noises):
    found = []
    for noise in noises:
        start = time.process_time()
        found.append((noise, outcome(seed, slices, noise, name), time.process_time() - start))
    return seed, slices, name, found


def main() -> int:
    counted = dict(seeds=10, first=0, slices=SLICES, noise=NOISE, jobs=1)
    given = options(__doc__, **counted, faults=[""], group="small", verbose=False)
    names = [name for name in GROUPS[given.group] if name.startswith(tuple(given.faults))]
    seeds = range(given.first, given.first + given.seeds)
    tasks = [(*task, given.noise) for task in itertools.product(seeds, given.slices, names)]
    rows: dict[tuple[str, int, float], list[Outcome]] = {}
    with ProcessPoolExecutor(given.jobs) as pool:
        results = (
            pool.map(of_fault, *zip(*tasks, strict=True)) if given.jobs > 1 else (of_fault(*task) for task in tasks)
        )
        for seed, slices, name, found in results:
            for noise, out, seconds in found:
                rows.setdefault((name, slices, noise), []).append(out)
                wrong = out.false + ([("cause", out.named)] if out.cause == "FALSE" else [])
                if wrong or given.verbose:
                    print(f"seed {seed}, {slices} slices, {noise:g}, {name}: {out}, {seconds:.1f} s", flush=True)
    print(f"{'fault':25} slices  noise  false  finite  bound   error  agrees right unknown FALSE", flush=True)
    bad = 0
    for (name, slices, noise), outs in rows.items():
        count = {word: sum(out.cause == word for out in outs) for word in ("agrees", "right", "unknown", "FALSE")}
        false, finite = sum(bool(out.false) for out in outs), [out for out in outs if np.isfinite(out.bound)]
        bad += false + count["FALSE"]
        bound = 100 * np.median([out.bound for out in finite]) if finite else np.nan
        error = 100 * np.median([out.error for out in outs])
        print(
            f"{name:25} {slices:6} {noise:6g} {false:6} {len(finite):4}/{len(outs):<2} {bound:6.2f}% {error:6.3f}% "
            + " ".join(f"{value:6}" for value in count.values())
        )
    return int(bad > 0)


if __name__ == "__main__":
    sys.exit(main())
