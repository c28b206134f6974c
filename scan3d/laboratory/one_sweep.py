"""One sweep in one plane: a table of base positions and support reactions, and the contacts that follow from them.

The table is dimensionless or in SI units, by the names of its columns.  A TOML file of the same name in the same folder may
contain the rod, the noise, and what is known in the place of a reaction that was not measured.
"""

from __future__ import annotations

import re
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

import planar
from planar.reconstruction import contacts_with_errors
from scan3d.arrays import Array, Mask
from scan3d.errors import InputError
from scan3d.files.columns import check_single
from scan3d.files.recordings import read_known, sidecar
from scan3d.files.tables import Table, read_table
from scan3d.files.text import read_rod, read_section, rows_as_text
from scan3d.reconstruction.errors import LARGEST_TOLERANCE, contact_tolerance
from scan3d.recording import FORCE, FORCE_SIGMAS, IN_PLANE, REACTIONS, Known, rounding_sd, together
from scan3d.rods import Rod
from scan3d.units import number
from scan3d.unmeasured import gaps, of_all, sentence

COLUMNS = ("x0", "f0x", "f0y", "m0z")
"""Base position and support reactions in rod lengths, EI/L² and EI/L."""
SI_COLUMNS = ("x0_m", "f0x_N", "f0y_N", "m0z_Nm")


@dataclass(frozen=True)
class OneSweep:
    """Base positions and support reactions (n,) of one sweep, of which the frame is that of `planar`.

    They are in m, N and N·m if the rod is given, else in rod lengths, EI/L² and EI/L.  They are kept as they were recorded,
    because their digits tell how they were rounded.  One of the reactions, or both forces, may be None, if something is `known`
    in their place: of both forces the friction, in a sweep that begins with a small push against the side of the rod.
    Raises InputError for a table without rows, and for a base that moves and ends where it began.
    """

    x0: Array
    f0x: Array | None
    f0y: Array | None
    m0z: Array | None
    rod: Rod | None = None
    noise_force: float = 0.0
    """Standard deviation of each force component; 0 where it is not known."""
    noise_moment: float = 0.0
    """Standard deviation of the moment; 0 where it is not known."""
    known: Known | None = None

    def __post_init__(self) -> None:
        x0 = self.x0[np.isfinite(self.x0)]
        if not len(x0):
            raise InputError("the table has no row with a base position")
        if x0[0] == x0[-1] and np.ptp(x0):
            raise InputError(
                "the base position of a sweep must decrease or increase from the first row to the last one, or stay; "
                "cut a motion back and forth into two tables"
            )
        for noise in (self.noise_force, self.noise_moment):
            if not (np.isfinite(noise) and noise >= 0):
                raise InputError(f"the standard deviations of the noise must be finite and at least 0, got {noise:g}")

    def __len__(self) -> int:
        return len(self.x0)

    @property
    def units(self) -> tuple[float, float, float]:
        """The units (1) of length, force and moment, by which values are divided to make them dimensionless."""
        rod = self.rod
        return (rod.length_m, rod.force_unit_N, rod.moment_unit_Nm) if rod else (1.0, 1.0, 1.0)

    @property
    def direction(self) -> int:
        """The sign of the base's motion along x, from the first row to the last one; 0 if it stays."""
        x0 = self.x0[np.isfinite(self.x0)]
        return int(np.sign(x0[-1] - x0[0]))


@dataclass(frozen=True)
class SweepContacts:
    """Contacts (n,) of one sweep, one for every row, and their errors.

    Dimensionless: lengths are in rod lengths, angles in radians; values of rows without contact are NaN.
    """

    sweep: OneSweep
    contacts: planar.Contacts
    errors: planar.Errors
    """Standard deviations, 0 for exact data; those of slope and friction angle in tangential contact only."""
    noise: tuple[float, float]
    """Standard deviations of each force component in EI/L² and of the moment in EI/L, with those of their rounding."""
    undetermined: Mask
    """(n,) rows that touch, where two reactions and what is known in the place of the third leave several contacts open."""
    unmeasured: tuple[str, ...] = ()
    """Which rows were left out because something was not measured, in sentences."""

    @property
    def point_sd(self) -> Array:
        """(n, 2) standard deviations of the contact's x and y."""
        return np.asarray(np.sqrt(np.einsum("nii->ni", self.errors.point)))

    @property
    def friction_sd(self) -> Array:
        """(n,) standard deviation of the coefficient of friction, in tangential contact."""
        return np.asarray((1 + self.contacts.friction**2) * self.errors.friction_angle)

    @property
    def noisy(self) -> bool:
        """Whether errors of the reactions are known."""
        return max(self.noise) > 0

    @property
    def only_rounding(self) -> bool:
        """Whether the known errors are those of the rounding of the numbers alone."""
        return self.noisy and not max(self.sweep.noise_force, self.sweep.noise_moment)

    @property
    def touching(self) -> Mask:
        """(n,) whether the row gives a contact."""
        return np.asarray(self.contacts.status == planar.Status.OK)

    @property
    def tangential(self) -> Mask:
        """(n,) whether the contact is tangential."""
        return np.asarray(self.contacts.phase == planar.Phase.TANGENTIAL)


