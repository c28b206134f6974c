"""Faults of recordings that can be recognised: what corrects each of them, and what is said about it."""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from scan3d.arrays import Array, Index
from scan3d.reconstruction.misfits import Reactions
from scan3d.recording import Recording
from scan3d.rods import Rod

# Starts of the search: factors of scales.
_SCALES = (0.3, 0.5, 0.7, 0.85, 0.95, 1.05, 1.2, 1.5, 2.0, 3.0)
# Largest logarithm of a scale.  With larger ones the noise, which is not scaled, hides any misfit.
_LARGEST_SCALE = 1.4
# Contacts near the tip count as tip contacts, so that the misfit is one of steps in the length: those of the starts are finer.
_LENGTHS = np.linspace(0.7, 1.4, 47)


class Fault(NamedTuple):
    """A fault with its estimated size."""

    code: str
    value: float | None
    unit: str
    message: str


class Hypothesis(NamedTuple):
    """A fault whose numbers (k,) are to be estimated."""

    starts: Array
    """(s, k) first estimates; k is 0 for a fault without numbers."""
    correct: Callable[[Reactions, Index, Array], Reactions]
    """The reactions of rows, given with their numbers in the recording, without the fault."""
    fault: Callable[[Array], Fault]
    cost: int = 0
    """How many numbers it takes from the data."""
    limit: float = np.inf
    """Largest magnitude of a number."""


def hypotheses(recording: Recording, model: str, measured: Reactions, stuck: Index) -> list[Hypothesis]:
    """Faults that a recording of the model may have but for those of the sensor's frame.

    measured
        its reactions.
    stuck
        rows that repeat others.
    """
    found = [
        *_signs(model),
        *_zeros(recording, model, measured),
        *_scales(),
        *_gains(model),
    ]
    if len(stuck):
        found.append(_stuck(stuck))
    return found


_NONE = np.empty((1, 0))


def _signs(model: str) -> list[Hypothesis]:
    """Signs, units and exchanged axes."""
    x, y, z = np.eye(3) * -2 + 1
    one = np.ones(3)
    left_handed = "the z axis is reversed, as in a left-handed frame"
    changes = {
        ("wrench-sign", "the wrench has the opposite sign (that of the rod on the clamp)"): (-one, -one),
        ("force-sign", "the forces have the opposite signs"): (-one, one),
        ("fx-sign", "fx has the opposite sign"): (x, one),
        ("fy-sign", "fy has the opposite sign"): (y, one),
        ("mz-sign", "mz has the opposite sign"): (one, z),
        ("moment-unit", "the moment is in N mm, not in N m"): (one, 1e-3 * one),
        ("force-unit", "the forces are in mN, not in N"): (1e-3 * one, one),
    }
    if model == "spatial":
        del changes["moment-unit", "the moment is in N mm, not in N m"]
        changes |= {
            ("fz-sign", "fz has the opposite sign"): (z, one),
            ("mx-sign", "mx has the opposite sign"): (one, x),
            ("left-handed", left_handed): (z, -z),
            ("moment-unit", "the moments are in N mm, not in N m"): (one, 1e-3 * one),
        }
    else:
        changes["fx-mz-sign", "fx and mz have the opposite signs"] = (x, z)

    def scaled(force: Array, moment: Array) -> Callable[[Reactions, Index, Array], Reactions]:
        gain = float(np.abs(force).max()), float(np.abs(moment).max())
        return lambda r, rows, numbers: Reactions(r.force * force, r.moment * moment, r.length, gain)

    def named(code: str, text: str) -> Callable[[Array], Fault]:
        return lambda numbers: Fault(code, None, "", text)

    found = [Hypothesis(_NONE, scaled(*change), named(*name)) for name, change in changes.items()]
    order = [1, 0, 2]
    found.append(
        Hypothesis(
            _NONE,
            lambda r, rows, numbers: Reactions(r.force[:, order], r.moment),
            named("fx-fy-exchanged", "fx and fy are exchanged"),
        )
    )
    return found


def _zeros(recording: Recording, model: str, measured: Reactions) -> list[Hypothesis]:
    """What the sensor shows at the starts of the sweeps, before the rod touches, and that it is not zero."""
    _, first, sweep = np.unique(recording.sweep, return_index=True, return_inverse=True)
    start_force, start_moment = measured.force[first], measured.moment[first]
    force, moment = np.median(start_force, axis=0), np.median(start_moment, axis=0)
    linear = np.polynomial.polynomial.polyfit(first, np.hstack([start_force, start_moment]), min(len(first) - 1, 1))

    value, unit, text = _of_zero(force, moment, recording.rod, model)
    ranges = [np.ptp(np.percentile(values, [2.5, 97.5], axis=0), axis=0) for values in (start_force, start_moment)]
    drift, drift_unit, drift_text = _of_zero(ranges[0], ranges[1], recording.rod, model)

    def untared(numbers: Array) -> Fault:
        return Fault(
            "not-tared",
            value,
            unit,
            f"force and moment were not tared: at the starts of the sweeps the sensor shows {text}; let the import take off "
            "what it shows in the air ([tare])",
        )

    def drifts(numbers: Array) -> Fault:
        return Fault(
            "drift",
            drift,
            drift_unit,
            f"the zero of force and moment drifts from sweep to sweep, in all by {drift_text}: let each sweep begin in the "
            "air, and let the import take off the drift ([tare])",
        )

    def steady(r: Reactions, rows: Index, numbers: Array) -> Reactions:
        zero = np.vander(rows, len(linear), increasing=True) @ linear
        return Reactions(r.force - zero[:, :3], r.moment - zero[:, 3:])

    def by_sweep(r: Reactions, rows: Index, numbers: Array) -> Reactions:
        return Reactions(r.force - start_force[sweep[rows]], r.moment - start_moment[sweep[rows]])

    return [
        Hypothesis(_NONE, lambda r, rows, numbers: Reactions(r.force - force, r.moment - moment), untared),
        Hypothesis(_NONE, steady, drifts, 2),
        Hypothesis(_NONE, by_sweep, drifts, 2),
    ]


