"""What a calibration has found: quantities with their uncertainties, what corrects the recordings of the rig, and its file."""

from __future__ import annotations

import dataclasses
import math
import os
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Literal

import numpy as np

from scan3d.arrays import NEGLIGIBLE, Array, Mask
from scan3d.calibration.fit import Fit, Sensor, calibrated, checked
from scan3d.calibration.model import GAINS as GAIN
from scan3d.calibration.model import MIXING, PLACE, SENSOR, SHAPE, TARE, TURN, Kind, Rig
from scan3d.calibration.references import CHANCE, Plane, Sphere, six_channels, unloaded, weighed
from scan3d.choices import Tare
from scan3d.errors import InputError
from scan3d.files.recordings import as_recording
from scan3d.files.text import (
    Section,
    read_frame,
    read_rod,
    read_section,
    read_transducer,
    rod_section,
    to_toml,
)
from scan3d.files.whole import SCHEMA, Inputs, check_file, folder, write_atomic
from scan3d.recording import Recording, reaction_columns
from scan3d.rigs import (
    DEFAULT_ACCURACY,
    RIG_QUANTITIES,
    SHOWS,
    Frame,
    RigUncertainty,
    accuracy_of,
    euler_of,
    to_inner,
    turn_of,
    wrench_matrix,
)
from scan3d.rods import Rod
from scan3d.shown import Described, Rows
from scan3d.units import force, length, share
from scan3d.workers import in_one_thread


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
    accuracy: Array = field(default_factory=lambda: np.zeros(6))
    """(6,) standard deviations of the gains of the sensor's channels as they are stated, or assumed; 0 for exact gains."""
    gains: Array = field(default_factory=lambda: np.zeros(6))
    """(6,) what is added to the tared channels of the sensor, as multiples of them."""
    gains_covariance: Array = field(default_factory=lambda: np.zeros((6, 6)))
    """(6, 6 + k) of the gains with each other, and with the quantities; of a matrix of signals as in `RigUncertainty`."""
    matrix: Array = field(default_factory=lambda: np.zeros((0, 0)))
    """(c, q) what makes `channels` in N and N m of q signals less their `offset`; empty for a sensor that shows forces."""
    offset: Array = field(default_factory=lambda: np.zeros(0))
    """(q,)"""
    channels: tuple[str, ...] = ()
    """(c,) the channels of the matrix."""
    map_frames: Mapping[str, Any] = field(default_factory=dict)
    """The sections `sensor` and `clamp` of the map with which the touches were imported: `scan3d.import_table` needs them."""

    def summary(self) -> Rows:
        """What was touched, the rod, the frames, and how well all is known."""
        rod, well = self.rod, sum(self.well)
        long, stiffness = f"{length(rod.length_m, 'm', digits=5)} long", f"EI = {rod.bending_stiffness_Nm2:.5g} N m²"
        return [
            ("reference", ", ".join(f"{name} {_short(value)}" for name, value in self.reference.items())),
            ("rod", f"{long}, {stiffness}"),
            ("sensor", f"at {_short(1e3 * self.sensor_position_m)} mm, turned by {_short(self.sensor_euler_deg)}°"),
            ("gains", self.told_gains),
            ("clamp", f"at {_short(1e3 * self.clamp_position_m)} mm, turned by {_short(self.clamp_euler_deg)}°"),
            ("well determined", f"{well} of {len(self.well)} quantities"),
            ("fit", f"chi² {self.chi2:.3g}, consistency {self.consistency:.3g}, {self.freedom} degrees of freedom"),
            ("remarks", " ".join(self.sentences) or "none"),
        ]

    @property
    def told_gains(self) -> str:
        """How well the gains of the sensor's channels are known, in words."""
        stated = ", ".join(
            share(accuracy) if accuracy else "exactly" for accuracy in dict.fromkeys(self.accuracy.tolist())
        )
        assumed = ", which is assumed: state accuracy under [sensor] of the map, or --accuracy"
        return f"known to {stated} (one standard deviation)" + assumed * (self.details.get("accuracy") == "assumed")

    @property
    def expanded(self) -> Array:
        """(k,) expanded uncertainties, with the coverage factor 2."""
        return COVERAGE_FACTOR * self.standard_deviations

    def frames(self, *, imported: bool = True) -> tuple[Frame, Frame]:
        """The sensor's frame in the clamp's, and the clamp's in that of the recorded poses.

        They are what is left of rows that the map of the touches has `imported`, or those of the sensor's own channels and of
        the poses as they are logged.
        """
        sensor = Frame.of(self.sensor_position_m, self.sensor_euler_deg)
        clamp = Frame.of(self.clamp_position_m, self.clamp_euler_deg)
        if imported:
            return sensor, clamp
        return _before(self.map_frames, "sensor").within(sensor), clamp.within(_before(self.map_frames, "clamp"))

    def applied(self, recording: Recording, tare: str = "auto") -> Recording:
        """A recording of this rig, as `calibrate` takes it, with poses and reactions of the true clamp, and the true rod.

        The tare is found in its own rows in the air; `tare` as in `calibrate`, or ``calibration`` for that of the calibration.
        Raises InputError if there are too few rows in the air.
        """
        if self.channels:
            raise InputError(
                "the rig has the matrix of a sensor's signals, and a recording has forces: import the table of the signals "
                "with scan3d import --rig"
            )
        _check_directions(recording, "import the table with scan3d import --rig")
        known = recording.noise
        channels, wrench = six_channels(recording)
        gravity = recording.gravity
        if tare == "calibration":
            wrench = wrench - self.tare
            force_noise, moment_noise = known.force_N, known.moment_Nm
        else:
            gravity = gravity and dataclasses.replace(gravity, tared=True)
            model = "sweep" if tare == "auto" and self.rod.weight_N else tare  # a weight turns with the clamp
            air = unloaded(recording.sweep, wrench, channels, (known.force_N, known.moment_Nm), model)
            wrench = wrench - air.basis @ air.tare.T
            force_noise, moment_noise = air.force_noise, air.moment_noise
        # noise of half a step makes the errors of rounding independent; the turn hides the steps, which nobody sees afterwards
        rounding = known.force_N**2 - recording.noise_force_N**2, known.moment_Nm**2 - recording.noise_moment_Nm**2
        fine = force_noise**2 >= 4 * rounding[0] and moment_noise**2 >= 4 * rounding[1]
        force, moment, position, quaternion = self.corrected(wrench, recording.position_m, recording.quaternion)
        return dataclasses.replace(
            recording,
            position_m=position,
            quaternion=quaternion,
            **reaction_columns(force, moment, recording.six_axis),
            rod=self.rod,
            gravity=gravity,
            noise_force_N=force_noise,
            noise_moment_Nm=self.moment_noise(force_noise, moment_noise),
            noise_pose_m=recording.noise_pose_m or self.pose_noise_m,
            noise_independent=recording.noise_independent and fine,
            source={**recording.source, "calibrated": True},
            rig=self.uncertainty(),
        )

    def corrected(
        self, wrench: Array, position_m: Array, quaternion: Array, *, imported: bool = True
    ) -> tuple[Array, Array, Array, Array]:
        """Force, moment and position (n, 3) and quaternion (n, 4) of the true clamp, by tared wrenches (n, 6) and poses.

        `imported` as of `frames`; a sensor whose own rows show the action of the rod on the clamp is read so.
        """
        sensor, clamp = self.frames(imported=imported)
        matrix = wrench_matrix(sensor.turn, sensor.position_m)
        if not imported:
            of_clamp = self.map_frames.get("sensor", {}).get("shows") != SHOWS[1]
            matrix = matrix * (1 + self.gains) * (1.0 if of_clamp else -1.0)
        elif self.gains.any():
            before = _before(self.map_frames, "sensor")
            own = wrench_matrix(before.turn, before.position_m)
            matrix = matrix @ own * (1 + self.gains) @ np.linalg.inv(own)
        force, moment = np.hsplit(wrench @ matrix.T, 2)
        return force, moment, *clamp.carried(position_m, quaternion)

    def moment_noise(self, force_N: float, moment_Nm: float, *, imported: bool = True) -> float:
        """Largest deviation of the components of the clamp's moment by those of the sensor's; `imported` as of `frames`."""
        place = self.frames(imported=imported)[0].position_m
        # that of the component with the longest lever, as an import states it
        levers = place @ place - place**2
        return float(np.sqrt(moment_Nm**2 + float(levers.max()) * force_N**2))

    def uncertainty(self) -> RigUncertainty:
        """The covariance of the errors that remain in a recording that this corrects, to the first order.

        Tare and drift are left out, because an import finds them again, and so is the place of the reference.  Quantities
        without an uncertainty stay at nominal values, which are taken as exact; a rig by hand states none.
        """
        chosen = [k for k, name in enumerate(self.names) if name in OF_CONTACTS]
        known = [k for k in chosen if np.isfinite(self.standard_deviations[k])]
        exact = tuple(self.names[k] for k in chosen if k not in known)
        if self.channels or not chosen:
            exact = tuple(name for name in OF_CONTACTS if name not in self.names)
        slopes = self._errors()[:, [OF_CONTACTS.index(self.names[k]) for k in known]]
        covariance = slopes @ self.covariance[np.ix_(known, known)] @ slopes.T
        uncertain = np.flatnonzero(np.diag(covariance) > 0)
        covariance, own = covariance[np.ix_(uncertain, uncertain)], self.frames(imported=False)[0]
        names = tuple(RIG_QUANTITIES[k] for k in uncertain)
        # those that are corrected already are left by as much
        left = np.ones(len(self.gains_covariance)) if self.channels else 1 / (1 + self.gains)
        of_gains, others = np.split(self.gains_covariance, [len(left)], axis=1)
        gains = left[:, None] * np.hstack([of_gains * left, others[:, known] @ slopes[uncertain].T])
        frame = (*own.position_m.tolist(), *euler_of(own.turn).tolist()) if gains.any() else (0.0,) * 6
        return RigUncertainty(names, (covariance + covariance.T) / 2, exact, gains, frame)

    def _errors(self) -> Array:
        """(18, 17) what errors of one unit of `OF_CONTACTS` are in `RIG_QUANTITIES`, to the first order."""
        to_clamp = turn_of(self.clamp_euler_deg).T
        clamp, sensor = (np.radians(_euler_axes(angles)) for angles in (self.clamp_euler_deg, self.sensor_euler_deg))
        errors = np.zeros((len(RIG_QUANTITIES), len(OF_CONTACTS)))
        errors[0, 0], errors[1, 1] = 1 / self.rod.bending_stiffness_Nm2, 1 / self.rod.length_m
        errors[2:5, 2:5], errors[8:11, 7:10] = to_clamp / 1000, np.eye(3) / 1000
        errors[5:8, 5:7], errors[11:14, 10:13] = (to_clamp @ clamp)[:, [0, 2]], sensor
        errors[14, 13], errors[15:, 14:] = 1 / self.rod.profile.diameters[-1], np.eye(3)
        # a turn about the sensor's origin is one about the clamp's, and moves the sensor
        errors[8:11, 10:13] = np.cross(self.sensor_position_m, sensor.T).T
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


