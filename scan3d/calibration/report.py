"""What a calibration has found: quantities with their uncertainties, what touches determine poorly, and corrected recordings.

Where the model holds, the four white misclosures of a row have the variance 1 each, and those of successive rows are as
independent as the noise.  Scatter beyond that enlarges all uncertainties: by its mean square (the Birge ratio), and by the
number of rows over which it is alike (the integrated autocorrelation).  Where it is more than noise could be, the model does
not fit: deviations with the sum of squares S may then be alike in all rows, and shift a parameter by no more than √S of its
standard deviations (the Cauchy-Schwarz inequality).
"""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any, Literal, NamedTuple

import numpy as np

from scan3d.arrays import Array, Mask
from scan3d.calibration.fit import Fit, calibrated, degrees_of_freedom, six_channels
from scan3d.calibration.model import PLACE, TURN, Kind, Plane, Rig, Sphere
from scan3d.calibration.rows import unloaded
from scan3d.errors import InputError
from scan3d.frames import Frame, euler_of, to_outer, turn_of
from scan3d.recording import Recording
from scan3d.rigs import RIG_QUANTITIES, RigUncertainty
from scan3d.rods import Rod
from scan3d.shown import Described, Rows

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
# Expanded uncertainties up to which a quantity counts as well determined, by the ending of its name: relative for the
# stiffness, relative to the rod's length for lengths, and for the tare in standard deviations of the noise of a row.
_WELL = {"stiffness": 0.01, "length": 0.005, "degrees": 0.3, "tare": 1.0}
# Step of difference quotients, and the part of the largest derivative of a quantity that is their rounding.
_STEP, _ROUNDING = 1e-5, 1e-7
# Estimated noise of the poses, in rod lengths, that is larger than that of robots, and the variance beyond 1 of the
# misclosures of an equation with which the model does not fit.
_ROUGH, _SPOILED = 1e-3, 0.3
# Standard deviations of a mean square, and of a mean product of neighbours, that count as chance.
_SIGMAS, _CHANCE = 4.0, 4.5
# Lags in rows whose mean product tells deviations that are alike, and those up to which these are followed.
_NEAR, _FARTHEST = 3, 200
# Part of the deviations that one cause must explain to be named alone, and the scatter of the reactions across their plane,
# in standard deviations of the noise, up to which they lie in a plane.
_EXPLAINS, _FLAT = 0.1, 1.5


