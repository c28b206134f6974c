"""Where does a rod touch a sphere that it passes off its equator, and which reactions does it have?

Without friction the rod bends in the plane through the clamp's axis and the sphere's centre, because the contact force points
from the centre to the contact.  So every state is one of the planar sweep along the great circle in that plane, at the offset
``√((x0 - x_c)² + z²)`` of the clamp's axis from the centre: the sweep in space is the planar sweep there and back.  The rod
slides over the sphere, to the side away from the equator, and leaves it without a force; the planar sweep's snap-off does not
happen.

(a) the contacts of sweeps at several heights, seen along the clamp's axis; (b) the contact force over the base position, and as
circles the force of the planar sweep along the great circle.

Lengths are in rod lengths L, forces in EI/L².

    python examples/sphere_off_equator.py [--out FILE]

Reference: equation (S24) in the manual's page "The model".
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

RADIUS, CENTER = 0.9, (0.0, 1.3, 0.0)
HEIGHTS = np.array([0.1, 0.3, 0.5, 0.7])
# Symmetric about the sphere's middle, and without the middle itself.
X0 = np.linspace(0.9, -0.9, 240)
# Every so many samples of the planar sweep are drawn as circles.
EVERY = 16
COLORS = ("#0072B2", "#009E73", "#D55E00", "#CC79A7")

# The sweeps in space, all at once.
POSITION = np.stack(np.broadcast_arrays(X0, 0.0, HEIGHTS[:, None]), axis=-1)
SWEPT = sweep(Ellipsoid((RADIUS,) * 3, CENTER), POSITION, np.tile(np.eye(3), (len(HEIGHTS), 1, 1)), 0.0)
FORCE = np.linalg.norm(SWEPT.force, axis=2)
OFFSET = np.hypot(X0, HEIGHTS[:, None])


def great_circle(offsets: np.ndarray) -> planar.Sweep:
    """The planar sweep along the great circle, at offsets (n,) of the clamp's axis from the centre in any order."""
    order = np.argsort(-offsets)
    swept = planar.sweep(planar.Circle(RADIUS, CENTER[:2]), 0.0, base=offsets[order])
    back = np.argsort(order)
    columns = {name: getattr(swept, name)[back] for name in planar.Sweep.__dataclass_fields__}
    return planar.Sweep(**columns)


PLANAR = [great_circle(offsets) for offsets in OFFSET]


def differences(number: int) -> dict[str, np.ndarray]:
    """What (S24) says of a sweep, as differences (n,) that vanish, by name; NaN where the rod does not touch."""
    flat, z = PLANAR[number], HEIGHTS[number]
    # away from the centre, seen along the clamp's axis
    outward = np.stack([X0, np.zeros_like(X0), np.full_like(X0, z)], axis=1) / OFFSET[number][:, None]
    force, moment, point = SWEPT.force[number], SWEPT.moment[number], SWEPT.point[number] - POSITION[number]
    side = np.cross(outward, (0.0, 1.0, 0.0))
    return {
        "force across": (force * outward).sum(axis=1) - flat.f0x,
        "force along": force[:, 1] - flat.f0y,
        "force out of the plane": (force * side).sum(axis=1),
        "moment": (moment * side).sum(axis=1) - flat.m0z,
        "contact across": (point * outward).sum(axis=1) - (flat.point[:, 0] - flat.x0),
        "contact along": point[:, 1] - flat.point[:, 1],
        "contact out of the plane": (point * side).sum(axis=1),
    }


LARGEST = max(float(np.nanmax(np.abs(values))) for k in range(len(HEIGHTS)) for values in differences(k).values())


def draw() -> Figure:
    """The figure, two columns of a page wide."""
    with rc_context(STYLE):
        figure = Figure(figsize=(7.2, 3.3), layout="constrained")
        paths, force = figure.subplots(1, 2)
        draw_paths(paths)
        for k, color in enumerate(COLORS):
            force.plot(X0, FORCE[k], color=color, label=f"$z = {HEIGHTS[k]:g}\\,L$")
            circles = np.hypot(PLANAR[k].f0x, PLANAR[k].f0y)
            force.plot(X0[::EVERY], circles[::EVERY], "o", color=color, mfc="none", ms=4)
        force.set(xlabel="$x_0\\;/\\;L$", ylabel="$f\\;/\\;(EI/L^2)$")
        force.invert_xaxis()  # the base moves in -x
        force.legend(loc="upper left")
        for axes, title in ((paths, "(a)"), (force, "(b)")):
            axes.set_title(title, loc="left")
    return figure


def draw_paths(axes: Axes) -> None:
    """The paths of the contacts, those of the clamps, and a few bending planes, seen along the clamp's axis."""
    angle = np.linspace(0, 2 * np.pi, 200)
    axes.fill(RADIUS * np.cos(angle), RADIUS * np.sin(angle), color="0.92")
    for k, color in enumerate(COLORS):
        axes.plot(X0[[0, -1]], [HEIGHTS[k]] * 2, color=color, linewidth=0.8, linestyle=":")
        x, z = SWEPT.point[k, :, 0], SWEPT.point[k, :, 2]
        axes.plot(x, z, color=color)
        for j in np.flatnonzero(np.isfinite(x))[:: 2 * EVERY]:
            axes.plot([X0[j], x[j]], [HEIGHTS[k], z[j]], color="0.5", linewidth=0.6)
    axes.plot(0.0, 0.0, "k.", markersize=4)
    axes.set(xlabel="$x\\;/\\;L$", ylabel="$z\\;/\\;L$", aspect="equal", xlim=(0.98, -0.98), ylim=(-0.1, 0.95))


def main(arguments: Sequence[str] | None = None) -> None:
    parser = argparse.ArgumentParser(description="Figure of a sphere swept off its equator.")
    parser.add_argument("--out", type=Path, default=Path(Path(__file__).with_suffix(".png").name))
    given = parser.parse_args(arguments)
    touching = np.isfinite(SWEPT.s1)
    print(f"{touching.sum()} states differ from those of the great circle by at most {LARGEST:.1e}")
    draw().savefig(given.out, dpi=150)


if __name__ == "__main__":
    main()