def is_sweep(path: str | Path) -> bool:
    """Whether a file is a table of one sweep, by the names in its first line; also if some of its columns are missing."""
    path = Path(path)
    if path.suffix.lower() != ".csv" or not path.is_file():
        return False  # the reader of recordings says what is wrong
    try:
        with open(path, "rb") as file:
            line = file.readline(1 << 16).decode("utf-8-sig")
    except (OSError, UnicodeDecodeError):
        return False
    names = {name.strip().strip('"') for name in re.split("[,;\t]", line)}
    return bool(names & {*COLUMNS, *SI_COLUMNS}) and not names & {"qw", "qx", "qy", "qz"}  # which a recording has


def read_sweep(
    path: str | Path, rod: Rod | None = None, noise_force: float | None = None, noise_moment: float | None = None
) -> OneSweep:
    """Read the table of one sweep, and its TOML file if there is one.

    rod
        of a table in SI units; by default that of the TOML file.
    noise_force, noise_moment
        standard deviations in the units of the table; by default those of the TOML file, and 0 without them.

    Raises InputError with the name of the file and the error in it.
    """
    path = Path(path)
    table = read_table(path)
    si = bool(set(SI_COLUMNS) & set(table.names))
    stated = _read_sidecar(sidecar(path), si)
    names = _columns(table, stated.get("known"))
    columns: list[Any] = [None if name is None else table.numbers(table.names.index(name), gaps=True) for name in names]
    given = {"rod": rod, "noise_force": noise_force, "noise_moment": noise_moment}
    stated |= {name: value for name, value in given.items() if value is not None}
    if rod is not None and not si:
        raise InputError(
            f"{path.name}: its columns are dimensionless and need no rod; with a rod they are {', '.join(SI_COLUMNS)}"
        )
    if si and stated.get("rod") is None:
        raise InputError(
            f"{path.name}: its columns are in SI units and need the rod: give --rod MATERIAL:DIAMETERxLENGTH, or a "
            f"section [rod] in {sidecar(path).name}"
        )
    try:
        return OneSweep(*columns, **stated)
    except InputError as error:
        raise InputError(f"{path.name}: {error}") from None


def _columns(table: Table, known: Known | None) -> list[str | None]:
    """The four columns of a table, None for the reaction that something known stands for.

    Raises InputError unless it has the others of one system of units, once.
    """
    names = table.names
    plain, si = ([name for name in columns if name in names] for columns in (COLUMNS, SI_COLUMNS))
    if plain and si:
        raise InputError(
            f"{table.name}: its header mixes dimensionless columns ({', '.join(plain)}) with columns in SI units "
            f"({', '.join(si)}); give all four in one system"
        )
    columns = SI_COLUMNS if si else COLUMNS
    missing = [name for name in columns if name not in names]
    if known is not None and not missing:
        raise InputError(f"{table.name}: its TOML file has [known], but the table has all of {', '.join(columns)}")
    forces = missing == list(columns[1:3]) and known is not None and known.friction is not None
    if missing and not forces and not (known is not None and len(missing) == 1 and missing[0] != columns[0]):
        separated = "; its columns must be separated by commas" if any(set(";\t") & set(name) for name in names) else ""
        instead = "; for one of the reactions friction or contact = 'tip' in [known] of its TOML file can stand"
        raise InputError(
            f"{table.name}: the header of one sweep lacks {', '.join(missing)}; expected {','.join(COLUMNS)} or "
            f"{','.join(SI_COLUMNS)}{separated or instead}"
        )
    check_single(table.name, names, columns)
    return [None if name in missing else name for name in columns]