@dataclass(frozen=True, repr=False)
class Calibration(Described):
    """A rig with its uncertainties, from `scan3d.calibrate` or from a file."""

    rod: Rod
    """With the free length and the bending stiffness that were found."""
    sensor_position_m: Array
    """(3,) origin of the sensor's frame in the clamp's."""
    sensor_euler_deg: Array
    """(3,) its turn."""
    clamp_position_m: Array
    """(3,) the clamp in the frame of the recorded poses."""
    clamp_euler_deg: Array
    """(3,) its turn; that about the rod's axis is zero, because the sensor's turn contains it."""
    tare: Array
    """(6,) what the sensor shows in the air, in the middle of the recording; N and N·m."""
    drift: Array
    """(6,) its change over the recording."""
    names: tuple[str, ...]
    """The quantities, with their units."""
    values: Array
    """(k,)"""
    standard_deviations: Array
    """(k,) infinite for quantities that were not determined and stay at their nominal values."""
    covariance: Array
    """(k, k) zero for those."""
    well: tuple[bool, ...]
    """(k,) whether a quantity is well determined."""
    sentences: tuple[str, ...]
    """What is poorly determined, and which touches would determine it; and premises that the data contradict."""
    chi2: float
    """Sum of squares of the misclosures in contact over their variances per degree of freedom, 1 on average; with an
    estimated noise of the poses it is 1 by construction."""
    consistency: float
    """The same of the two equations that only the wrench is in."""
    freedom: int
    pose_noise_m: float
    noise_force_N: float
    noise_moment_Nm: float
    reference: Mapping[str, Any] = field(default_factory=dict)
    """What was touched, and where it was: `kind`, ``sphere`` or ``plane``, and

    of a sphere `diameter_mm` and `position_mm`, of its centre in the world;
    of a plane `normal`, outward, and `offset_mm`, its distance from the world's origin along the normal."""
    details: Mapping[str, Any] = field(default_factory=dict)
    """Numbers of rows, and how the tare was modelled."""
    map_frames: Mapping[str, Any] = field(default_factory=dict)
    """The sections `sensor` and `clamp` of the map with which the touches were imported: `scan3d.import_table` needs them."""

    def summary(self) -> Rows:
        """What was touched, the rod, the frames, and how well all is known."""
        rod, well = self.rod, sum(self.well)
        length, stiffness = f"{1e3 * rod.length_m:.5g} mm long", f"EI = {rod.bending_stiffness_Nm2:.5g} N m²"
        return [
            ("reference", ", ".join(f"{name} {_short(value)}" for name, value in self.reference.items())),
            ("rod", f"{length}, {stiffness}"),
            ("sensor", f"at {_short(1e3 * self.sensor_position_m)} mm, turned by {_short(self.sensor_euler_deg)}°"),
            ("clamp", f"at {_short(1e3 * self.clamp_position_m)} mm, turned by {_short(self.clamp_euler_deg)}°"),
            ("well determined", f"{well} of {len(self.well)} quantities"),
            ("fit", f"chi² {self.chi2:.3g}, consistency {self.consistency:.3g}, {self.freedom} degrees of freedom"),
            ("remarks", " ".join(self.sentences) or "none"),
        ]

    @property
    def expanded(self) -> Array:
        """(k,) expanded uncertainties, with the coverage factor 2."""
        return COVERAGE_FACTOR * self.standard_deviations

    @property
    def sphere_m(self) -> Array:
        """(3,) centre of the reference sphere in the world; NaN for a plane."""
        return np.array(self.reference.get("position_mm", [np.nan] * 3)) / 1000

    @property
    def diameter_m(self) -> float:
        """Diameter of the reference sphere; NaN for a plane."""
        return float(self.reference.get("diameter_mm", np.nan)) / 1000

    def frames(self) -> tuple[Frame, Frame]:
        """The sensor's frame in the clamp's, and the clamp's in that of the recorded poses."""
        return (
            Frame.of(self.sensor_position_m, self.sensor_euler_deg),
            Frame.of(self.clamp_position_m, self.clamp_euler_deg),
        )

    def applied(self, recording: Recording, tare: str = "auto") -> Recording:
        """A recording of this rig, as `calibrate` takes it, with poses and reactions of the true clamp, and the true rod.

        The tare is found in its own rows in the air; `tare` as in `calibrate`, or ``calibration`` for that of the calibration.
        Raises InputError if there are too few rows in the air.
        """
        six, known = recording.six_axis, recording.noise
        channels, wrench = six_channels(recording)
        if tare == "calibration":
            wrench = wrench - self.tare
            force_noise, moment_noise = known.force_N, known.moment_Nm
        else:
            air = unloaded(recording.sweep, wrench, channels, (known.force_N, known.moment_Nm), tare)
            wrench = wrench - air.basis @ air.tare.T
            force_noise, moment_noise = air.force_noise, air.moment_noise
        sensor, clamp = self.frames()
        force, moment = to_outer(wrench[:, :3], wrench[:, 3:], sensor.turn, sensor.position_m)
        position, quaternion = clamp.carried(recording.position_m, recording.quaternion)
        # the mean over the components of the variance that the lever adds
        lever = float(self.sensor_position_m @ self.sensor_position_m) * 2 / 3
        return dataclasses.replace(
            recording,
            position_m=position,
            quaternion=quaternion,
            force_N=force[:, :2],
            moment_Nm=moment[:, 2],
            force_z_N=force[:, 2] if six else None,
            moment_x_Nm=moment[:, 0] if six else None,
            moment_y_Nm=moment[:, 1] if six else None,
            rod=self.rod,
            noise_force_N=force_noise,
            noise_moment_Nm=float(np.sqrt(moment_noise**2 + lever * force_noise**2)),
            noise_pose_m=recording.noise_pose_m or self.pose_noise_m,
            source={**recording.source, "calibrated": True},
            rig=self.uncertainty(),
        )

    def uncertainty(self) -> RigUncertainty:
        """The covariance of the errors that remain in a recording that this corrects, to the first order.

        Tare and drift are left out, because an import finds them again, and so is the place of the reference.  Quantities
        without an uncertainty stay at nominal values, which are taken as exact; a rig by hand states none.
        """
        chosen = [k for k, name in enumerate(self.names) if name in OF_CONTACTS]
        known = [k for k in chosen if np.isfinite(self.standard_deviations[k])]
        exact = tuple(self.names[k] for k in chosen if k not in known) if chosen else OF_CONTACTS
        slopes = np.array([self._error(self.names[k]) for k in known]).reshape(-1, len(RIG_QUANTITIES)).T
        covariance = slopes @ self.covariance[np.ix_(known, known)] @ slopes.T
        uncertain = np.flatnonzero(np.diag(covariance) > 0)
        covariance = covariance[np.ix_(uncertain, uncertain)]
        return RigUncertainty(tuple(RIG_QUANTITIES[k] for k in uncertain), (covariance + covariance.T) / 2, exact)

    def _error(self, name: str) -> Array:
        """(14,) what an error of one unit of a quantity is in `RIG_QUANTITIES`, to the first order."""
        error = dict.fromkeys(RIG_QUANTITIES, 0.0)
        part, _, axis = name.rpartition("_")[0].rpartition("_")
        to_clamp = turn_of(self.clamp_euler_deg).T
        if name == "bending_stiffness_Nm2":
            error["stiffness_relative"] = 1 / self.rod.bending_stiffness_Nm2
        elif name == "length_m":
            error["length_relative"] = 1 / self.rod.length_m
        elif name.endswith("_mm"):
            moved = to_clamp[:, "xyz".index(axis)] / 1000 if part == "clamp" else np.eye(3)["xyz".index(axis)] / 1000
            error |= {f"{part}_{to}_m": value for to, value in zip("xyz", moved, strict=True)}
        else:
            euler = self.clamp_euler_deg if part == "clamp_turn" else self.sensor_euler_deg
            turned = np.radians(_euler_axes(euler)[:, "xyz".index(axis)])
            if part == "clamp_turn":
                turned = to_clamp @ turned
            else:  # a turn about the sensor's origin is one about the clamp's, and moves the sensor
                moved = np.cross(self.sensor_position_m, turned)
                error |= {f"sensor_{to}_m": value for to, value in zip("xyz", moved, strict=True)}
            error |= {f"{part}_{to}_rad": value for to, value in zip("xyz", turned, strict=True)}
        return np.array(list(error.values()))