@in_one_thread
def calibrate(
    recording: Recording | str | os.PathLike[str],
    reference: float | Literal["plane"],
    *,
    tare: Tare = "auto",
    pose_noise_m: float | None = None,
    accuracy: float | Sequence[float] | None = None,
) -> Calibration:
    """The rig that has touched a reference, which was at a place and in a pose that need not be known.

    reference
        the diameter of a sphere in m, or ``"plane"``.
    tare
        what the sensor shows in the air: ``constant``, ``linear`` (drifts steadily over the recording), ``sweep`` (a value
        for each sweep), or ``auto``: linear if the rows in the air allow it, else sweep.
    pose_noise_m
        standard deviation of each coordinate of the recorded clamps; None takes the recording's, or estimates it.
    accuracy
        standard deviation of the gains of the sensor's channels, one number or one each for fx, fy, fz, mx, my and mz; 0 for
        gains that are exact.  None takes that of the map with which the recording was imported, or 0.5 %.

    The recording has six axes, or three for a rod in a plane past a sphere, and the nominal rod; reactions are those of the
    sensor, neither tared nor turned.  Raises InputError for impossible arguments and for touches that do not determine the rig.
    The recording may be given as the path of its file.
    """
    recording = as_recording(recording)
    _check_directions(recording, "calibrate by the strokes of one direction")
    map_frames, stated = _map_frames(recording), accuracy
    if stated is None:
        stated = recording.source.get("map", {}).get("sensor", {}).get("accuracy")
    deviations = accuracy_of(DEFAULT_ACCURACY if stated is None else stated)
    before = _before(map_frames, "sensor")
    if not recording.six_axis:  # channels that were not measured have no moment about other axes
        before = dataclasses.replace(before, position_m=before.position_m * [1, 1, 0])
    recording, sensor = _by_own_channels(recording, before), Sensor(deviations, before)
    fit = calibrated(recording, reference, tare, pose_noise_m, sensor)
    nominal, rig, noise, air, touches = recording.rod, fit.rig, fit.noise, fit.problem.air, fit.problem.touches
    estimated = pose_noise_m is None and not recording.noise_pose_m
    found = quantities(fit, rig, nominal, before)
    names, values = tuple(found), np.array(list(found.values()))
    by_rig, known = derivatives(fit, nominal, names, before)
    premises = checked(fit, recording, estimated)
    covariance = by_rig @ premises.covariance @ by_rig.T
    covariance[~known] = covariance[:, ~known] = 0
    # where cross-talk was found as well, gains are among what mixes the channels
    of_gains = np.zeros((6, len(fit.problem.free)))
    of_gains[:, GAIN:MIXING] = np.eye(6)
    of_gains[:, MIXING:TARE][:, ::7] = np.eye(6)
    of_gains[:, ~fit.problem.free] = 0
    gains = of_gains @ premises.covariance
    gains = np.hstack([gains @ of_gains.T, np.where(known, gains @ by_rig.T, 0.0)])
    deviations = np.where(known, np.sqrt(np.maximum(np.diag(covariance), 0)), np.inf)
    limits = np.array([limit(name, value, nominal, fit) for name, value in found.items()])
    shown = _shown(rig, nominal, before)
    tare_and_drift = (
        shown.mean(axis=1) if air.model == "sweep" else shown[:, 0],
        shown[:, 1] if air.model == "linear" else np.ptp(shown, axis=1),
    )
    rod, sentences, left = _rod(nominal, rig), premises.sentences, _left_by(before, nominal, rig)
    if recording.gravity is not None and not recording.gravity.tared:
        place = nominal.length_m**2 * premises.covariance[SENSOR:PLACE, SENSOR:PLACE]
        place_and_turn = Frame(nominal.length_m * rig.sensor, rig.turn)
        weight = weighed(recording, rod, place_and_turn, rig.clamp_axes()[0], air, place)
        names, values = (*names, "weight_N"), np.append(values, weight.weight_N)
        # a weight that moves contacts by a thousandth of the rod at most
        deviations, limits = np.append(deviations, weight.sd_N), np.append(limits, 0.01 * nominal.force_unit_N)
        covariance, gains = np.pad(covariance, (0, 1)), np.pad(gains, ((0, 0), (0, 1)))
        covariance[-1, -1] = weight.sd_N**2 if np.isfinite(weight.sd_N) else 0.0
        if weight.tare_and_drift is not None:
            own = wrench_matrix(before.turn, before.position_m)
            rod = dataclasses.replace(rod, weight_N=weight.weight_N)
            tare_and_drift = own @ weight.tare_and_drift[0], own @ weight.tare_and_drift[1]
        elif weight.weight_N > CHANCE * weight.sd_N:
            sentences += (
                f"In the air the sensor carries {force(weight.weight_N)}, whose centre is not the rod's: what else "
                "hangs at it was weighed with the rod, which has no weight in this file; weigh the rod, and state "
                "weight_N.",
            )
    if rod.weight_N:
        sentences += ("The rod's weight is not part of this fit: what it adds to the reactions counts as tare.",)
    well = COVERAGE_FACTOR * deviations <= limits
    if premises.spoiled:
        well &= [name.startswith(("tare", "drift", "weight")) for name in names]
    touched = {"kind": "plane", "normal": rig.reference.axes[:, 2].tolist(), "offset_mm": found.get("plane_offset_mm")}
    if isinstance(rig.reference, Sphere):
        centre = (1000 * nominal.length_m * rig.reference.origin).tolist()
        touched = {"kind": "sphere", "diameter_mm": 1000 * rig.reference.diameter_m, "position_mm": centre}
    return Calibration(
        rod=rod,
        sensor_position_m=left.position_m,
        sensor_euler_deg=euler_of(left.turn),
        clamp_position_m=nominal.length_m * rig.clamp,
        clamp_euler_deg=np.degrees([rig.tilt[0], 0.0, rig.tilt[1]]),
        tare=tare_and_drift[0],
        drift=tare_and_drift[1],
        names=names,
        values=values,
        standard_deviations=deviations,
        covariance=covariance,
        well=tuple(map(bool, well)),
        sentences=lacking(fit, names, deviations, limits, premises.spoiled) + sentences,
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
            "accuracy": "assumed" if stated is None else "stated",
            **({"relative_error": float(noise.contradiction)} if noise.contradiction > 0 else {}),
        },
        accuracy=sensor.accuracy,
        gains=of_gains[:, GAIN:TARE] @ np.concatenate([rig.gains, rig.mixing.ravel()]),
        gains_covariance=gains,
        map_frames=map_frames,
    )


