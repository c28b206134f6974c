"""How fast and how exact: the closed form beside the methods that it replaces.

    python tests/benchmarks/run.py [--quick]

Everything runs on one core, and times are the processor's, so that other programs disturb them little; medians of several
runs in turns.  The object is the paper's circle, the base positions lie evenly between touch-down and snap-off, in tip and in
tangential contact.  The rivals of step 1 get the phase of every contact from the closed form and start from the neighbouring
solution, and only what they find counts as their error; the closed form gets contour, friction and base positions.
"""

from __future__ import annotations

import argparse
import os
import platform
import sys
import time
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import NamedTuple

import numpy as np
import scipy
from numpy.typing import NDArray

import planar

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))
import shooting

Array = NDArray[np.float64]

CIRCLE = planar.Circle(radius=0.9, center=(0.0, 1.3))
FRICTION = 0.2
EVENTS = planar.events(CIRCLE, FRICTION)
CONTACTS, QUICK_CONTACTS = 300_000, 30_000
# What the slow methods do of them; their time per contact does not depend on the number.
SLOW_CONTACTS, SLOWEST_CONTACTS = 120, 30
REPEATS = 5
BVP_TOLERANCE = 1e-8


class Line(NamedTuple):
    method: str
    contacts: int
    rate: float
    """Contacts per second."""
    errors: tuple[float, ...]


def seconds(*runs: Callable[[], object]) -> list[float]:
    """Median processor time of each of the runs, taken in turns, so that a busy machine disturbs all of them alike."""
    for run in runs:
        run()
    taken = np.empty((REPEATS, len(runs)))
    for row in taken:
        for i, run in enumerate(runs):
            start = time.process_time()
            run()
            row[i] = time.process_time() - start
    return list(np.median(taken, axis=0))


def evenly(contacts: int) -> Array:
    """Base positions strictly between touch-down and snap-off."""
    return np.linspace(EVENTS.x0[0], EVENTS.x0[-1], contacts + 2)[1:-1]


# Step 1


class States(NamedTuple):
    """What every method of step 1 answers: arrays (n,), and contact points (n, 2)."""

    x0: Array
    f: Array
    alpha: Array
    kappa0: Array
    s1: Array
    slope: Array
    point: Array


def swept_states(swept: planar.Sweep) -> States:
    f, alpha = np.hypot(swept.f0x, swept.f0y), np.arctan2(-swept.f0x, swept.f0y)
    return States(swept.x0, f, alpha, -swept.m0z, swept.s1, swept.slope, swept.point)


def solved_states(found: list[shooting.ShootingState]) -> States:
    """Those that the method itself takes for solved."""
    return States(*(np.array([getattr(state, name) for state in found if state.success]) for name in States._fields))


def unsettled(found: States) -> float:
    """How far states are from equilibria: (3) integrated from the clamp (5) at a tolerance of 1e-13 has to meet (6) or (7).

    The largest miss of the end: its distance to the contour point in rod lengths, its curvature, and in tangential contact
    its slope's deviation from the contour's.
    """
    x, y, phi, kappa = shooting.integrate(found.x0, found.f, found.alpha, found.kappa0, found.s1)[..., 0]
    away = np.hypot(*(np.stack([x, y]) - CIRCLE.points(found.slope).T))
    turned = np.where(found.s1 < 1, phi - found.slope, 0.0)
    return float(np.abs([away, kappa, turned]).max())


def by_shooting(guide: planar.Sweep) -> list[shooting.ShootingState]:
    """`scipy.integrate.solve_ivp` and `root`, every contact from its neighbour's solution, the first from its own."""
    place, found = shooting.along(CIRCLE), []
    own = swept_states(guide)
    start: shooting.ShootingState | list[float] = [own.f[0], own.kappa0[0], own.s1[0], own.slope[0]]
    for x0, phase in zip(guide.x0, guide.phase, strict=True):
        start = shooting.shoot(place, FRICTION, x0, planar.Phase(phase), start)
        found.append(start)
    return found


def by_collocation(guide: planar.Sweep, first: shooting.ShootingState) -> list[shooting.ShootingState]:
    """`scipy.integrate.solve_bvp`, every contact from its neighbour's solution and mesh."""
    place, found = shooting.along(CIRCLE), []
    start: shooting.Collocation | shooting.ShootingState = first
    for x0, phase in zip(guide.x0, guide.phase, strict=True):
        start = shooting.solve_by_collocation(place, FRICTION, x0, planar.Phase(phase), start, tol=BVP_TOLERANCE)
        found.append(start.state)
    return found