def _euler_axes(euler_deg: Array) -> Array:
    """(3, 3) the axes, as columns and in the outer frame, about which the three Euler angles turn."""
    _, y, z = euler_deg
    return np.column_stack([turn_of([0, y, z])[:, 0], turn_of([0, 0, z])[:, 1], [0.0, 0.0, 1.0]])


def _short(value: Any) -> str:
    """A number, numbers or text of a table."""
    if isinstance(value, str):
        return value
    text = ", ".join(f"{number:.4g}" for number in np.ravel(value))
    return f"({text})" if np.ndim(value) else text


def calibrate(
    recording: Recording,
    reference: float | Literal["plane"] | None = None,
    *,
    sphere: float | None = None,
    tare: str = "auto",
    pose_noise_m: float | None = None,
) -> Calibration:
    """The rig that has touched a reference, which was at a place and in a pose that need not be known.

    reference
        the diameter of a sphere in m, or ``"plane"``.
    sphere
        the diameter of a sphere, in the place of `reference`.
    tare
        what the sensor shows in the air: ``constant``, ``linear`` (drifts steadily over the recording), ``sweep`` (a value
        for each sweep), or ``auto``: linear if the rows in the air allow it, else sweep.
    pose_noise_m
        standard deviation of each coordinate of the recorded clamps; None takes the recording's, or estimates it.

    The recording has six axes, or three for a rod in a plane past a sphere, and the nominal rod; reactions are those of the
    sensor, neither tared nor turned.  Raises InputError for impossible arguments and for touches that do not determine the rig.
    """
    if reference is not None and sphere is not None:
        raise InputError("give either a reference or the diameter of a sphere")
    fit = calibrated(recording, sphere if reference is None else reference, tare, pose_noise_m)
    nominal, rig, noise, air = recording.rod, fit.rig, fit.noise, fit.problem.air
    estimated = pose_noise_m is None and not recording.noise_pose_m
    found = _values(fit, rig, nominal)
    names, values = tuple(found), np.array(list(found.values()))
    jacobian = _slopes(fit, nominal, names)
    checked = _checked(fit, recording, estimated)
    known = _known(fit, names, jacobian)
    covariance = jacobian @ checked.covariance @ jacobian.T
    covariance[~known] = covariance[:, ~known] = 0
    deviations = np.where(known, np.sqrt(np.maximum(np.diag(covariance), 0)), np.inf)
    limits = np.array([_limit(name, value, nominal, fit) for name, value in found.items()])
    well = COVERAGE_FACTOR * deviations <= limits
    if checked.spoiled:
        well &= [name.startswith(("tare", "drift")) for name in names]
    tare_of = rig.tare * np.repeat([nominal.force_unit_N, nominal.moment_unit_Nm], 3)[:, None]
    return Calibration(
        rod=Rod(nominal.length_m * rig.length, found["bending_stiffness_Nm2"], nominal.diameter_m),
        sensor_position_m=nominal.length_m * rig.sensor,
        sensor_euler_deg=euler_of(rig.turn),
        clamp_position_m=nominal.length_m * rig.clamp,
        clamp_euler_deg=np.degrees([rig.tilt[0], 0.0, rig.tilt[1]]),
        tare=tare_of.mean(axis=1) if air.model == "sweep" else tare_of[:, 0],
        drift=tare_of[:, 1] if air.model == "linear" else np.ptp(tare_of, axis=1),
        names=names,
        values=values,
        standard_deviations=deviations,
        covariance=covariance,
        well=tuple(map(bool, well)),
        sentences=_lacking(fit, names, deviations, limits, checked.spoiled) + checked.sentences,
        chi2=checked.chi2,
        consistency=checked.consistency,
        freedom=degrees_of_freedom(fit),
        pose_noise_m=nominal.length_m * noise.place,
        noise_force_N=nominal.force_unit_N * noise.force,
        noise_moment_Nm=nominal.moment_unit_Nm * noise.moment,
        reference=_reference(rig, found),
        details={
            "contacts": len(fit.problem.numbers),
            "tip_contacts": int((fit.problem.touches.kind == Kind.TIP).sum()),
            "air": int(air.air.sum()),
            "tare": air.model,
            "pose_noise": "estimated" if estimated else "given",
        },
        map_frames=_map_frames(recording),
    )