def _rod(nominal: Rod, rig: Rig) -> Rod:
    """The rod of a rig, as it is stated but for what was found."""
    long, stiffness = nominal.length_m * rig.length, nominal.bending_stiffness_Nm2 * math.exp(rig.stiffness)
    rod = dataclasses.replace(
        nominal,
        length_m=long,
        bending_stiffness_Nm2=stiffness,
        # the fit has that of the nominal rod in its unit, L/EI
        clamp_compliance_rad_per_Nm=nominal.clamp_compliance_rad_per_Nm * math.exp(-rig.stiffness),
        tip_diameter_m=None,
        stiffness_table=(),
        diameter_table=(),
    )
    if not rig.marched:
        return rod
    bend_z, bend_x, twist = (part / nominal.length_m for part in rig.rod.curvature)
    rod = dataclasses.replace(rod, curvature_per_m=(bend_z, bend_x, twist))
    profile = rig.rod.profile
    places = np.unique(np.minimum([*profile.knots, rig.length], rig.length))
    diameters = profile.diameter(places)
    if np.ptp(diameters) == 0:
        return rod
    rows = list(zip((nominal.length_m * places).tolist(), diameters.tolist(), strict=True))
    if nominal.stiffness_table or not nominal.diameter_m:
        return dataclasses.replace(rod, stiffness_table=tuple((s, stiffness * d**4) for s, d in rows))
    return dataclasses.replace(rod, diameter_table=tuple((s, nominal.diameter_m * d) for s, d in rows))


