"""The quantities of a rig in their units, and which of them touches determine: not at all, poorly or well."""

from __future__ import annotations

import numpy as np

from scan3d.arrays import Array, Mask
from scan3d.calibration.fit import Fit
from scan3d.calibration.model import PLACE, TURN, Rig
from scan3d.calibration.references import Plane
from scan3d.frames import euler_of
from scan3d.rods import Rod

COVERAGE_FACTOR = 2.0
"""Of expanded uncertainties: about 95 % of the errors of a normal distribution."""
CHANNELS = ("fx_N", "fy_N", "fz_N", "mx_Nm", "my_Nm", "mz_Nm")
OF_CONTACTS = (
    "bending_stiffness_Nm2",
    "length_m",
    *(f"clamp_{axis}_mm" for axis in "xyz"),
    *(f"clamp_turn_{axis}_deg" for axis in "xz"),
    *(f"sensor_{axis}_mm" for axis in "xyz"),
    *(f"sensor_turn_{axis}_deg" for axis in "xyz"),
)
"""The quantities of a calibration that change contacts."""
# Expanded uncertainties up to which a quantity counts as well determined: relative for the stiffness, relative to the rod's
# length for lengths, in degrees, and for the tare in standard deviations of the noise of a row.
_STIFFNESS, _LENGTH, _DEGREES, _NOISE = 0.01, 0.005, 0.3, 1.0
# Step of difference quotients, and the part of the largest derivative of a quantity that is their rounding.
_STEP, _ROUNDING = 1e-5, 1e-7


def quantities(fit: Fit, rig: Rig, nominal: Rod) -> dict[str, float]:
    """The quantities of a rig, which may be another one than that of the fit; a rod in a plane has fewer."""
    mm, problem = 1000 * nominal.length_m, fit.problem
    found = {
        "bending_stiffness_Nm2": nominal.bending_stiffness_Nm2 * float(np.exp(rig.stiffness)),
        "length_m": nominal.length_m * rig.length,
    }
    turns = (("clamp_turn", "xz", np.degrees(rig.tilt)), ("sensor_turn", "xyz", euler_of(rig.turn)))
    for part, place, (title, axes, angles) in zip(("clamp", "sensor"), (rig.clamp, rig.sensor), turns, strict=True):
        found |= {f"{part}_{axis}_mm": mm * value for axis, value in zip("xyz", place, strict=True)}
        found |= {f"{title}_{axis}_deg": value for axis, value in zip(axes, angles, strict=True)}
    if isinstance(rig.reference, Plane):
        normal = rig.reference.axes[:, 2]
        found |= {f"plane_normal_{axis}": value for axis, value in zip("xyz", normal, strict=True)}
        found["plane_offset_mm"] = mm * float(normal @ rig.reference.origin)
    else:
        found |= {f"sphere_{axis}_mm": mm * value for axis, value in zip("xyz", rig.reference.origin, strict=True)}
    units = np.repeat([nominal.force_unit_N, nominal.moment_unit_Nm], 3)
    for name, unit, measured, tare in zip(CHANNELS, units, problem.channels, rig.tare, strict=True):
        if measured and problem.air.model == "sweep":
            found[f"tare_{name}"] = unit * tare.mean()
        elif measured:
            found |= {f"{title}_{name}": unit * value for title, value in zip(("tare", "drift"), tare, strict=False)}
    if not problem.channels.all():
        for name in ("clamp_turn_x_deg", "sensor_z_mm", "sensor_turn_x_deg", "sensor_turn_y_deg"):
            del found[name]
    return {name: float(value) for name, value in found.items()}


def derivatives(fit: Fit, nominal: Rod, names: tuple[str, ...]) -> tuple[Array, Mask]:
    """(q, p) derivatives of the quantities by the parameters, and which quantities (q,) the touches determine."""
    columns = []
    for step in _STEP * np.eye(len(fit.problem.free)):
        ahead, behind = (np.array(list(quantities(fit, fit.rig.moved(s), nominal).values())) for s in (step, -step))
        columns.append((ahead - behind) / (2 * _STEP))
    slopes = np.column_stack(columns)
    angles, half_turn = [name.endswith("_deg") for name in names], 180 / _STEP
    slopes[angles] = (slopes[angles] + half_turn / 2) % half_turn - half_turn / 2
    slopes[np.abs(slopes) < _ROUNDING * np.abs(slopes).max(axis=1, keepdims=True)] = 0
    free = fit.problem.free.copy()
    free[PLACE + 2] = True  # sweeps in a plane do not tell how far the sphere's centre is from it, but where in it
    known = ~(slopes[:, ~free] != 0).any(axis=1)
    if fit.problem.channels.all() and not free[TURN + 1]:  # the sensor's place across the rod turns with it
        known &= [name not in ("sensor_x_mm", "sensor_z_mm") for name in names]
    return slopes, np.asarray(known)