def _reference(rig: Rig, found: Mapping[str, float]) -> dict[str, Any]:
    """What was touched, and where it was."""
    if isinstance(rig.reference, Sphere):
        position = [float(found[f"sphere_{axis}_mm"]) for axis in "xyz"]
        return {"kind": "sphere", "diameter_mm": 1000 * rig.reference.diameter_m, "position_mm": position}
    normal = [float(found[f"plane_normal_{axis}"]) for axis in "xyz"]
    return {"kind": "plane", "normal": normal, "offset_mm": float(found["plane_offset_mm"])}


def _map_frames(recording: Recording) -> dict[str, Any]:
    """The frames of the map with which a recording was imported."""
    map = recording.source.get("map", {})
    return {
        title: {key: map[title][key] for key in ("position_mm", "euler_deg") if key in map[title]}
        for title in ("sensor", "clamp")
        if title in map
    }


def _values(fit: Fit, rig: Rig, nominal: Rod) -> dict[str, float]:
    """The quantities of a rig in their units; a rod in a plane has fewer."""
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
        centre = mm * problem.world.T @ rig.reference.centre
        found |= {f"sphere_{axis}_mm": value for axis, value in zip("xyz", centre, strict=True)}
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


def _slopes(fit: Fit, nominal: Rod, names: tuple[str, ...]) -> Array:
    """(q, p) derivatives of the quantities by the parameters."""
    columns = []
    for step in _STEP * np.eye(len(fit.problem.free)):
        ahead, behind = (np.array(list(_values(fit, fit.rig.moved(s), nominal).values())) for s in (step, -step))
        columns.append((ahead - behind) / (2 * _STEP))
    slopes = np.column_stack(columns)
    half_turn = 180 / _STEP
    angles = [name.endswith("_deg") for name in names]
    slopes[angles] = (slopes[angles] + half_turn / 2) % half_turn - half_turn / 2
    slopes[np.abs(slopes) < _ROUNDING * np.abs(slopes).max(axis=1, keepdims=True)] = 0
    return slopes