def _check_directions(recording: Recording, advice: str) -> None:
    """Raise InputError for a recording whose import turned clamp and sensor in some rows, which it does not tell."""
    if recording.source.get("map", {}).get("sweeps", {}).get("directions") == "both":
        raise InputError(
            'the recording was imported with directions = "both", which turns the frames of clamp and sensor by half a turn in '
            f"strokes back; {advice}, or import it without"
        )


def _map_frames(recording: Recording) -> dict[str, Any]:
    """The frames of the map with which a recording was imported."""
    map = recording.source.get("map", {})
    return {
        title: {key: map[title][key] for key in ("position_mm", "euler_deg", "shows") if key in map[title]}
        for title in ("sensor", "clamp")
        if title in map
    }


def _before(map_frames: Mapping[str, Any], title: Literal["sensor", "clamp"]) -> Frame:
    """The frame that the map of the touches had: the sensor's in the clamp's, or the clamp's in that of the poses."""
    return read_frame(Section("the rig", map_frames.get(title, {}), f"map.{title}"))


def _by_own_channels(recording: Recording, before: Frame) -> Recording:
    """The recording with the wrench as the channels of the sensor show it, whose noise is independent, in place of that in the
    clamp of a map that had stated the sensor's frame."""
    if before.trivial:
        return recording
    if not recording.six_axis and abs(abs(before.turn[2, 2]) - 1) > NEGLIGIBLE:
        raise InputError(
            "three channels are calibrated of a sensor whose z axis is along the clamp's: name those along the clamp's axes "
            "under [columns] of the map, with - where one is reversed, in place of euler_deg under [sensor]"
        )
    channels, wrench = six_channels(recording)
    force, moment = to_inner(wrench[:, :3], wrench[:, 3:], before.turn, before.position_m)
    # what was stated is that of the largest component, by the levers of the force
    levers = (before.position_m**2).sum() - before.position_m**2
    left = recording.noise_moment_Nm**2 - float(levers[channels[3:]].max()) * recording.noise_force_N**2
    return dataclasses.replace(
        recording,
        **reaction_columns(force, moment, recording.six_axis),
        noise_moment_Nm=float(np.sqrt(max(left, 0.0))),
    )