def limit(name: str, value: float, nominal: Rod, fit: Fit) -> float:
    """The expanded uncertainty up to which a quantity is well determined."""
    if name.startswith("bending"):
        return _STIFFNESS * value
    if name.startswith(("tare", "drift")):
        force, moment = nominal.force_unit_N * fit.noise.force, nominal.moment_unit_Nm * fit.noise.moment
        return _NOISE * (force if name.endswith("_N") else moment)
    if name.startswith("plane_normal"):
        return float(np.radians(_DEGREES))
    if name.endswith("_deg"):
        return _DEGREES
    return _LENGTH * nominal.length_m * (1000 if name.endswith("_mm") else 1)


def lacking(fit: Fit, names: tuple[str, ...], deviations: Array, limits: Array, spoiled: bool) -> tuple[str, ...]:
    """What touches determine poorly or not at all, by groups; where the model does not fit, other touches are no remedy."""
    noun, sentences = fit.rig.reference.kind, []
    poor: dict[str, list[str]] = {}
    fixed: dict[str, list[str]] = {}
    for name, deviation, most in zip(names, deviations, limits, strict=True):
        group = max((group for group in _TOUCHES if name.startswith(group)), key=len)
        if np.isinf(deviation):
            fixed.setdefault(group, []).append(name)
        elif not spoiled and COVERAGE_FACTOR * deviation > most:
            poor.setdefault(group, []).append(f"{name} to {COVERAGE_FACTOR * deviation:.2g}")
    if "sensor_turn" in fixed:
        lost = ", ".join(fixed.pop("sensor_turn") + fixed.pop("sensor", []))
        sentences.append(_ABOUT_THE_ROD.format(names=lost, noun=noun))
    for group, members in fixed.items():
        what, touches = _TOUCHES[group]
        stay = "are estimates" if group == noun else "stay" + "s" * (len(members) == 1) + " at the nominal value"
        sentences.append(f"These touches do not determine {what}: {', '.join(members)} {stay}. It needs {touches}.")
    for group, members in poor.items():
        what, touches = _TOUCHES[group]
        sentences.append(f"These touches determine {what} poorly ({', '.join(members)}). It needs {touches}.")
    if noun == "sphere" and not fit.problem.free[PLACE + 2]:
        sentences.append(
            "The sweeps lie in one plane, which is taken to pass through the sphere's centre; sweep planes at several heights."
        )
    return tuple(sentence.format(noun=noun) for sentence in sentences)


# The groups of quantities by the beginnings of their names, what they are called, and the touches that determine them.
_TOUCHES = {
    "bending_stiffness": (
        "the bending stiffness",
        "sweeps that bend the rod more: past the middle of a sphere, or pressed on until it lies along a plane",
    ),
    "length": (
        "the free length",
        "tip contacts: sweeps whose clamp is farther from the {noun}, so that the rod's tip slides over it",
    ),
    "clamp_turn": (
        "the clamp's turn",
        "sweeps that touch the {noun} near the clamp and near the tip, with the clamp turned about the rod's axis",
    ),
    "clamp_y": (
        "the clamp's offset along the rod",
        "sweeps with the rod in other directions, such as from the opposite side of a sphere or more inclined to a plane",
    ),
    "clamp": (
        "the clamp's offset across the rod",
        "sweeps with the clamp turned about the rod's axis by 90 degrees and more",
    ),
    "sensor_turn": ("the sensor's turn", "sweeps that bend the rod more, and a {noun} with more friction"),
    "sensor": ("the sensor's place", "sweeps that bend the rod more, and to several sides of the clamp"),
    "sphere": ("the sphere's place", "sweeps with the rod in more directions"),
    "plane": ("the plane's place", "sweeps with the rod in more directions, and all over the plane"),
    "tare": ("the tare", "more rows in the air, before and after each touch"),
    "drift": ("the drift", "more rows in the air at the beginning and the end of the recording"),
}
_ABOUT_THE_ROD = (
    "These touches do not determine the sensor's turn about the rod: {names} are a first estimate, which may be wrong by some "
    "degrees. It needs a {noun} with more friction, because without friction contacts stay on the {noun} when they turn about "
    "the rod; and sweeps that bend the rod more."
)