def _known(fit: Fit, names: tuple[str, ...], slopes: Array) -> Mask:
    """Which quantities (q,) the touches determine."""
    free = fit.problem.free.copy()
    free[PLACE + 2] = (
        True  # a sphere whose distance from the plane of its sweeps is not determined is known in the plane
    )
    known = ~(slopes[:, ~free] != 0).any(axis=1)
    if fit.problem.channels.all() and not free[TURN + 1]:  # the sensor's place across the rod turns with it
        known &= [name not in ("sensor_x_mm", "sensor_z_mm") for name in names]
    return np.asarray(known)


def _limit(name: str, value: float, nominal: Rod, fit: Fit) -> float:
    """The expanded uncertainty up to which a quantity is well determined."""
    if name.startswith("bending"):
        return _WELL["stiffness"] * abs(value)
    if name.startswith(("tare", "drift")):
        force = name.endswith("_N")
        unit, noise = (nominal.force_unit_N, fit.noise.force) if force else (nominal.moment_unit_Nm, fit.noise.moment)
        return _WELL["tare"] * unit * noise
    if name.startswith("plane_normal"):
        return float(np.radians(_WELL["degrees"]))
    if name.endswith("_deg"):
        return _WELL["degrees"]
    return _WELL["length"] * nominal.length_m * (1000 if name.endswith("_mm") else 1)


class _Checked(NamedTuple):
    """The covariance of the parameters, and what the tests of the premises say."""

    covariance: Array
    """(p, p)"""
    chi2: float
    consistency: float
    sentences: tuple[str, ...]
    spoiled: bool
    """Whether the model fits so badly that no quantity of the rig counts as well determined."""


def _checked(fit: Fit, recording: Recording, estimated: bool) -> _Checked:
    """Test the premises of a fit, and enlarge the uncertainties by what contradicts them."""
    noise, kind, used = fit.noise, fit.problem.kind, fit.used
    square = fit.white**2
    total = float(square.sum())
    chi2 = total / degrees_of_freedom(fit)
    both = used[:, :2].all(axis=1)
    consistency = float(square[both, :2].mean()) if both.any() else 1.0
    stated = recording.noise_force_N > 0 and recording.noise_moment_Nm > 0
    air = fit.problem.air
    tests = (
        # the noise is not stated where it is that of the same rows
        (air.misfit, int(air.air.sum()) * 6, stated, _IN_THE_AIR),
        (consistency, 2 * int(both.sum()), True, _IN_CONTACT),
        (chi2, int(used.sum()), not estimated, _OFF_REFERENCE),
    )
    contradicted = [
        (ratio, sentence)
        for ratio, count, applies, sentence in tests
        if applies and ratio > 1 + _SIGMAS * np.sqrt(2 / max(count, 1))
    ]
    sentences = [sentence.format(factor=ratio**0.5, kind=kind, check=_CHECK[kind]) for ratio, sentence in contradicted]
    birge = max([1.0] + [ratio for ratio, sentence in contradicted if sentence is not _IN_THE_AIR])
    rough = estimated and noise.place > _ROUGH
    if rough:
        off = 1000 * noise.place * recording.rod.length_m
        sentences.insert(0, _ROUGH_POSES.format(off=off, kind=kind, check=_CHECK[kind]))
    wrench, contact = (_alike(fit, group) for group in (slice(0, 2), slice(2, 4)))
    excess = [_excess(square[used[:, equation], equation]) for equation in range(4)]
    deviates = max(wrench, contact) > 1 or max(excess) > 0
    spoiled = deviates and (rough or max(excess) > _SPOILED or _in_plane(fit))
    covariance = _inverse(fit)
    if deviates:
        of_contact = contact > 1 or max(excess[2:]) > 0
        cause = _cause(fit, covariance, recording) if of_contact else ""
        sentence = _CONTACTS_DEVIATE if of_contact else _WRENCHES_DEVIATE
        sentences.append(sentence.format(kind=kind, so=_SPOILS if spoiled else _ENLARGES, cause=cause))
    enlarged = total if spoiled else birge * max(wrench, contact)
    return _Checked(enlarged * covariance, chi2, consistency, tuple(sentences), spoiled)