def _left_by(before: Frame, nominal: Rod, rig: Rig) -> Frame:
    """The frame of the sensor in the clamp's in which one `before` is that of its own channels."""
    turn = rig.turn @ before.turn.T
    return Frame(nominal.length_m * rig.sensor - turn @ before.position_m, turn)


def _shown(rig: Rig, nominal: Rod, before: Frame) -> Array:
    """(6, k) the tare in N and N·m, as coefficients of its basis, of the wrench in the clamp of a map."""
    shown = rig.tare * np.repeat([nominal.force_unit_N, nominal.moment_unit_Nm], 3)[:, None]
    return shown if before.trivial else wrench_matrix(before.turn, before.position_m) @ shown


COVERAGE_FACTOR = 2.0
"""Of expanded uncertainties: about 95 % of the errors of a normal distribution."""
_TARE = ("force_N", "moment_Nm", "drift_force_N", "drift_moment_Nm")
CHANNELS = ("fx_N", "fy_N", "fz_N", "mx_Nm", "my_Nm", "mz_Nm")
OF_CONTACTS = (
    "bending_stiffness_Nm2",
    "length_m",
    *(f"clamp_{axis}_mm" for axis in "xyz"),
    *(f"clamp_turn_{axis}_deg" for axis in "xz"),
    *(f"sensor_{axis}_mm" for axis in "xyz"),
    *(f"sensor_turn_{axis}_deg" for axis in "xyz"),
    "tip_diameter_ratio",
    *(f"curvature_{axis}_per_m" for axis in "zx"),
    "weight_N",
)
"""The quantities of a calibration that change contacts; the gains do so as well."""


