"""What a calibration has found: quantities with their uncertainties, and what corrects the recordings of the rig."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any, Literal

import numpy as np

from scan3d.arrays import Array
from scan3d.calibration.estimate import calibrated, six_channels
from scan3d.calibration.model import Kind
from scan3d.calibration.premises import checked
from scan3d.calibration.quantities import COVERAGE_FACTOR, OF_CONTACTS, derivatives, lacking, limit, quantities
from scan3d.calibration.references import Sphere
from scan3d.calibration.rows import unloaded
from scan3d.errors import InputError
from scan3d.frames import Frame, euler_of, to_outer, turn_of
from scan3d.recording import Recording
from scan3d.rigs import RIG_QUANTITIES, RigUncertainty
from scan3d.rods import Rod
from scan3d.shown import Described, Rows


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
        slopes = self._errors()[:, [OF_CONTACTS.index(self.names[k]) for k in known]]
        covariance = slopes @ self.covariance[np.ix_(known, known)] @ slopes.T
        uncertain = np.flatnonzero(np.diag(covariance) > 0)
        covariance = covariance[np.ix_(uncertain, uncertain)]
        return RigUncertainty(tuple(RIG_QUANTITIES[k] for k in uncertain), (covariance + covariance.T) / 2, exact)

    def _errors(self) -> Array:
        """(14, 13) what errors of one unit of `OF_CONTACTS` are in `RIG_QUANTITIES`, to the first order."""
        to_clamp = turn_of(self.clamp_euler_deg).T
        clamp, sensor = (np.radians(_euler_axes(angles)) for angles in (self.clamp_euler_deg, self.sensor_euler_deg))
        errors = np.zeros((len(RIG_QUANTITIES), len(OF_CONTACTS)))
        errors[0, 0], errors[1, 1] = 1 / self.rod.bending_stiffness_Nm2, 1 / self.rod.length_m
        errors[2:5, 2:5], errors[8:11, 7:10] = to_clamp / 1000, np.eye(3) / 1000
        errors[5:8, 5:7], errors[11:, 10:] = (to_clamp @ clamp)[:, [0, 2]], sensor
        # a turn about the sensor's origin is one about the clamp's, and moves the sensor
        errors[8:11, 10:] = np.cross(self.sensor_position_m, sensor.T).T
        return errors


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
    nominal, rig, noise, air, touches = recording.rod, fit.rig, fit.noise, fit.problem.air, fit.problem.touches
    estimated = pose_noise_m is None and not recording.noise_pose_m
    found = quantities(fit, rig, nominal)
    names, values = tuple(found), np.array(list(found.values()))
    by_rig, known = derivatives(fit, nominal, names)
    premises = checked(fit, recording, estimated)
    covariance = by_rig @ premises.covariance @ by_rig.T
    covariance[~known] = covariance[:, ~known] = 0
    deviations = np.where(known, np.sqrt(np.maximum(np.diag(covariance), 0)), np.inf)
    limits = np.array([limit(name, value, nominal, fit) for name, value in found.items()])
    well = COVERAGE_FACTOR * deviations <= limits
    if premises.spoiled:
        well &= [name.startswith(("tare", "drift")) for name in names]
    shown = rig.tare * np.repeat([nominal.force_unit_N, nominal.moment_unit_Nm], 3)[:, None]
    touched = {"kind": "plane", "normal": rig.reference.axes[:, 2].tolist(), "offset_mm": found.get("plane_offset_mm")}
    if isinstance(rig.reference, Sphere):
        centre = 1000 * nominal.length_m * rig.reference.origin
        touched = {
            "kind": "sphere",
            "diameter_mm": 1000 * rig.reference.diameter_m,
            "position_mm": centre.tolist(),
        }
    return Calibration(
        rod=Rod(nominal.length_m * rig.length, found["bending_stiffness_Nm2"], nominal.diameter_m),
        sensor_position_m=nominal.length_m * rig.sensor,
        sensor_euler_deg=euler_of(rig.turn),
        clamp_position_m=nominal.length_m * rig.clamp,
        clamp_euler_deg=np.degrees([rig.tilt[0], 0.0, rig.tilt[1]]),
        tare=shown.mean(axis=1) if air.model == "sweep" else shown[:, 0],
        drift=shown[:, 1] if air.model == "linear" else np.ptp(shown, axis=1),
        names=names,
        values=values,
        standard_deviations=deviations,
        covariance=covariance,
        well=tuple(map(bool, well)),
        sentences=lacking(fit, names, deviations, limits, premises.spoiled) + premises.sentences,
        chi2=premises.chi2,
        consistency=premises.consistency,
        freedom=fit.freedom,
        pose_noise_m=nominal.length_m * noise.place,
        noise_force_N=nominal.force_unit_N * noise.force,
        noise_moment_Nm=nominal.moment_unit_Nm * noise.moment,
        reference=touched,
        details={
            "contacts": len(touches.kind),
            "tip_contacts": int((touches.kind == Kind.TIP).sum()),
            "air": int(air.air.sum()),
            "tare": air.model,
            "pose_noise": "estimated" if estimated else "given",
            **({"relative_error": float(noise.contradiction)} if noise.contradiction > 0 else {}),
        },
        map_frames=_map_frames(recording),
    )


def _map_frames(recording: Recording) -> dict[str, Any]:
    """The frames of the map with which a recording was imported."""
    map = recording.source.get("map", {})
    return {
        title: {key: map[title][key] for key in ("position_mm", "euler_deg") if key in map[title]}
        for title in ("sensor", "clamp")
        if title in map
    }