def _inverse(fit: Fit) -> Array:
    """(p, p) inverse of the normal matrix, zero for parameters that are not sought."""
    free = np.flatnonzero(fit.problem.free)
    inner = fit.normal[np.ix_(free, free)]
    scale = 1 / np.sqrt(np.diag(inner))
    result = np.zeros_like(fit.normal)
    result[np.ix_(free, free)] = np.linalg.inv(inner * scale[:, None] * scale) * scale[:, None] * scale
    return result


def _excess(square: Array) -> float:
    """By how much the mean of squares of normal numbers (n,) is above 1, and 0 where that may be chance."""
    if len(square) < 2:
        return 0.0
    above = float(square.mean()) - 1
    return above if above > _CHANCE * float(square.std()) / np.sqrt(len(square)) else 0.0


def _alike(fit: Fit, group: slice) -> float:
    """Over how many rows the white misclosures of a group of equations are alike: 1 for those of white noise."""
    white, used = fit.white[:, group], fit.used[:, group]
    numbers, sweep = fit.problem.numbers, fit.problem.touches.sweep
    rows = 1.0
    first, pairs_of_first = 0.0, 0
    for lag in range(1, _FARTHEST):
        there = np.minimum(np.searchsorted(numbers, numbers + lag), len(numbers) - 1)
        here = np.flatnonzero((numbers[there] == numbers + lag) & (sweep[there] == sweep))
        both = used[here] & used[there[here]]
        products, pairs = float((white[here] * white[there[here]])[both].sum()), int(both.sum())
        if not pairs:
            break
        if lag <= _NEAR:
            first, pairs_of_first = first + products, pairs_of_first + pairs
        elif first < _CHANCE * np.sqrt(pairs_of_first) or products < 2 * np.sqrt(pairs):
            break
        rows += 2 * products / pairs
    return rows if first >= _CHANCE * np.sqrt(max(pairs_of_first, 1)) else 1.0


def _cause(fit: Fit, inverse: Array, recording: Recording) -> str:
    """The likeliest cause of contacts that deviate from the reference."""
    reference, rod = fit.rig.reference, recording.rod
    if isinstance(reference, Sphere):
        by_radius = np.where(fit.used, -fit.factor[:, :, 2], 0.0)
        by_rig = fit.jacobian[: by_radius.size]
        left = by_radius.ravel() - by_rig @ (inverse @ (by_rig.T @ by_radius.ravel()))
        information, slope = float(left @ by_radius.ravel()), float(left @ fit.white.ravel())
        if information > 0 and slope**2 / information > _EXPLAINS * float((fit.white**2).sum()):
            diameter = 2 * rod.length_m * (reference.radius - slope / information) - rod.diameter_m
            return f"The likeliest cause is the diameter: one of {1000 * diameter:.4g} mm would fit better."
    return _PLANAR.format(kind=reference.kind) if _in_plane(fit) else _SHAPE.format(unlike=reference.unlike)


def _in_plane(fit: Fit) -> bool:
    """Whether all of the six-axis forces lie in one plane of the sensor, as in a planar model."""
    touches = fit.problem.touches
    tared = (touches.wrench - touches.basis @ fit.rig.tare.T)[:, :3]
    scatter = float(np.linalg.svd(tared, compute_uv=False)[-1]) / np.sqrt(len(tared))
    return bool(fit.problem.channels.all()) and scatter < _FLAT * fit.noise.force