def quantities(fit: Fit, rig: Rig, nominal: Rod, before: Frame) -> dict[str, float]:
    """The quantities of a rig, which may be another one than that of the fit; a rod in a plane has fewer.

    Those of the sensor are what the frame of a map `before` leaves, and the tare that of the wrench in this map's clamp.
    """
    mm, problem, sensor = 1000 * nominal.length_m, fit.problem, _left_by(before, nominal, rig)
    found = {
        "bending_stiffness_Nm2": nominal.bending_stiffness_Nm2 * float(np.exp(rig.stiffness)),
        "length_m": nominal.length_m * rig.length,
    }
    turns = (("clamp_turn", "xz", np.degrees(rig.tilt)), ("sensor_turn", "xyz", euler_of(sensor.turn)))
    places = mm * rig.clamp, 1000 * sensor.position_m
    for part, place, (title, axes, angles) in zip(("clamp", "sensor"), places, turns, strict=True):
        found |= {f"{part}_{axis}_mm": value for axis, value in zip("xyz", place, strict=True)}
        found |= {f"{title}_{axis}_deg": value for axis, value in zip(axes, angles, strict=True)}
    if isinstance(rig.reference, Plane):
        normal = rig.reference.axes[:, 2]
        found |= {f"plane_normal_{axis}": value for axis, value in zip("xyz", normal, strict=True)}
        found["plane_offset_mm"] = mm * float(normal @ rig.reference.origin)
    else:
        found |= {f"sphere_{axis}_mm": mm * value for axis, value in zip("xyz", rig.reference.origin, strict=True)}
    for name, measured, tare in zip(CHANNELS, problem.channels, _shown(rig, nominal, before), strict=True):
        if measured and problem.air.model == "sweep":
            found[f"tare_{name}"] = tare.mean()
        elif measured:
            found |= {f"{title}_{name}": value for title, value in zip(("tare", "drift"), tare, strict=False)}
    if problem.free[SHAPE]:
        found["tip_diameter_ratio"] = rig.rod.profile.diameters[-1]
        found |= {
            f"curvature_{axis}_per_m": value / nominal.length_m
            for axis, value in zip("zx", rig.rod.curvature, strict=False)
        }
    if not problem.channels.all():
        found.pop("curvature_x_per_m", None)
        for name in ("clamp_turn_x_deg", "sensor_z_mm", "sensor_turn_x_deg", "sensor_turn_y_deg"):
            del found[name]
    return {name: float(value) for name, value in found.items()}


def derivatives(fit: Fit, nominal: Rod, names: tuple[str, ...], before: Frame) -> tuple[Array, Mask]:
    """(q, p) derivatives of the quantities by the parameters, and which quantities (q,) the touches determine."""
    size, columns = 1e-5, []
    for step in size * np.eye(len(fit.problem.free)):
        ahead, behind = (
            np.array(list(quantities(fit, fit.rig.moved(s), nominal, before).values())) for s in (step, -step)
        )
        columns.append((ahead - behind) / (2 * size))
    slopes = np.column_stack(columns)
    angles, half_turn = [name.endswith("_deg") for name in names], 180 / size
    slopes[angles] = (slopes[angles] + half_turn / 2) % half_turn - half_turn / 2
    # less is their rounding
    slopes[np.abs(slopes) < 1e-7 * np.abs(slopes).max(axis=1, keepdims=True)] = 0
    free = fit.problem.free
    known = ~(slopes[:, ~free] != 0).any(axis=1)
    if fit.problem.channels.all() and not free[TURN + 1]:  # the sensor's place across the rod turns with it
        known &= [name not in ("sensor_x_mm", "sensor_z_mm") for name in names]
    return slopes, np.asarray(known)


def limit(name: str, value: float, nominal: Rod, fit: Fit) -> float:
    """The expanded uncertainty up to which a quantity is well determined: 1 % of the stiffness, 0.5 % of the rod for lengths.

    Angles are then known to 0.3°, the tare to the noise of a row, the tip's diameter to 3 % of the clamp's, and curvatures to
    0.02 over the length.
    """
    if name.startswith("bending"):
        return 0.01 * value
    if name.startswith(("tare", "drift")):
        force, moment = nominal.force_unit_N * fit.noise.force, nominal.moment_unit_Nm * fit.noise.moment
        return force if name.endswith("_N") else moment
    if name.startswith(("tip_diameter", "curvature")):
        return 0.03 if name.startswith("tip") else 0.02 / nominal.length_m
    if name.startswith("plane_normal"):
        return float(np.radians(0.3))
    if name.endswith("_deg"):
        return 0.3
    return 0.005 * nominal.length_m * (1000 if name.endswith("_mm") else 1)


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
        sentences.append(
            f"These touches do not determine the sensor's turn about the rod: {lost} are a first estimate, which may "
            f"be wrong by some degrees. It needs a {noun} with more friction, because without friction contacts stay "
            f"on the {noun} when they turn about the rod; and sweeps that bend the rod more."
        )
    for group, members in fixed.items():
        what, touches = _TOUCHES[group]
        stay = "are estimates" if group == noun else "stay" + "s" * (len(members) == 1) + " at the nominal value"
        sentences.append(f"These touches do not determine {what}: {', '.join(members)} {stay}. It needs {touches}.")
    for group, members in poor.items():
        what, touches = _TOUCHES[group]
        sentences.append(f"These touches determine {what} poorly ({', '.join(members)}). It needs {touches}.")
    if noun == "sphere" and not fit.problem.free[PLACE + 2]:
        sentences.append(
            "The sweeps lie in one plane, in which the rod is taken to pass through the sphere's centre; to test "
            "this, sweep planes at several heights."
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
    "tip_diameter": (
        "the rod's taper",
        "sweeps that bend the rod more, from touches near the clamp to some near the tip",
    ),
    "curvature": (
        "the rod's curvature",
        "sweeps that touch the {noun} near the clamp and near the tip, with the clamp turned about the rod's axis",
    ),
    "clamp_turn": (
        "the clamp's turn",
        "sweeps that touch the {noun} near the clamp and near the tip, with the clamp turned about the rod's axis",
    ),
    "clamp_y": (
        "the clamp's offset along the rod",
        "sweeps with the rod in other directions, such as from the opposite side of a sphere or more inclined to a "
        "plane",
    ),
    "clamp": (
        "the clamp's offset across the rod",
        "sweeps with the clamp turned about the rod's axis by 90 degrees and more",
    ),
    "sensor_turn": ("the sensor's turn", "sweeps that bend the rod more, and a {noun} with more friction"),
    "sensor": ("the sensor's place", "sweeps that bend the rod more, and to several sides of the clamp"),
    "sphere": ("the sphere's place", "sweeps with the rod in more directions"),
    "plane": ("the plane's place", "sweeps with the rod in more directions, and all over the plane"),
    "weight": ("the weight", "sweeps that begin in the air with the clamp in other directions to gravity"),
    "tare": ("the tare", "more rows in the air, before and after each touch"),
    "drift": ("the drift", "more rows in the air at the beginning and the end of the recording"),
}


