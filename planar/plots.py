"""Results as text, as tables of pandas, and as pictures by matplotlib; both are imported when they are first asked for."""

from __future__ import annotations

import html
import io
from collections.abc import Mapping, Sequence
from enum import IntEnum
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from planar.arrays import ROUNDING, Array, Index, Mask

if TYPE_CHECKING:
    import pandas
    from matplotlib.axes import Axes


class Explained(IntEnum):
    """Codes with a sentence that explains each: ``NAME = number, sentence``."""

    sentence: str

    def __new__(cls, value: int, sentence: str = "") -> Explained:
        member = int.__new__(cls, value)
        member._value_, member.sentence = value, sentence
        return member


class Shown:
    """A result that a notebook shows by what `repr` says of it and, where matplotlib is installed, by its picture."""

    _panels = 1  # axes that its `plot` takes

    def plot(self, *, axes: Any = None) -> Any:
        """The picture, on matplotlib's axes, by default new ones, which are returned."""
        raise NotImplementedError

    def _repr_html_(self) -> str:
        text = f"<p>{html.escape(repr(self))}</p>"
        try:
            from matplotlib.figure import Figure
        except ImportError:
            return text
        figure, file = Figure(figsize=(1 + 3 * self._panels, 3), layout="constrained"), io.StringIO()
        self.plot(axes=figure.subplots(1, self._panels, squeeze=False)[0])
        figure.savefig(file, format="svg")
        svg = file.getvalue()
        return text + svg[svg.index("<svg") :]


def words(values: NDArray[np.int8], kinds: type[IntEnum]) -> list[str]:
    """The names (n,) of coded values (n,)."""
    return [kinds(value).name.lower() for value in values.tolist()]


def counted(title: str, phase: NDArray[np.int8], kinds: type[IntEnum]) -> str:
    """How many samples there are, and how many of each phase."""
    counts = ", ".join(f"{np.count_nonzero(phase == kind)} {kind.name.lower()}" for kind in kinds)
    return f"{title}: {len(phase)} samples, {counts}"


def to_frame(columns: Mapping[str, Array | Sequence[str]]) -> pandas.DataFrame:
    """A data frame of the columns (n,) but those of NaN alone.  Raises ImportError without pandas."""
    try:
        import pandas
    except ImportError as error:
        raise ImportError(
            f"to_pandas needs pandas, which can't be imported ({error}): pip install 'scan3d[pandas]'"
        ) from None
    return pandas.DataFrame(
        {
            name: column
            for name, column in columns.items()
            if not len(column) or isinstance(column, list) or not np.isnan(column).all()
        }
    )


# which differ in lightness as well, for colour-blind readers
TIP_COLOR, TANGENTIAL_COLOR = "#d98200", "#b2182b"

_X0 = "$x_0\\;/\\;L$"
_LABELS = {
    "x0": _X0,
    "f0x": "$f_{0x}\\;/\\;(EI/L^2)$",
    "f0y": "$f_{0y}\\;/\\;(EI/L^2)$",
    "m0z": "$m_{0z}\\;/\\;(EI/L)$",
    "s1": "$s_1\\;/\\;L$",
    "force": "$f\\;/\\;(EI/L^2)$",
    "friction": "$\\mu$",
}
_ANGLES = {
    "slope": "$\\tilde\\alpha$ in degrees",
    "force_angle": "$\\alpha$ in degrees",
    "friction_angle": "$\\zeta$ in degrees",
    "friction_angle_bound": "$\\beta$ in degrees",
}


def _panels(count: int, axes: Axes | ArrayLike | None) -> Any:
    """The given axes as an array (count,), or new ones side by side.  Raises ValueError for another number of them."""
    if axes is None:
        from matplotlib import pyplot

        return pyplot.subplots(1, count, figsize=(1 + 3.2 * count, 3.2), layout="constrained", squeeze=False)[1][0]
    given = np.array(axes, dtype=object, ndmin=1).ravel()
    if len(given) != count:
        raise ValueError(f"axes must be {count} for as many columns, got {len(given)}")
    return given


def named(table: object, names: Sequence[str], known: Sequence[str]) -> dict[str, Array]:
    """Columns (n,) of a result by their names.  Raises ValueError for names that are not known."""
    if unknown := [name for name in names if name not in known]:
        raise ValueError(f"a column must be one of {', '.join(known)}, got {unknown[0]!r}")
    return {name: getattr(table, name) for name in names}