def forward(contacts: int) -> list[Line]:
    """Step 1, every error as largest distance to the closed form's contact points, and as `unsettled`."""
    base, part = evenly(contacts), evenly(contacts // 10)
    # random from sample to sample, but never so low that the sweep would end before the others
    random = np.random.default_rng(0).uniform(FRICTION, 2 * FRICTION, len(part))
    some = slice(None, None, len(part) // SLOW_CONTACTS)
    varied = swept_states(planar.sweep(CIRCLE, random[some], base=part[some]))

    many, few = (planar.sweep(CIRCLE, FRICTION, base=evenly(n)) for n in (SLOW_CONTACTS, SLOWEST_CONTACTS))
    closed, shot = swept_states(many), by_shooting(few)
    first = by_shooting(planar.sweep(CIRCLE, FRICTION, base=many.x0[:1]))[0]
    collocated = by_collocation(many, first)

    def distance(found: list[shooting.ShootingState]) -> float:
        solved = solved_states(found)
        exact = planar.sweep(CIRCLE, FRICTION, base=solved.x0)
        return float(np.hypot(*(solved.point - exact.point).T).max())

    taken = seconds(
        lambda: planar.sweep(CIRCLE, FRICTION, base=base),
        lambda: planar.sweep(CIRCLE, random, base=part),
        lambda: by_shooting(few),
        lambda: by_collocation(many, first),
    )
    rows = (
        ("closed form, constant friction", len(base), (0.0, unsettled(closed))),
        ("closed form, friction per sample", len(part), (np.nan, unsettled(varied))),
        ("shooting, rtol=1e-13", len(few), (distance(shot), unsettled(solved_states(shot)))),
        (
            f"solve_bvp, tol={BVP_TOLERANCE:g} ({sum(state.success for state in collocated)} solved)",
            len(many),
            (distance(collocated), unsettled(solved_states(collocated))),
        ),
    )
    return [
        Line(name, count, count / time_s, errors) for (name, count, errors), time_s in zip(rows, taken, strict=True)
    ]


# Step 2


def inverse(contacts: int) -> list[Line]:
    """Step 2, every error as largest distance to the true contact, without and with friction, where there is an answer."""
    rows = (("closed-form", contacts), ("scholz-rahn", contacts // 100), ("will", contacts))

    def run(method: str, swept: planar.Sweep) -> planar.Contacts:
        return planar.reconstruct(*swept.reactions, method)

    def error(method: str, friction: float) -> float:
        swept = planar.sweep(CIRCLE, friction, samples=SLOW_CONTACTS)
        return float(np.nanmax(np.hypot(*(run(method, swept).point - swept.point).T)))

    given = [planar.sweep(CIRCLE, FRICTION, base=evenly(count)) for _, count in rows]
    taken = seconds(*(partial(run, method, swept) for (method, _), swept in zip(rows, given, strict=True)))
    return [
        Line(method, count, count / time_s, (error(method, 0.0), error(method, FRICTION)))
        for (method, count), time_s in zip(rows, taken, strict=True)
    ]


# The tables


def one_core() -> None:
    if hasattr(os, "sched_setaffinity"):
        os.sched_setaffinity(0, {min(os.sched_getaffinity(0))})


def rounded(value: float) -> str:
    """Two digits, no more is reproducible."""
    return f"{float(f'{value:.2g}'):,.0f}"


def print_lines(lines: list[Line], errors: tuple[str, ...]) -> None:
    print(f"{'method':34}{'contacts':>10}{'contacts/s':>13}" + "".join(f"{name:>18}" for name in errors))
    for line in lines:
        cells = "".join(f"{'' if np.isnan(value) else f'{value:.1e}':>18}" for value in line.errors)
        print(f"{line.method:34}{line.contacts:>10,}{rounded(line.rate):>13}{cells}")


def main() -> None:
    parser = argparse.ArgumentParser(description="Benchmarks of planar, one table.")
    parser.add_argument("--quick", action="store_true", help="fewer contacts")
    options = parser.parse_args()
    one_core()
    contacts = QUICK_CONTACTS if options.quick else CONTACTS
    print(f"Python {platform.python_version()}, numpy {np.__version__}, scipy {scipy.__version__}, one core")
    print(f"circle r = {CIRCLE.radius}, centre {CIRCLE.center}, μ = {FRICTION}, medians of {REPEATS} runs")
    print("\nStep 1, contour to reactions")
    lines = forward(contacts)
    print_lines(lines, ("to closed form/L", "out of balance"))
    closed, rival = lines[0], lines[-1]
    ratio, precision = closed.rate / rival.rate, max(rival.errors) / max(closed.errors)
    print(f"closed form over solve_bvp: {rounded(ratio)} x the contacts, error 1/{rounded(precision)}")

    print("\nStep 2, reactions to contacts")
    lines = inverse(contacts)
    print_lines(lines, ("error/L, μ = 0", f"error/L, μ = {FRICTION}"))
    inverse_ratio = lines[0].rate / lines[1].rate
    print(f"closed form over Scholz & Rahn's integration: {rounded(inverse_ratio)} x the contacts")


if __name__ == "__main__":
    main()