def check_path(path: str | Path, inputs: Inputs, overwrite: bool) -> None:
    """Raise InputError if a calibration must not be written at the path."""
    if Path(path).suffix != ".toml":
        raise InputError(f"a rig is written as .toml, got {Path(path).name!r}")
    check_file(path, inputs, overwrite, "--out")


def write_rig(calibration: Calibration, path: str | Path, *, overwrite: bool = False) -> None:
    """Write a calibration; numbers have all digits.

    Raises InputError if it can't be written, and, unless `overwrite` is true, if it would replace a file that is no rig.
    """
    check_path(path, {}, overwrite)
    with folder(Path(path).parent):
        write_atomic(path, ("# rig calibrated by scan3d\n" + to_toml(sections(calibration))).encode(errors="replace"))


def sections(calibration: Calibration) -> dict[str, Any]:
    """The contents of the file, of plain values."""
    rig = calibration
    known = np.isfinite(rig.standard_deviations)
    names = [name for name, is_known in zip(rig.names, known, strict=True) if is_known]
    reference = {key: value for key, value in rig.reference.items() if key != "kind"}
    return {
        "schema": SCHEMA,
        "rod": rod_section(rig.rod),
        "sensor": _frame(rig.sensor_position_m, rig.sensor_euler_deg)
        | (
            {"channels": rig.channels, "matrix": rig.matrix.tolist(), "offset": rig.offset.tolist()}
            if rig.channels
            else {"accuracy": rig.accuracy.tolist(), "gains": rig.gains.tolist()}
        ),
        "clamp": _frame(rig.clamp_position_m, rig.clamp_euler_deg),
        "tare": dict(zip(_TARE, np.reshape([rig.tare, rig.drift], (4, 3)).tolist(), strict=True)),
        **({rig.reference["kind"]: reference} if reference else {}),
        "noise": {"force_N": rig.noise_force_N, "moment_Nm": rig.noise_moment_Nm, "pose_m": rig.pose_noise_m},
        "fit": {
            "chi2_per_freedom": rig.chi2,
            "consistency": rig.consistency,
            "freedom": rig.freedom,
            **rig.details,
            "sentences": list(rig.sentences),
        },
        "quantities": dict(zip(rig.names, rig.values.tolist(), strict=True)),
        "uncertainty": {"coverage_factor": COVERAGE_FACTOR}
        | dict(zip(names, rig.standard_deviations[known].tolist(), strict=True)),
        "covariance": {
            "quantities": names,
            "well": np.array(rig.well)[known].tolist(),
            "matrix": rig.covariance[np.ix_(known, known)].tolist(),
            "gains": rig.gains_covariance[:, np.append(np.ones(len(rig.gains_covariance), dtype=bool), known)].tolist(),
        },
        **({"map": dict(rig.map_frames)} if rig.map_frames else {}),
    }


def _frame(position_m: Array, euler_deg: Array) -> dict[str, Any]:
    return {"position_mm": (1000 * position_m).tolist(), "euler_deg": euler_deg.tolist()}


