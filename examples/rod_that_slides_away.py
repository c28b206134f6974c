"""How long does a round rod stay in the slice in which it is swept, and what does friction do about it?

A rod in the mirror plane of a body has no reason to leave it.  But a bent rod that turns by a little about the clamp's axis
moves off a strongly curved body, and its energy falls: the planar sweep is laterally stable only while

    x1 - x0 < R_z sin α̃,                                                                        (S23)

with the body's radius of curvature R_z across the plane; on a sphere while x0 > x_c, for exactly half of the sweep.  Past
that a rod without friction slides away from the plane at once.  Friction does not hold it, it slows it: along the path σ on
which the rod slips over the body a deviation z of the contact, of a clamp at z0, grows nearly as

    dz/dσ = (z / R_z - (z - z0) sin α / ((x1 - x0) cos ζ)) / μ.

(a) the deviation of the contact on a sphere over that of the clamp, without friction and with it; dashed: the estimate.
(b) the inverse of it, without friction, on ellipsoids that are low and high across the plane: it falls to zero where the sweep
becomes unstable; circles: the limit by (S23).

Lengths are in rod lengths L.

    python examples/rod_that_slides_away.py [--out FILE]

Reference: equation (S23) in the manual's page "The model".
"""

import argparse
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from matplotlib import rc_context
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from paper_figure_3 import STYLE

import planar
from scan3d.spatial.bodies import Ellipsoid
from scan3d.spatial.sweeping import sweep

CENTER = (0.0, 1.3, 0.0)
SPHERE = (0.9, 0.9, 0.9)
# The semi-axis across the plane over that along the sweep: the lower the body, the earlier the limit.
RATIOS = (0.6, 0.8, 1.0, 1.1)
FRICTIONS = (0.3, 0.6)
# Height of the clamp above the mirror plane: so small that the deviation is proportional to it.
Z0 = 1e-6
# Base positions, from before touch-down until shortly before the planar snap-off.
X0 = np.linspace(0.87, -1.2, 346)
# Steps from sample to sample with friction, in proportion to which its error falls: at the end the deviation is 3 % off.
SUBSTEPS = 2
COLORS = ("#0072B2", "#009E73", "#D55E00", "#CC79A7")


def deviations(
    semi_axes: Sequence[float], frictions: Sequence[float], until: float = X0[-1], substeps: int = 1
) -> np.ndarray:
    """(k, n) the deviation of the contact from the mirror plane over that of the clamp, a row for every friction.

    NaN past the base position `until`.
    """
    base, k = X0[until <= X0], len(frictions)
    position = np.stack(np.broadcast_arrays(base, 0.0, np.full((k, 1), Z0)), axis=-1)
    body, axes = Ellipsoid(semi_axes, CENTER), np.tile(np.eye(3), (k, 1, 1))
    swept = sweep(body, position, axes, np.array(frictions), substeps=substeps)
    return np.hstack([swept.point[:, :, 2] / Z0, np.full((k, len(X0) - len(base)), np.nan)])


def estimate(friction: float) -> np.ndarray:
    """(n,) the deviation on the sphere over that of the clamp, by the slip path of the planar sweep."""
    flat = planar.sweep(planar.Circle(SPHERE[0], CENTER[:2]), friction, base=X0)
    # slip of the rod's material point, (S18): along the tangent in tangential contact, along the contour at the tip
    tangent = np.stack([np.cos(flat.slope), np.sin(flat.slope)], axis=1)
    moved = (np.diff(flat.point, axis=0) * tangent[1:]).sum(axis=1)
    slip = np.abs(moved - np.diff(flat.s1) * (flat.phase[1:] == planar.Phase.TANGENTIAL))
    force = np.hypot(flat.f0x, flat.f0y)
    sine = -flat.f0x / force  # of α: the force is f (sin α, -cos α)
    stiffness = sine / ((flat.point[:, 0] - flat.x0) * np.cos(np.arctan(friction)))
    z = np.where(np.isfinite(stiffness), 1.0, np.nan)
    for k in np.flatnonzero(np.isfinite(slip)) + 1:  # implicit, because it is stiff after touch-down
        step = slip[k - 1] / friction
        z[k] = (z[k - 1] + step * stiffness[k]) / (1 + step * (stiffness[k] - 1 / SPHERE[2]))
    return z