def _of_zero(force: Array, moment: Array, rod: Rod, model: str) -> tuple[float, str, str]:
    """The size of a zero (3,), (3,) that is off, its unit, and its components in words."""
    shown, about = (slice(0, 3), slice(0, 3)) if model == "spatial" else (slice(0, 2), slice(2, 3))
    newton, newton_metres = force * rod.force_unit_N, moment * rod.moment_unit_Nm
    forces, moments = (
        ", ".join(f"{value + 0.0:.2g}" for value in values) for values in (newton[shown], newton_metres[about])
    )
    text = f"({forces}) N and ({moments}) N m"
    if np.linalg.norm(moment) > np.linalg.norm(force):
        return float(np.linalg.norm(newton_metres)), "N m", text
    return float(np.linalg.norm(newton)), "N", text


def _scales() -> list[Hypothesis]:
    """Wrong stiffness, gain and length, as logarithms of factors by which the reactions or the length are multiplied."""
    starts, lengths = np.log(_SCALES)[:, None], np.log(_LENGTHS)[:, None]

    def stiffness(numbers: Array) -> Fault:
        factor = float(np.exp(-numbers[0]))
        return Fault(
            "stiffness",
            factor,
            "times",
            f"the rod is {factor:.3g} times as stiff as stated, or force and moment are recorded {factor:.3g} times too large "
            "(both have the same effect): calibrate the stiffness",
        )

    def moment(numbers: Array) -> Fault:
        factor = float(np.exp(-numbers[0]))
        return Fault(
            "moment-scale",
            factor,
            "times",
            f"the moments are recorded {factor:.3g} times too large: check the sensor's gains",
        )

    def force(numbers: Array) -> Fault:
        factor = float(np.exp(-numbers[0]))
        return Fault(
            "force-scale",
            factor,
            "times",
            f"the forces are recorded {factor:.3g} times too large: check the sensor's gains",
        )

    def length(numbers: Array) -> Fault:
        factor = float(np.exp(numbers[0]))
        return Fault(
            "length", factor, "times", f"the rod is {factor:.3g} times as long as stated: measure its free length"
        )

    return [
        Hypothesis(
            starts,
            lambda r, rows, n: Reactions(r.force * np.exp(n[0]), r.moment * np.exp(n[0]), r.length),
            stiffness,
            1,
            _LARGEST_SCALE,
        ),
        Hypothesis(
            starts, lambda r, rows, n: Reactions(r.force, r.moment * np.exp(n[0]), r.length), moment, 1, _LARGEST_SCALE
        ),
        Hypothesis(
            starts, lambda r, rows, n: Reactions(r.force * np.exp(n[0]), r.moment, r.length), force, 1, _LARGEST_SCALE
        ),
        Hypothesis(
            lengths, lambda r, rows, n: Reactions(r.force, r.moment, float(np.exp(n[0]))), length, 1, _LARGEST_SCALE
        ),
    ]


def _gains(model: str) -> list[Hypothesis]:
    """Single channels with a wrong gain, as logarithms of factors."""
    starts = np.log(_SCALES)[:, None]

    def of_channel(name: str, part: int, axis: int) -> Hypothesis:
        def correct(r: Reactions, rows: Index, numbers: Array) -> Reactions:
            factor = np.exp(numbers[0] * np.eye(3)[axis])
            return Reactions(r.force * factor, r.moment) if part == 0 else Reactions(r.force, r.moment * factor)

        def fault(numbers: Array) -> Fault:
            factor = float(np.exp(-numbers[0]))
            message = f"{name} is recorded {factor:.3g} times too large: check the sensor's gains"
            return Fault(f"{name}-scale", factor, "times", message)

        return Hypothesis(starts, correct, fault, 1, _LARGEST_SCALE)

    channels = [("fx", 0, 0), ("fy", 0, 1)]
    if model == "spatial":
        channels += [("fz", 0, 2), ("mx", 1, 0), ("mz", 1, 2)]
    return [of_channel(*channel) for channel in channels]


def _stuck(stuck: Index) -> Hypothesis:
    def without(r: Reactions, rows: Index, numbers: Array) -> Reactions:
        free = ~np.isin(rows, stuck)[:, None]
        return Reactions(r.force * free, r.moment * free)

    count = len(stuck)
    return Hypothesis(
        _NONE,
        without,
        lambda numbers: Fault(
            "stick",
            float(count),
            "rows",
            f"sensor or log was stuck: in {count} rows force and moment repeat those of the row before though the clamp moves; "
            "leave these rows out",
        ),
    )
