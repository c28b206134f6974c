"""The result of a calibration: quantities with their uncertainties, and recordings corrected by them."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from scan3d.arrays import Array, Mask
from scan3d.frames import Frame, euler_of, to_outer
from scan3d.laboratory import calibration_words as words
from scan3d.laboratory.calibration_air import unloaded
from scan3d.laboratory.calibration_body import Body
from scan3d.laboratory.calibration_checks import Fitted, check
from scan3d.laboratory.calibration_colour import WHITE
from scan3d.laboratory.calibration_model import CENTRE, TURN, Kind
from scan3d.laboratory.calibration_quantities import COVERAGE_FACTOR, limit, measured, quantities
from scan3d.laboratory.calibration_reference import Reference, Spherical
from scan3d.laboratory.calibration_uncertainty import rig_uncertainty
from scan3d.recording import Recording
from scan3d.rods import Rod
from scan3d.shown import Described, Rows

_PLACE, _TURN = ("x_mm", "y_mm", "z_mm"), ("turn_x_deg", "turn_y_deg", "turn_z_deg")


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
    """Sum of squares of the misclosures in contact over their variances per degree of freedom, 1 on average; with an estimated
    noise of the poses it is 1 by construction."""
    consistency: float
    """The same of the two equations that only the wrench is in."""
    freedom: int
    pose_noise_m: float
    noise_force_N: float
    noise_moment_Nm: float
    reference: Mapping[str, Any] = field(default_factory=dict)
    """What was touched, and where it was: `kind`, one of ``sphere``, ``plane`` and ``mesh``, and

    of a sphere `diameter_mm` and `position_mm`, of its centre in the world;
    of a plane `normal`, outward, and `offset_mm`, its distance from the world's origin along the normal;
    of a mesh `position_mm` and `euler_deg` of its frame in the world, and `file` and `sha256` where they are known."""
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
        """(3,) centre of the reference sphere in the world; NaN for other references."""
        return np.array(self.reference.get("position_mm", [np.nan] * 3)) / 1000 if self._sphere else np.full(3, np.nan)

    @property
    def diameter_m(self) -> float:
        """Diameter of the reference sphere; NaN for other references."""
        return float(self.reference.get("diameter_mm", np.nan)) / 1000 if self._sphere else np.nan

    @property
    def _sphere(self) -> bool:
        return self.reference.get("kind") == Spherical.kind

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
        six = recording.six_axis
        channels = np.array([True, True, six, six, six, True])
        zero = np.zeros(len(recording))
        columns = (
            np.hstack(recording.wrench())
            if six
            else np.column_stack([recording.force_N, zero, zero, zero, recording.moment_Nm])
        )
        known = recording.noise
        if tare == "calibration":
            columns = columns - self.tare
            force_noise, moment_noise = known.force_N, known.moment_Nm
        else:
            found = unloaded(recording.sweep, columns, channels, (known.force_N, known.moment_Nm), tare)
            columns = columns - found.basis @ found.tare.T
            force_noise, moment_noise = found.force_noise, found.moment_noise
        sensor, clamp = self.frames()
        force, moment = to_outer(columns[:, :3], columns[:, 3:], sensor.turn, sensor.position_m)
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
            rig=rig_uncertainty(self),
        )


def of_fit(fitted: Fitted, recording: Recording) -> Calibration:
    """The calibration of a fitted rig."""
    fit, problem, noise, air = fitted.fit, fitted.problem, fitted.noise, fitted.air
    nominal, rig = recording.rod, fit.rig
    length = nominal.length_m * rig.length
    names, values, known, jacobian = _estimates(fitted, nominal)
    checked = check(fitted, recording, jacobian)
    covariance = checked.covariance
    covariance[~known] = covariance[:, ~known] = 0
    deviations = np.where(known, np.sqrt(np.maximum(np.diag(covariance), 0)), np.inf)
    limits = np.array([limit(name, nominal, noise) for name in names])
    relative = np.where([name.startswith("bending") for name in names], np.abs(values), 1.0)
    uncertain = np.maximum(COVERAGE_FACTOR * deviations, np.where(known, checked.largest_shifts, np.inf))
    well = uncertain <= limits * relative
    if checked.spoiled:
        well &= [name.startswith(("tare", "drift")) for name in names]
    tare = rig.tare * np.repeat([nominal.force_unit_N, nominal.moment_unit_Nm], 3)[:, None]
    return Calibration(
        rod=Rod(length, nominal.bending_stiffness_Nm2 * float(np.exp(rig.stiffness)), nominal.diameter_m),
        sensor_position_m=nominal.length_m * rig.sensor,
        sensor_euler_deg=euler_of(rig.turn),
        clamp_position_m=nominal.length_m * rig.clamp,
        clamp_euler_deg=np.degrees([rig.tilt[0], 0.0, rig.tilt[1]]),
        tare=tare.mean(axis=1) if air.model == "sweep" else tare[:, 0],
        drift=tare[:, 1] if air.model == "linear" else np.ptp(tare, axis=1),
        names=names,
        values=values,
        standard_deviations=deviations,
        covariance=covariance,
        well=tuple(map(bool, well)),
        sentences=_sentences(fitted, names, deviations, limits * relative, checked.spoiled) + checked.sentences,
        chi2=checked.chi2,
        consistency=checked.consistency,
        freedom=checked.freedom,
        pose_noise_m=nominal.length_m * noise.place,
        noise_force_N=nominal.force_unit_N * noise.force,
        noise_moment_Nm=nominal.moment_unit_Nm * noise.moment,
        reference=_reference(problem.reference, dict(zip(names, values, strict=True))),
        details={
            "contacts": len(problem.touches.kind),
            "tip_contacts": int((problem.touches.kind == Kind.TIP).sum()),
            "air": len(fit.air_residual),
            "tare": air.model,
            "pose_noise": "estimated" if fitted.estimated else "given",
            "noise_colour": "white" if all(part is WHITE for part in fitted.colours) else "coloured",
            "systematic": sum(checked.systematic.square) / max(int(fit.used.sum()), 1),
        },
        map_frames=_map_frames(recording),
    )


def _short(value: Any) -> str:
    """A number, numbers or text of a table."""
    if isinstance(value, str):
        return value
    text = ", ".join(f"{number:.4g}" for number in np.ravel(value))
    return f"({text})" if np.ndim(value) else text


def _reference(reference: Reference, found: dict[str, float]) -> dict[str, Any]:
    """What was touched, and where it was by the quantities that were found."""
    if isinstance(reference, Spherical):
        position = [float(found[f"sphere_{axis}_mm"]) for axis in "xyz"]
        return {"kind": reference.kind, "diameter_mm": 1000 * reference.diameter_m, "position_mm": position}
    if isinstance(reference, Body):
        position, turn = ([float(found[f"mesh_{axis}"]) for axis in axes] for axes in (_PLACE, _TURN))
        return {"kind": reference.kind, **reference.file, "position_mm": position, "euler_deg": turn}
    normal = [float(found[f"plane_normal_{axis}"]) for axis in "xyz"]
    return {"kind": reference.kind, "normal": normal, "offset_mm": float(found["plane_offset_mm"])}


def _map_frames(recording: Recording) -> dict[str, Any]:
    """The frames of the map with which a recording was imported."""
    map = recording.source.get("map", {})
    keys = ("position_mm", "euler_deg")
    return {
        title: {key: map[title][key] for key in keys if key in map[title]}
        for title in ("sensor", "clamp")
        if title in map
    }


def _estimates(fitted: Fitted, nominal: Rod) -> tuple[tuple[str, ...], Array, Mask, Array]:
    """Names, values (k,), which of them were determined, and their derivatives (k, p) by the parameters."""
    fit, problem = fitted.fit, fitted.problem
    rows = [
        row
        for row in quantities(fit.rig, nominal, fitted.air.model, problem.reference, fitted.world)
        if measured(row[0], problem)
    ]
    jacobian = np.zeros((len(rows), len(problem.free)))
    known = np.zeros(len(rows), dtype=bool)
    for number, (name, _, slopes) in enumerate(rows):
        jacobian[number, list(slopes)] = list(slopes.values())
        # a sphere whose distance from the plane is not determined is known in the plane
        known[number] = all(problem.free[k] or (k == CENTRE + 2 and name.startswith("sphere")) for k in slopes)
    if problem.channels.all() and not problem.free[TURN + 1]:  # the sensor's place across the rod turns with it
        known &= [name not in ("sensor_x_mm", "sensor_z_mm") for name, _, _ in rows]
    return tuple(row[0] for row in rows), np.array([row[1] for row in rows]), known, jacobian


def _sentences(
    fitted: Fitted, names: tuple[str, ...], deviations: Array, limits: Array, spoiled: bool
) -> tuple[str, ...]:
    """What these touches determine poorly or not at all; where the model does not fit, other touches are no remedy."""
    known = np.isfinite(deviations)
    poor = [
        (name, f"{COVERAGE_FACTOR * deviation:.2g}")
        for name, deviation, limit in zip(names, deviations, limits, strict=True)
        if not spoiled and np.isfinite(deviation) and COVERAGE_FACTOR * deviation > limit
    ]
    fixed = [name for name, is_known in zip(names, known, strict=True) if not is_known]
    planes = isinstance(fitted.problem.reference, Spherical) and not fitted.problem.free[CENTRE + 2]
    return words.sentences(poor, fixed, fitted.problem.reference.kind) + ((words.PLANE,) if planes else ())