def _read_sidecar(path: Path, si: bool) -> dict[str, Any]:
    """Rod, noise and what is known, in the TOML file beside a table, as `OneSweep` takes them; nothing without a file."""
    if not path.exists():
        return {}
    meta = read_section(path, "TOML file of the table")
    meta.any("schema")
    meta.notes("source")
    noise, names = meta.section("noise"), ("force_N", "moment_Nm") if si else ("force", "moment")
    force, moment = (noise.number(name, 0.0, at_least=0) for name in names)
    rod = read_rod(meta.section("rod")) if si and "rod" in meta else None
    if rod is not None and rod.bead_diameter_m:
        raise InputError(
            f"{path.name}: [rod] bead_diameter_m: a sweep in a plane is that of a rod without bead, which touches in probings "
            "with six axes only; leave it out if the tip has none"
        )
    known = read_known(meta.section("known")) if "known" in meta else None
    meta.finish(f" for a table that is {'in SI units' if si else 'dimensionless'}")
    return {"rod": rod, "noise_force": force, "noise_moment": moment, "known": known}


def reconstruct_sweep(sweep: OneSweep) -> SweepContacts:
    """The contacts of a sweep; those of a thick rod on the body's surface where the normal is known, else on the centre line.

    Errors of the reactions are the noise that the sweep states, and the rounding of its numbers.  Rows whose force does not
    stand out from them have no contact.  Raises InputError if no row has one.
    """
    in_length, in_force, in_moment = sweep.units
    columns = (sweep.f0x, sweep.f0y, sweep.m0z)
    rounding = [
        0.0 if column is None else rounding_sd(column[np.isfinite(column)], measured=True) for column in columns
    ]
    force = together(sweep.noise_force, max(rounding[:2])) / in_force
    moment = together(sweep.noise_moment, rounding[2]) / in_moment
    units = (in_force, in_force, in_moment)
    measured = [None if column is None else column / unit for column, unit in zip(columns, units, strict=True)]
    x0, rod = sweep.x0 / in_length, sweep.rod.in_plane() if sweep.rod else planar.Rod()
    alone = sweep.f0x is None and sweep.f0y is None
    sizes = [column for column in (measured[2:] if alone else measured[:2]) if column is not None]
    stands_out = np.linalg.norm(sizes, axis=0)
    felt = stands_out > FORCE_SIGMAS * max(force, moment)
    pushed = measured[2] if measured[2] is not None else -measured[0]  # type: ignore[operator]  # one is there at least

    def told(direction: int) -> tuple[planar.Contacts, planar.Errors, Mask]:
        """The contacts (n,) of a base that moves so, their errors, and whether all reactions are known."""
        names = dict(zip(REACTIONS, measured, strict=True))
        reactions = {name: np.zeros(len(sweep)) if column is None else column for name, column in names.items()}
        assumed: dict[str, Any] = {}
        if alone and sweep.known is not None:
            side, nothing = -direction, np.zeros(len(x0))
            forces, _, covariance = replace(sweep.known, channel=FORCE).follow(
                felt,
                np.zeros(len(x0), dtype=np.intp),
                np.column_stack([x0, nothing, nothing]),
                np.broadcast_to(np.diag([side, 1.0, side]), (len(x0), 3, 3)),
                np.column_stack([nothing, nothing, side * reactions["m0z"]]),
                moment,
                rod if side > 0 else rod.mirrored(),
            )
            mirror = np.array([side, 1.0, side])
            reactions["f0x"], reactions["f0y"] = side * forces[:, 0], forces[:, 1]
            assumed["covariance"] = covariance[:, IN_PLANE[:, None], IN_PLANE] * np.outer(mirror, mirror)
        for name in (
            name for name, column in names.items() if column is None and sweep.known is not None and not alone
        ):
            instead = replace(sweep.known or Known(), channel=name)
            reactions[name] = instead.complete(reactions, np.flatnonzero(felt), direction, rod)
            assumed = instead.errors
        f0x, f0y, m0z = reactions.values()
        common: dict[str, Any] = {"direction": direction, "rod": rod, "tolerance": LARGEST_TOLERANCE}
        wide, errors = contacts_with_errors(x0, f0x, f0y, m0z, noise=(force, moment), **common, **assumed)
        tolerance = planar.TOLERANCE if assumed else contact_tolerance(errors)
        return wide.within(tolerance, direction=direction), errors, np.isfinite(f0x + f0y + m0z)

    found, errors, complete = told(sweep.direction or -1)
    if not sweep.direction and (back := pushed < 0).any():  # touches from the other side
        other = told(1)
        both: dict[str, Any] = {name: _of(back, getattr(other[0], name), one) for name, one in vars(found).items()}
        found = replace(found, **both)
        errors = planar.Errors(*(_of(back, *columns) for columns in zip(other[1], errors, strict=True)))
        complete = np.where(back, other[2], complete)
    given = np.isfinite([column for column in (x0, *measured) if column is not None]).all(axis=0)
    undetermined = felt & given & ~complete
    left, words = _unmeasured(sweep, felt)
    # of a force that does not stand out no moment has a wrong sign
    hidden = ~felt | (left & (found.status == planar.Status.OK))
    found = found.refused(hidden, planar.Status.NO_FORCE)
    touching, tangential = found.status == planar.Status.OK, found.phase == planar.Phase.TANGENTIAL
    if not touching.any():
        codes, counts = np.unique(found.status[~undetermined], return_counts=True)
        reason = f"in {undetermined.sum()} of its {len(sweep)} rows the reactions measured leave the contact open"
        if len(counts) and counts.max() > undetermined.sum():
            most = planar.Status(int(codes[counts.argmax()]))
            reason = f"of {counts.max()} of its {len(sweep)} rows, {most.sentence}"
        raise InputError(f"the sweep has no contact: {reason}")
    if sweep.rod is not None and sweep.rod.diameter_m:
        radius = _kept(sweep.rod.radius_m(found.s1) / in_length, tangential)
        found = replace(found, point=found.point - np.nan_to_num(radius[:, None] * found.normal))
    of_slope = ("friction_angle", "slope")
    known = ((values, tangential if name in of_slope else touching) for name, values in errors._asdict().items())
    errors = planar.Errors(*(_kept(values, rows) for values, rows in known))
    return SweepContacts(sweep, found, errors, (force, moment), undetermined, words)


