"""The drawing of docs/rig.md: the clamp's frame, and the signs of the support reaction.

python docs/own_rig_figure.py [--out FILE]
"""

import argparse
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

import planar

HERE = Path(__file__).parent / "pictures" / "own_rig.png"
CONTOUR = planar.Circle(0.35, (0.0, 0.75))
BASE = np.array([0.05])  # of the state that is drawn
BLUE, RED, GREY = "#0072B2", "#D55E00", "0.55"


def draw() -> Figure:
    """One state of a sweep, seen against the clamp's z axis."""
    state = planar.sweep(CONTOUR, 0.3, base=BASE)
    lines = planar.elastic_lines(state.x0, state.f0x, state.f0y, state.m0z)
    figure = Figure(figsize=(6.2, 4.6), layout="constrained")
    axes = figure.subplots()
    axes.fill(*CONTOUR.points(np.linspace(-np.pi, np.pi, 200)).T, color="0.88")
    axes.text(-0.14, 0.78, "object", ha="center", color="0.4")
    x = float(BASE[0])
    axes.plot([x, x], [0, 1], ":", color=GREY)
    axes.text(x + 0.02, 1.11, "undeformed rod", color=GREY, ha="center")
    for part in (lines.curved[0], lines.straight[0]):
        axes.plot(*part.T, color="black", linewidth=2)
    axes.fill([x - 0.05, x + 0.05, x + 0.05, x - 0.05], [-0.1, -0.1, 0, 0], color="0.45")
    axes.text(x + 0.08, -0.09, "clamp")
    for tip, name in (((x + 0.3, 0.0), "x"), ((x, 0.3), "y")):
        arrow(axes, (x, 0.0), tip, BLUE)
        axes.text(tip[0] + 0.02, tip[1] + 0.02, f"${name}$", color=BLUE)
    axes.plot(x, 0, "o", color="white", markeredgecolor=BLUE, ms=9, zorder=5)
    axes.plot(x, 0, ".", color=BLUE, ms=4, zorder=6)
    axes.text(x + 0.12, -0.19, "$z$ towards the viewer", color=BLUE, fontsize=8)
    arrow(axes, (0.9, -0.1), (0.5, -0.1), "black")
    axes.text(0.7, -0.08, "sweep along $-x$", ha="center", va="bottom")
    force = 0.4 * np.array([state.f0x[0], state.f0y[0]]) / np.hypot(state.f0x[0], state.f0y[0])
    arrow(axes, (x, 0.0), (x + force[0], force[1]), RED)
    signs = [f"{name} {'<' if value < 0 else '>'} 0" for name, value in
             (("f_x", state.f0x[0]), ("f_y", state.f0y[0]), ("m_z", state.m0z[0]))]  # fmt: skip
    axes.text(-0.72, 0.2, "clamp on rod:\n$" + "$\n$".join(signs) + "$", color=RED, va="bottom")
    contact = state.point[0]
    arrow(axes, contact, contact - 0.6 * force, RED)
    axes.text(contact[0] + 0.27, contact[1] - 0.1, "object on rod", color=RED)
    axes.plot(*contact, "o", color=RED, ms=5)
    axes.set(xlim=(-0.8, 0.95), ylim=(-0.28, 1.2), aspect="equal")
    axes.axis("off")
    return figure


def arrow(axes: Axes, start: Sequence[float], end: Sequence[float], color: str) -> None:
    """An arrow from a place to another."""
    axes.annotate("", tuple(end), tuple(start), arrowprops={"arrowstyle": "-|>", "color": color, "linewidth": 1.8})


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description="The drawing of docs/rig.md.")
    parser.add_argument("--out", type=Path, default=HERE)
    draw().savefig(parser.parse_args().out, dpi=150)
