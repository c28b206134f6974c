"""Contacts while they happen: one row of pose and wrench in, one contact out.

A row gives what it gives in a recording: `reconstruction.contacts` reads both.  What needs more than the row is left to
`Live.cloud`: normals in space, the common friction of all contacts, and which contacts others contradict.
"""

from __future__ import annotations

from collections import deque
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

import numpy as np
from numpy.typing import ArrayLike

import planar
from scan3d.arrays import LARGEST, ROUNDING, Array
from scan3d.calibration.report import Calibration, read_rig
from scan3d.choices import MODELS, Model
from scan3d.cloud import Cloud
from scan3d.errors import InputError
from scan3d.files.recordings import read_settings
from scan3d.files.text import read_section
from scan3d.laboratory.signals import ringing
from scan3d.planning.plan import check_choice, check_whole
from scan3d.reconstruction import NoContactError, probings, reconstruct
from scan3d.reconstruction.agreement import OFF_LINE
from scan3d.reconstruction.contacts import places, places_in_plane, readings_alone, readings_in_plane
from scan3d.reconstruction.errors import felt
from scan3d.recording import FORCE_SIGMAS, SIX_AXES, Noise, Recording, as_stated, of_checked, reaction_columns
from scan3d.rigs import check_positions
from scan3d.rods import Rod
from scan3d.units import UNITS_M

State = Literal["unknown", "air", "touching", "ringing"]
# Rows in which a rod that rings is recognised: eight periods of the rows in which it is looked for.  Of a clamp that stands
# still in the air as many are kept.
_WINDOW = 64
# Rows by which the zero of a sensor is found, and its noise to 7 %.
_AIR = 100
_FIRST = np.zeros(1, dtype=np.intp)
# Turn in radians, and way in rod lengths, by which the clamp leaves the plane of a sweep.
_APART = 1e-3


@dataclass(frozen=True)
class LiveContact:
    """The contact of one row; lengths in the unit of `Live`, in the world."""

    t_s: float
    point: Array
    """(3,) of the rod's centre line, or on the bead."""
    covariance: Array
    """(3, 3) of the point by the noise of wrench and pose; zero where none is stated or found."""
    normal: Array
    """(3,) of the body in the plane of the sweep, outward, by the planar model; NaN where a row does not tell it."""
    friction: float
    """Its coefficient by the planar model; NaN where a row does not tell it."""
    phase: planar.Phase
    force_N: float
    state: State = "touching"