def stability_limit(ratio: float) -> float:
    """The base position at which the planar sweep without friction becomes unstable, by (S23), from the planar sweep alone."""
    flat = planar.sweep(planar.Circle(SPHERE[0], CENTER[:2]), 0.0, base=X0)
    margin = ratio**2 * flat.point[:, 0] - (flat.point[:, 0] - flat.x0)
    k = int(np.flatnonzero((margin[1:] < 0) & (flat.phase[1:] == planar.Phase.TANGENTIAL))[0])
    return float(X0[k] + (X0[k + 1] - X0[k]) * margin[k] / (margin[k] - margin[k + 1]))


def measured_limit(inverse: np.ndarray) -> float:
    """The base position at which ``z0 / z`` (n,) of a sweep in space falls to zero, extrapolated from its last values."""
    k = int(np.flatnonzero((inverse[:-1] > 0) & ~(inverse[1:] > 0))[0])
    return float(X0[k] + (X0[k] - X0[k - 1]) * inverse[k] / (inverse[k - 1] - inverse[k]))


ON_SPHERE = dict(zip(FRICTIONS, deviations(SPHERE, FRICTIONS, substeps=SUBSTEPS), strict=True))
ESTIMATES = {friction: estimate(friction) for friction in FRICTIONS}
# Without friction, until one sample past the limit: from there the rod snaps aside.
LIMITS = [stability_limit(ratio) for ratio in RATIOS]
INVERSE = [
    1 / deviations((0.9, 0.9, 0.9 * ratio), (0.0,), until=limit + X0[1] - X0[0])[0]
    for ratio, limit in zip(RATIOS, LIMITS, strict=True)
]
MEASURED = [measured_limit(inverse) for inverse in INVERSE]


def draw() -> Figure:
    """The figure, two columns of a page wide."""
    with rc_context(STYLE):
        figure = Figure(figsize=(7.2, 3.3), layout="constrained")
        growth, limit = figure.subplots(1, 2)
        draw_growth(growth)
        for ratio, inverse, expected, color in zip(RATIOS, INVERSE, LIMITS, COLORS, strict=True):
            limit.plot(X0, np.where(expected < X0, inverse, np.nan), color=color, label=f"$C/A = {ratio:g}$")
            limit.plot(expected, 0.0, "o", color=color, mfc="none", clip_on=False, zorder=3)
        limit.set(xlabel="$x_0\\;/\\;L$", ylabel="$z_0\\;/\\;z$", ylim=(0, 1.05), xlim=(0.9, -0.4))
        limit.legend(loc="upper right")
        for axes, title in ((growth, "(a)"), (limit, "(b)")):
            axes.set_title(title, loc="left")
    return figure


def draw_growth(axes: Axes) -> None:
    """The deviation on the sphere over the base position; without friction as far as the sweep is stable."""
    axes.axvspan(0.0, X0[-1], color="0.94", lw=0)
    frictionless = 1 / INVERSE[RATIOS.index(1.0)]
    axes.plot(X0[X0 > 0], frictionless[X0 > 0], color="black", label=r"$\mu = 0$")
    for friction, color in zip(FRICTIONS, COLORS, strict=False):
        axes.plot(X0, ON_SPHERE[friction], color=color, label=rf"$\mu = {friction:g}$")
        axes.plot(X0, ESTIMATES[friction], color=color, linestyle="--", linewidth=0.8)
    axes.text(-0.07, 0.75, "unstable", va="center")
    axes.set(xlabel="$x_0\\;/\\;L$", ylabel="$z\\;/\\;z_0$", yscale="log", xlim=(0.9, -1.25), ylim=(0.6, 150))
    axes.legend(loc="upper left")


def main(arguments: Sequence[str] | None = None) -> None:
    parser = argparse.ArgumentParser(description="Figure of a rod that slides out of its slice.")
    parser.add_argument("--out", type=Path, default=Path(Path(__file__).with_suffix(".png").name))
    given = parser.parse_args(arguments)
    for friction in FRICTIONS:
        grown, estimated = ON_SPHERE[friction][-1], ESTIMATES[friction][-1]
        print(
            f"friction {friction:g}: a deviation grows {grown:.3g} times up to x0 = {X0[-1]:g}, estimated {estimated:.3g}"
        )
    for ratio, expected, measured in zip(RATIOS, LIMITS, MEASURED, strict=True):
        print(f"C/A = {ratio:g}: unstable from x0 = {measured:+.4f}, by (S23) from {expected:+.4f}")
    draw().savefig(given.out, dpi=150)


if __name__ == "__main__":
    main()