def read_rig(path: str | Path) -> Calibration:
    """Read a calibration.  Raises InputError with the name of the file and the error in it.

    A file by hand needs [rod], [sensor] and [clamp] only; what it lacks of the rest counts as not known.
    """
    data = read_section(path, "rig")
    if data.integer("schema", SCHEMA, at_least=0) != SCHEMA:
        raise data.error("schema", f"must be {SCHEMA}, got {data.any('schema')!r}")
    rod, sensor, clamp, tare = (data.section(name) for name in ("rod", "sensor", "clamp", "tare"))
    fit, noise, quantities, uncertainty = (data.section(name) for name in ("fit", "noise", "quantities", "uncertainty"))
    uncertainty.any("coverage_factor")
    with sensor.errors_named():
        accuracy = accuracy_of(sensor.any("accuracy", 0.0))
    channels, matrix, offset = read_transducer(sensor)
    shown = np.concatenate([_three(tare, name) for name in _TARE])
    frames, names = data.section("map"), tuple(quantities.data)
    covariance, gains, well = _covariance(data.section("covariance"), names, np.diag(accuracy**2))
    known = ("chi2_per_freedom", "consistency", "freedom", "sentences")
    calibration = Calibration(
        rod=read_rod(rod),
        sensor_position_m=_three(sensor, "position_mm") / 1000,
        sensor_euler_deg=_three(sensor, "euler_deg"),
        clamp_position_m=_three(clamp, "position_mm") / 1000,
        clamp_euler_deg=_three(clamp, "euler_deg"),
        tare=shown[:6],
        drift=shown[6:],
        names=names,
        values=np.array([quantities.number(name) for name in names]),
        standard_deviations=np.array([uncertainty.number(name, math.inf) for name in names]),
        covariance=covariance,
        well=well,
        sentences=fit.texts("sentences"),
        chi2=fit.number("chi2_per_freedom", math.nan),
        consistency=fit.number("consistency", math.nan),
        freedom=fit.integer("freedom", 0, at_least=0),
        pose_noise_m=noise.number("pose_m", 0.0),
        noise_force_N=noise.number("force_N", 0.0),
        noise_moment_Nm=noise.number("moment_Nm", 0.0),
        reference=_read_reference(data),
        details={key: fit.any(key) for key in fit.data if key not in known},
        accuracy=accuracy,
        gains=np.array(sensor.numbers("gains", 6, (0.0,) * 6)),
        gains_covariance=gains,
        map_frames={title: dict(frames.notes(title)) for title in ("sensor", "clamp") if title in frames},
        matrix=np.array(matrix),
        offset=np.array(offset),
        channels=channels,
    )
    data.finish("; scan3d calibrate writes such a file")
    return calibration


def _three(section: Section, name: str) -> Array:
    return np.array(section.numbers(name, 3, (0.0, 0.0, 0.0)))


def _covariance(section: Section, names: tuple[str, ...], stated: Array) -> tuple[Array, Array, tuple[bool, ...]]:
    """The covariance (k, k) of quantities (k,), that of the gains (g, g + k), and whether quantities are well determined.

    Where the file has none of the gains it is the stated one (6, 6).
    """
    covariance, well = np.zeros((len(names), len(names))), np.zeros(len(names), dtype=bool)
    listed, matrix, good = section.texts("quantities"), section.any("matrix", []), section.any("well", [])
    of_gains = section.any("gains", None)
    size = 36 if isinstance(of_gains, list) and len(of_gains) == 36 else 6
    gains = np.zeros((size, size + len(names)))
    gains[:6, :6] = stated
    needed = (
        "must have quantities of [quantities], and a row of numbers, a column and true or false for each; of the gains 6 or "
        "36 rows, with columns for the gains and the quantities"
    )
    try:
        rows = np.array([names.index(name) for name in listed], dtype=int)
        covariance[np.ix_(rows, rows)] = np.array(matrix, dtype=float).reshape(len(rows), len(rows))
        well[rows] = good
        if of_gains is not None:
            columns = np.append(np.arange(size), size + rows)
            gains[:, columns] = np.array(of_gains, dtype=float).reshape(size, size + len(rows))
    except (ValueError, TypeError):
        raise section.error("", needed) from None
    return covariance, gains, tuple(map(bool, well))


def _read_reference(data: Section) -> dict[str, Any]:
    """What was touched; files of former versions may name a mesh."""
    sphere, plane, mesh = data.section("sphere"), data.section("plane"), data.notes("mesh")
    if sphere:
        place = list(sphere.numbers("position_mm", 3))
        return {"kind": "sphere", "diameter_mm": sphere.number("diameter_mm"), "position_mm": place}
    if plane:
        return {"kind": "plane", "normal": list(plane.numbers("normal", 3)), "offset_mm": plane.number("offset_mm")}
    return {"kind": "mesh", **mesh} if mesh else {}