class Live:
    """Contacts, row by row, of a rig.

    The zero of a sensor is that of the first rows, in which the rod must hang free.  `state` says what the last row was:

    unknown
        the zero is not known yet, a value is missing, or the force is that of no single contact of the rod;
    air
        no force stands out from the noise;
    touching
        a contact;
    ringing
        the rod swings about its rest after it has come off.
    """

    def __init__(
        self,
        rig: str | Path | Calibration | Recording,
        *,
        model: Model | None = None,
        air_rows: int | None = None,
        noise: tuple[float, float] | None = None,
        lowpass_hz: float | None = None,
        unit: str | None = None,
    ) -> None:
        """
        rig
            a calibration, whose sensor and clamp correct the rows, or a recording, whose rows are those of the clamp and tared;
            or the TOML file of one of both.
        model
            'planar' reads fx, fy and mz, 'spatial' all six channels; by default what a recording has, and else six.
        air_rows
            the first rows, whose mean is the sensor's zero; 100 with a calibration, and none with a recording.
        noise
            standard deviations of the clamp's force and moment in N and N m; by default those in the rows in the air, or those
            that are stated.
        lowpass_hz
            limit of a low-pass, which delays the wrench by some 0.2 / lowpass_hz seconds; needs rows in the air, which tell
            the rate.
        unit
            of points; that of the recording by default, or mm.

        Raises InputError for files and values that can't be used.
        """
        in_plane = isinstance(rig, Recording) and not rig.six_axis
        model = model or ("planar" if in_plane else "spatial")
        check_choice("model", model, MODELS)
        if noise is not None and np.shape(noise) != (2,):
            raise InputError(f"noise is two numbers, of force and of moment, in N and N m; got {noise!r}")
        self._calibration, fields = _of_rig(rig)
        count = air_rows if air_rows is not None else _AIR if self._calibration is not None else 0
        check_whole("air_rows", count, 0)
        if count:
            _check_light(fields["rod"])
        if lowpass_hz is not None and not (count >= _AIR // 4 and lowpass_hz > 0):
            raise InputError(f"lowpass_hz must be above 0, and needs air_rows of at least {_AIR // 4}")
        self.model = model
        self._air_rows, self._lowpass_hz = count, lowpass_hz
        self._noise = None if noise is None else (noise[0], noise[1])
        if unit is not None:
            fields["unit"] = unit
        self._like = Recording(
            sweep=np.zeros(1, dtype=np.int64),
            position_m=np.zeros((1, 3)),
            quaternion=np.array([[1.0, 0.0, 0.0, 0.0]]),
            **reaction_columns(np.zeros((1, 3)), np.zeros((1, 3)), model == "spatial"),
            **fields,
        )
        self.state: State = "unknown"
        """What the last row was."""
        self._time = -np.inf
        self._zero: Array | None = None
        self._filter: tuple[Array, Array] | None = None
        self._rows: list[Recording] = []
        self._last: deque[Array] = deque(maxlen=_WINDOW)
        self.last_row: Recording | None = None
        """The last row, as a recording of one: tared and corrected; None before there is one."""
        self._sweep, self._begin, self._touched, self._pressed = -1, self._like, False, False
        self._from, self._going = self._like.position_m[0], np.zeros(2, dtype=bool)
        self._waiting_rows: list[Recording] = []
        self._after = 0  # rows in the air since the last one that was pressed, of those that are kept
        self.contacts: list[LiveContact] = []
        """The contacts so far."""
        self._begin_zero()

    def __repr__(self) -> str:
        return f"Live: {self.state}, {len(self.contacts)} contacts as they came"

    def tare(self) -> None:
        """Find the zero again, in as many rows that follow as `air_rows`, or 100; the rod must hang free.

        Raises InputError for a rod with a weight, with which the zero turns.
        """
        _check_light(self._like.rod)
        self._air_rows = self._air_rows or _AIR
        self._begin_zero()

    def _begin_zero(self) -> None:
        self._waiting: list[tuple[float, Array]] = []
        self._filter = None
        self._zero = None if self._air_rows else np.zeros(6)
        if not self._air_rows:
            stated, known = self._like, self._calibration
            noise = self._noise or (stated.noise_force_N, stated.noise_moment_Nm)
            if known is not None and self._noise is None:
                noise = (
                    known.noise_force_N,
                    known.moment_noise(known.noise_force_N, known.noise_moment_Nm, imported=False),
                )
            self._take(noise)

    def push(
        self, t: float, position: ArrayLike, quaternion: ArrayLike, wrench: ArrayLike, sweep: int | None = None
    ) -> LiveContact | None:
        """The contact of one row, if there is one; `state` says what the row was.

        t
            seconds.
        position, quaternion, wrench
            (3,) in metres, (4,) w first, and (6,) force and moment in N and N m; of the planar model (3,) fx, fy and mz.
        sweep
            number of the sweep; by default each touch is one, with the rows in the air in its plane before and after it, and
            rows in the air between two planes are not kept, nor all while the clamp stands still in the air.

        Raises InputError for other shapes, quaternions without unit length, times before that of the last row, numbers that no
        rig has, and rods that probe but are curved, or have a bead in the planar model; the row is not kept.
        """
        if sweep is not None:
            check_whole("sweep", sweep, 0)
        place, turn, shown = self._checked(t, position, quaternion, wrench)
        if not all(map(np.isfinite, (t, place.sum(), turn.sum(), shown.sum()))):
            self.state = "unknown"
            return None
        if t < self._time:
            raise InputError(
                f"the time {t:.6g} s is before that of the row before, {self._time:.6g} s; push rows in their order"
            )
        if (largest := float(np.abs(shown).max())) > LARGEST:
            raise InputError(f"the wrench holds {largest:.3g}; check its unit, which is N and N m")
        check_positions("the row", place[None], self._like.rod.length_m)
        self._time = t
        if self._zero is None:
            self.state = "unknown"
            self._wait(t, shown)
            return None
        tared = (shown - self._zero)[None]
        if self._filter is not None:
            tared = self._filtered(tared)
        force, moment, place, turn = tared[:, :3], tared[:, 3:], place[None], turn[None]
        if self._calibration is not None:
            force, moment, place, turn = self._calibration.corrected(tared, place, turn, imported=False)
        row = of_checked(
            self._like,
            position_m=place,
            quaternion=turn,
            **reaction_columns(force, moment, self.model == "spatial"),
        )
        self._last.append(np.concatenate([force[0], moment[0]]))
        return self._judged(t, row, sweep)

    def _judged(self, t: float, row: Recording, sweep: int | None) -> LiveContact | None:
        """The contact of a row that is tared and corrected; it is kept."""
        pressed = bool(felt(row.pressing(self.model == "spatial"), row.noise.of_reactions(row.rod))[0])
        rings = pressed and self._rings()
        if rings:
            row = of_checked(row, **reaction_columns(np.zeros((1, 3)), np.zeros((1, 3)), self.model == "spatial"))
        rows = self._in_sweeps(row, pressed) if sweep is None else [row]
        if sweep is not None:
            row.__dict__["sweep"] = np.array([sweep])
            # rows without a number that follow are of another sweep
            self._sweep, self._pressed = max(self._sweep, sweep), pressed
            if not self._rows or self._rows[-1].sweep[0] != sweep:
                self._begin = row
            self._touched, self._waiting_rows = False, []
        contact = None
        if not pressed:
            self.state = "air"
        elif rings:
            self.state = "ringing"
        else:
            probed = row.rod.bead_diameter_m or self._probes(row)
            contact = _probed(t, row, self.model, len(self.contacts) + 1) if probed else _contact(t, row, self.model)
            self.state = "unknown" if contact is None else "touching"
            self.contacts += [] if contact is None else [contact]
        self._rows += rows
        self._after = 0 if pressed or sweep is not None else self._after + len(rows)
        self._after -= self._thinned(self._rows, self._after)
        self.last_row = row
        return contact

    def _in_sweeps(self, row: Recording, pressed: bool) -> list[Recording]:
        """The rows up to this one that are now known to belong to a sweep: a touch, with what is in the air on its way before
        and after it.  Rows on the way to another sweep belong to none."""
        along = self._begin.axes()[0, 2]
        turned = float(np.abs(row.axes()[0, 2] - along).max())
        moved = abs(float((row.position_m[0] - self._begin.position_m[0]) @ along))
        length, error = row.rod.length_m, FORCE_SIGMAS * row.noise_pose_m
        elsewhere = turned > _APART + error / length or moved > _APART * length + error
        # a rod leaves what it has probed as it came, and its force may be lost among the noise in single rows
        probed = self._touched and self._probes(row)
        step = row.position_m[0] - self._from
        if (way := float(np.linalg.norm(step))) > error / OFF_LINE:
            # a sweep goes along -x of the clamp, and a probing along y
            ahead, straight = (row.axes()[0, :2] @ step) * (-1, 1), np.sqrt(1 - OFF_LINE**2) * way
            going = ahead >= straight
            elsewhere = elsewhere or not ((going & self._going).any() or (probed and -ahead[1] >= straight))
            self._from, self._going = row.position_m[0], going
        begins, self._pressed = pressed and not self._pressed, pressed
        if (elsewhere and not (pressed and self._touched)) or (begins and self._touched and not probed):
            self._begin, self._touched, self._waiting_rows = row, False, []
        if not (pressed or (self._touched and not probed)):
            self._waiting_rows.append(row)
            self._thinned(self._waiting_rows, len(self._waiting_rows))
            return []
        rows = [*self._waiting_rows, row]
        self._sweep += not self._touched
        self._touched, self._waiting_rows = True, []
        for one in rows:
            one.__dict__["sweep"] = np.array([self._sweep])
        return rows

    def _probes(self, row: Recording) -> bool:
        """Whether the sweep is a probing as far as this row, as `Recording.in_probings` has it of all rows."""
        moved = self._begin.axes()[0] @ (row.position_m[0] - self._begin.position_m[0])
        return bool(moved[1] > max(np.hypot(moved[0], moved[2]), FORCE_SIGMAS * row.noise_pose_m))

    def _thinned(self, rows: list[Recording], count: int) -> bool:
        """Whether a row was taken out of the last ones in the air, so many, because the clamp stands still since the row before
        it: a rod that is parked would fill the memory, and such rows say nothing new."""
        if count <= _WINDOW:
            return False
        first, last = rows[-1 - _WINDOW], rows[-1]
        error = FORCE_SIGMAS * last.noise_pose_m  # what is kept shows the way up to the errors of the poses
        moved = float(np.linalg.norm(last.position_m - first.position_m))
        turned = float(np.abs(last.axes() - first.axes()).max())
        if moved > error or turned * last.rod.length_m > error:
            return False
        del rows[-_WINDOW]
        return True

    def _checked(
        self, t: float, position: ArrayLike, quaternion: ArrayLike, wrench: ArrayLike
    ) -> tuple[Array, Array, Array]:
        try:
            place, turn, shown = (np.asarray(values, dtype=np.float64) for values in (position, quaternion, wrench))
            float(t)
        except (TypeError, ValueError) as error:
            raise InputError(f"a row is made of numbers: {error}") from None
        if shown.shape == (3,) and self.model == "planar" and self._calibration is None:
            fx, fy, mz = shown
            shown = np.array([fx, fy, 0.0, 0.0, 0.0, mz])
        if place.shape != (3,) or turn.shape != (4,) or shown.shape != (6,):
            raise InputError(
                "a row has a position (3,), a quaternion (4,) and a wrench (6,), or (3,) with fx, fy and mz in the planar "
                f"model without a calibration; got {place.shape}, {turn.shape} and {shown.shape}"
            )
        if abs(float(np.sqrt(turn @ turn)) - 1) > 1e-3:  # as in a recording; NaN is a row without a pose
            raise InputError(f"the quaternion must have the length 1, w first, got {turn.tolist()}")
        return place, turn, shown

    def _wait(self, t: float, shown: Array) -> None:
        """Collect rows in the air, until zero, noise and rate are known."""
        if len(self._waiting) < self._air_rows:  # rows after an error may be those of a touch
            self._waiting.append((t, shown))
        if len(self._waiting) < self._air_rows:
            return
        times, rows = np.array([row[0] for row in self._waiting]), np.array([row[1] for row in self._waiting])
        zero = rows.mean(axis=0)
        tared = rows - zero
        if self._lowpass_hz is not None:
            tared = self._begun(times, tared)
        deviation = tared.std(axis=0, ddof=1) if len(tared) > 1 else np.zeros(6)
        deviation = np.maximum(deviation, ROUNDING * np.abs(zero))  # of rows that are all the same
        force, moment = float(deviation[:3].max()), float(deviation[3:].max())
        if self._calibration is not None:
            moment = self._calibration.moment_noise(force, moment, imported=False)
        self._take(self._noise or (force, moment))
        self._zero = zero

    def _take(self, noise: tuple[float, float]) -> None:
        """Rows have these standard deviations from now on."""
        force, moment = noise
        independent = self._like.noise_independent and self._lowpass_hz is None
        stated = Noise(force, moment, self._like.noise_pose_m, place_m=0.0, independent=independent)
        self._like = of_checked(
            self._like, noise_force_N=force, noise_moment_Nm=moment, noise_independent=stated.independent
        )
        self._like = as_stated(self._like, stated)

    def _begun(self, times: Array, tared: Array) -> Array:
        """Begin the low-pass with rows in the air (n, 6): the second half of them, after it."""
        from scipy.signal import butter, sosfilt  # its import takes half a second

        rate = (len(times) - 1) / float(times[-1] - times[0]) if times[-1] > times[0] else 0.0
        limit = float(self._lowpass_hz or 0.0)
        if not 2 * limit < rate:
            raise InputError(
                f"the rows come at {rate:.4g} Hz, and lowpass_hz must be below half of that, got {limit:g}"
            )
        sections = butter(2, limit, fs=rate, output="sos")
        filtered, left = sosfilt(sections, tared, axis=0, zi=np.zeros((len(sections), 2, 6)))
        self._filter = sections, left
        return np.asarray(filtered[len(filtered) // 2 :])

    def _filtered(self, tared: Array) -> Array:
        from scipy.signal import sosfilt

        assert self._filter is not None
        sections, left = self._filter
        filtered, left = sosfilt(sections, tared, axis=0, zi=left)
        self._filter = sections, left
        return np.asarray(filtered)

    def _rings(self) -> bool:
        """Whether the last row belongs to a swing about zero."""
        rows, noise = np.array(self._last), self._like.noise
        across = rows[:, [0, 2]]
        strongest = across[:, int(np.argmax(np.abs(across).max(axis=0)))]
        signs = np.sign(strongest[np.abs(strongest) > FORCE_SIGMAS * noise.force_N])
        if np.count_nonzero(np.diff(signs)) < 4:  # in two periods; a sweep has one sign, but for its end
            return False
        deviations = np.repeat([noise.force_N, noise.moment_Nm], 3)
        return bool(ringing(rows, deviations, np.zeros(len(rows), dtype=np.int64))[-1])

    @property
    def recording(self) -> Recording:
        """The rows of sweeps so far, tared and corrected; those that ring have no wrench."""
        names = ["sweep", "position_m", "quaternion", "force_N", "moment_Nm"]
        names += SIX_AXES if self.model == "spatial" else []
        if not self._rows:
            return of_checked(self._like, **{name: getattr(self._like, name)[:0] for name in names})
        columns: dict[str, Any] = {name: np.concatenate([getattr(row, name) for row in self._rows]) for name in names}
        # after `tare` rows have another noise, and the larger one holds for all
        columns |= {
            name: max(getattr(row, name) for row in self._rows) for name in ("noise_force_N", "noise_moment_Nm")
        }
        found = of_checked(self._rows[-1], **columns)
        noise = found.noise._replace(force_N=found.noise_force_N, moment_Nm=found.noise_moment_Nm)
        return as_stated(found, noise)

    @property
    def unit(self) -> str:
        """The unit of points."""
        return self._like.unit

    @property
    def cloud(self) -> Cloud:
        """The contacts so far as `scan3d.reconstruct` finds them in all rows."""
        with suppress(NoContactError):
            if self._rows:
                return reconstruct(self.recording, model=self.model)
        length = self._like.rod.length_m / UNITS_M[self.unit]
        return Cloud.of_places(np.empty((0, 3)), unit=self.unit, rod_length=length, model=self.model)


def _check_light(rod: Rod) -> None:
    if rod.weight_N:
        raise InputError(
            "the zero of a sensor that carries a rod with a weight turns with it: tare the rows, air_rows=0"
        )


def _of_rig(rig: str | Path | Calibration | Recording) -> tuple[Calibration | None, dict[str, Any]]:
    """The calibration, if it is one, and the fields of its recordings."""
    if isinstance(rig, (str, Path)):
        if {"sensor", "clamp"} & read_section(rig, "rig, or TOML file of a recording").data.keys():
            rig = read_rig(rig)
        else:
            return None, read_settings(rig)
    if isinstance(rig, Calibration):
        if rig.channels:
            raise InputError(
                "the rig has the matrix of a sensor's signals, and rows have forces: push the clamp's wrenches that follow by "
                "the matrix, with a recording that was imported by this rig, or its TOML file, in the place of the rig"
            )
        return rig, {"rod": rig.rod, "noise_pose_m": rig.pose_noise_m, "rig": rig.uncertainty()}
    if not isinstance(rig, Recording):
        raise InputError(f"a rig is a calibration, a recording, or the TOML file of one, got {type(rig).__name__}")
    if rig.completed is not None:
        raise InputError("the recording has a channel that was not measured, which needs the whole recording")
    names = (
        *("rod", "rig", "gravity", "unit", "table_m", "source"),
        *("noise_force_N", "noise_moment_Nm", "noise_pose_m", "noise_independent"),
    )
    return None, {name: getattr(rig, name) for name in names}


def _probed(t: float, row: Recording, model: str, among: int) -> LiveContact | None:
    """The contact of a recording of one row of a probing, one of so many."""
    try:
        found = probings.contacts(row, model, among)
    except NoContactError:
        return None
    nothing, force = np.full(3, np.nan), float(found.force_N[0])
    covariance = np.zeros((3, 3)) if found.covariance is None else found.covariance[0]
    return LiveContact(t, found.points[0], covariance, nothing, np.nan, planar.Phase.TIP, force)


def _contact(t: float, row: Recording, model: str) -> LiveContact | None:
    """The contact of a recording of one row of a sweep."""
    nothing = np.full(3, np.nan)
    if model == "spatial":
        known = readings_alone(row)
        if not known.touching[0]:
            return None
        points, covariance = places(row, known, _FIRST)
        covariance = np.zeros((1, 3, 3)) if covariance is None else covariance
        force = float(np.linalg.norm(known.found.force, axis=1)[0]) * row.rod.force_unit_N
        return LiveContact(t, points[0], covariance[0], nothing, np.nan, planar.Phase(int(known.found.phase[0])), force)
    read = readings_in_plane(row)
    if not read.touching[0]:
        return None
    points, covariance = places_in_plane(row, read.found, read.error, _FIRST)
    return LiveContact(
        t,
        points[0] / UNITS_M[row.unit],
        covariance[0],
        read.found.normal[0] @ row.axes()[0, :2],
        float(read.found.friction[0]),
        planar.Phase(int(read.found.phase[0])),
        float(read.found.force[0]) * row.rod.force_unit_N,
    )