def _lacking(fit: Fit, names: tuple[str, ...], deviations: Array, limits: Array, spoiled: bool) -> tuple[str, ...]:
    """What touches determine poorly or not at all, by groups; where the model does not fit, other touches are no remedy."""
    noun, sentences = fit.problem.kind, []
    poor: dict[str, list[str]] = {}
    fixed: dict[str, list[str]] = {}
    for name, deviation, limit in zip(names, deviations, limits, strict=True):
        group = max((group for group in _TOUCHES if name.startswith(group)), key=len)
        if np.isinf(deviation):
            fixed.setdefault(group, []).append(name)
        elif not spoiled and COVERAGE_FACTOR * deviation > limit:
            poor.setdefault(group, []).append(f"{name} to {COVERAGE_FACTOR * deviation:.2g}")
    if "sensor_turn" in fixed:
        lost = ", ".join(fixed.pop("sensor_turn") + fixed.pop("sensor", []))
        sentences.append(_ABOUT_THE_ROD.format(names=lost, noun=noun))
    for group, members in fixed.items():
        title, touches = _TOUCHES[group]
        stay = "are estimates" if group == noun else "stay" + "s" * (len(members) == 1) + " at the nominal value"
        sentences.append(
            f"These touches do not determine {title}: {', '.join(members)} {stay}. It needs {_needed(touches, noun)}."
        )
    for group, members in poor.items():
        title, touches = _TOUCHES[group]
        listed = ", ".join(members)
        sentences.append(f"These touches determine {title} poorly ({listed}). It needs {_needed(touches, noun)}.")
    if noun == "sphere" and not fit.problem.free[PLACE + 2]:
        sentences.append(
            "The sweeps lie in one plane, which is taken to pass through the sphere's centre; sweep planes at several heights."
        )
    return tuple(sentences)


def _needed(touches: str | Mapping[str, str], noun: str) -> str:
    return (touches if isinstance(touches, str) else touches[noun]).format(noun=noun)


# The groups of quantities by the beginnings of their names, what they are called, and the touches that determine them.
_TOUCHES: dict[str, tuple[str, str | Mapping[str, str]]] = {
    "bending_stiffness": (
        "the bending stiffness",
        {
            "sphere": "sweeps that bend the rod more, past the middle of the sphere",
            "plane": "sweeps that press the rod on until it lies along the plane",
        },
    ),
    "length": (
        "the free length",
        {
            "sphere": "tip contacts: sweeps whose clamp is farther from the sphere, so that the rod leaves it over its tip",
            "plane": "tip contacts: sweeps that press the rod less, so that its tip slides on the plane",
        },
    ),
    "clamp_turn": (
        "the clamp's turn",
        "sweeps that touch the {noun} near the clamp and near the tip, with the clamp turned about the rod's axis",
    ),
    "clamp_y": (
        "the clamp's offset along the rod",
        {
            "sphere": "sweeps with the rod in other directions, such as from the opposite side",
            "plane": "sweeps with the rod at several inclinations to the plane",
        },
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
_CHECK = {"sphere": "the diameters of sphere and rod", "plane": "the flatness of the plane"}
_ROUGH_POSES = (
    "The contacts deviate from the {kind} as if the poses scattered by {off:.2g} mm, which is more than those of a robot do: "
    "check {check}, and that the {kind} did not move."
)
_IN_THE_AIR = (
    "In the air the reactions scatter by {factor:.2f} times the stated noise: the sensor drifts otherwise than the tare "
    "assumes, or the noise is larger than stated; what is found in the air was used instead."
)
_IN_CONTACT = (
    "In contact the moments about the rod and along the force scatter by {factor:.2f} times what the noise explains: a second "
    "contact, friction across a thick rod, a sensor whose channels mix, or noise larger than stated."
)
_OFF_REFERENCE = (
    "The contacts deviate from the {kind} by {factor:.2f} times what the noise explains: check {check}, the noise of the "
    "poses, and that the {kind} did not move."
)
_CONTACTS_DEVIATE = (
    "The contacts deviate from the {kind}, or the rod from its tangent, by more than noise explains, or alike in neighbouring "
    "rows: {so}. {cause}"
)
_WRENCHES_DEVIATE = (
    "In contact the moments about the rod and along the force deviate from zero by more than noise explains, or alike in "
    "neighbouring rows: {so}. The likeliest causes are noise of the sensor that is alike in neighbouring rows, friction "
    "across a thick rod, a second contact, a sensor whose channels mix, and a tare that changes within a sweep."
)
_ENLARGES = "the uncertainties are enlarged by them"
_SPOILS = (
    "the model does not fit these touches, no quantity of the rig is called well determined, and the uncertainties are those "
    "of deviations that are alike in all rows"
)
_PLANAR = (
    "The likeliest cause is a log whose forces lie in one plane, of a planar model or of a sensor with three channels; a rod "
    "that slides sideways over a {kind} has none such."
)
_SHAPE = (
    "The likeliest causes are {unlike}, a second contact, a rod that sticks, poses that deviate from the clamp's path, and "
    "noise of the sensor that is alike in neighbouring rows."
)