def plot_columns(
    columns: Mapping[str, Array],
    over: ArrayLike | None,
    phase: NDArray[np.int8],
    axes: Axes | ArrayLike | None,
    style: Any,
) -> Any:
    """For each column (n,) its curve over the base positions, or else the samples, with circles where the phase changes."""
    panels = _panels(len(columns), axes)
    place = np.arange(len(phase)) if over is None else np.asarray(over, dtype=float)
    if place.shape != phase.shape:
        raise ValueError(f"over must be {len(phase)} numbers, one for each sample, got an array of shape {place.shape}")
    changes = 1 + np.flatnonzero((np.diff(phase) != 0) & (phase[1:] > 0) & (phase[:-1] > 0))
    for panel, (name, values) in zip(panels, columns.items(), strict=True):
        shown = np.degrees(values) if name in _ANGLES else values
        (line,) = panel.plot(place, shown, **style)
        circles = {"color": line.get_color(), "markerfacecolor": "white", "markersize": 4}
        panel.plot(place[changes], shown[changes], "o", **circles)
        panel.set(xlabel="sample" if over is None else _X0, ylabel={**_LABELS, **_ANGLES}[name])
    return panels


def plot_points(point: Array, tip: Mask, tangential: Mask, axes: Axes | ArrayLike | None, style: Any) -> Any:
    """Contact points (n, 2) in the plane, those at the tip hollow; the phases have two colours, unless `style` has one."""
    panel = _panels(1, axes)[0]
    color = style.pop("color", None)
    kinds = (("at the tip", tip, TIP_COLOR, "none"), ("tangential", tangential, TANGENTIAL_COLOR, None))
    for label, rows, own, face in kinds:
        drawn = {"color": color or own, "markerfacecolor": face or color or own, "markersize": 3.5, "label": label}
        panel.plot(*point[rows].T, "o", **drawn | style)
    panel.set(xlabel="$x\\;/\\;L$", ylabel="$y\\;/\\;L$", aspect="equal")
    return panel


def plot_loops(loops: Sequence[Array], axes: Axes | ArrayLike | None, style: Any) -> Any:
    """Closed lines through points (n, 2) each."""
    panel = _panels(1, axes)[0]
    for points in loops:
        panel.plot(*np.concatenate([points, points[:1]]).T, **{"color": "black", **style})
    panel.set(xlabel="$x\\;/\\;L$", ylabel="$y\\;/\\;L$", aspect="equal")
    return panel


def plot_lines(curved: Array, straight: Array, axes: Axes | None, style: Any) -> Any:
    """Elastic lines (n, points, 2): of rods in tip contact in one colour, of others in a second one up to the contact."""
    panel = _panels(1, axes)[0]
    tip = np.linalg.norm(straight[:, 1] - straight[:, 0], axis=1) < ROUNDING
    for rows, color in ((tip, TIP_COLOR), (~tip, TANGENTIAL_COLOR)):
        panel.plot(*curved[rows].transpose(2, 1, 0), **{"color": color, "linewidth": 0.8, **style})
    panel.plot(*straight[~tip].transpose(2, 1, 0), **{"color": "black", "linewidth": 0.8, **style})
    panel.set(xlabel="$x\\;/\\;L$", ylabel="$y\\;/\\;L$", aspect="equal")
    return panel


def plot_events(x0: Array, m0z: Array, kinds: Mapping[str, Index], axes: Axes | None, style: Any) -> Any:
    """The clamping moment (e, 2) before (hollow) and after (filled) each event at x0 (e,), a mark for each kind of event."""
    panel = _panels(1, axes)[0]
    for (name, rows), mark in zip(kinds.items(), "osD^v", strict=True):
        if len(rows):
            panel.vlines(x0[rows], *m0z[rows].T, color="0.6", linewidth=0.8)
            (before,) = panel.plot(x0[rows], m0z[rows, 0], mark, **{"markerfacecolor": "none", **style})
            panel.plot(x0[rows], m0z[rows, 1], mark, **{"color": before.get_color(), "label": name, **style})
    panel.set(xlabel=_X0, ylabel=_LABELS["m0z"])
    panel.legend()
    return panel