def _unmeasured(sweep: OneSweep, felt: Mask) -> tuple[Mask, tuple[str, ...]]:
    """The rows (n,) of a sweep in which something was not measured, and sentences on them; none where no noise is stated."""
    rows = np.zeros(len(sweep), dtype=bool)
    columns = dict(zip(REACTIONS, (sweep.f0x, sweep.f0y, sweep.m0z), strict=True))
    values = np.stack([column for column in columns.values() if column is not None], axis=1)
    known = np.flatnonzero(np.isfinite(values).all(axis=1) & np.isfinite(sweep.x0))
    if not max(sweep.noise_force, sweep.noise_moment) or not len(known):
        return rows, ()
    names = tuple(name for name, column in columns.items() if column is not None)
    found = gaps(values[known], ~felt[known], sweep.x0[known, None])
    rows[known] = of_all(found, len(known))
    shown, at = (lambda _, value: number(value)), (lambda k: f"row {known[k] + 1}")
    return rows, tuple(sentence(gap, len(known), shown, names, at) for gap in found)


def _kept(values: Array, rows: Mask) -> Array:
    """Values (n, ...) of some rows (n,), NaN in the others."""
    return _of(rows, values, np.nan)


def _of(rows: Mask, values: Array, others: Array | float) -> Array:
    """Values (n, ...) of some rows (n,), and others in the others."""
    return np.where(rows.reshape(-1, *[1] * (values.ndim - 1)), values, others)


def contacts_csv(found: SweepContacts) -> bytes:
    """The contacts as CSV, a line for every row of the sweep; cells of unknown values are empty.

    Lengths are in metres (``x_m``) if the sweep has a rod, else in rod lengths; angles are in radians.  Columns of standard
    deviations are there if errors are known.
    """
    contacts, rod = found.contacts, found.sweep.rod
    length, unit = (rod.length_m, "_m") if rod else (1.0, "")
    columns: dict[str, NDArray[Any]] = {
        f"x0{unit}": found.sweep.x0,
        f"x{unit}": length * contacts.point[:, 0],
        f"y{unit}": length * contacts.point[:, 1],
        f"s1{unit}": length * contacts.s1,
        "phase": np.array([planar.Phase(code).name.lower() for code in contacts.phase]),
        "status": np.array([planar.Status(code).name.lower() for code in contacts.status]),
        "friction_angle": contacts.friction_angle,
        "friction": contacts.friction,
        "slope": contacts.slope,
        "normal_x": contacts.normal[:, 0],
        "normal_y": contacts.normal[:, 1],
    }
    if found.noisy:
        columns |= {
            f"sd_x{unit}": length * found.point_sd[:, 0],
            f"sd_y{unit}": length * found.point_sd[:, 1],
            f"cov_xy{unit and '_m2'}": length**2 * found.errors.point[:, 0, 1],
            f"sd_s1{unit}": length * found.errors.s1,
            "sd_friction_angle": found.errors.friction_angle,
            "sd_friction": found.friction_sd,
            "sd_slope": found.errors.slope,
        }
    header = f"{','.join(columns)}\n".encode()
    return header + rows_as_text(columns.values()).replace(b"nan", b"")  # no word of a status holds these letters
