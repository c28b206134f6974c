"""What does friction do to the force and the moment at the clamp of a rod that sweeps along a circle?

Figure 3 of the paper: (a) elastic lines of a sweep without friction; (b)-(d) the support reactions for several coefficients
of friction, one of them random from sample to sample.  All panels are read from right to left, the direction in which the
base moves.

    python examples/paper_figure_3.py [FILE]

Reference: L. Merker, J. Steigenberger, C. Behn, Friction Invariant Object Reconstruction Using a Vibrissa-inspired Tactile
Sensor Concept, Figure 3, Section III-A.
"""

import sys
from pathlib import Path

import numpy as np
from matplotlib import rc_context
from matplotlib.figure import Figure

import planar

# The semi-circle (4) of Section III, in rod lengths.
CONTOUR = planar.Circle(radius=0.9, center=(0.0, 1.3))
SAMPLES = 100  # of the sweep with random friction, few enough for its scatter to be seen
LINES = 32  # elastic lines in panel (a), few enough to be distinguished

# Step 1: sweeps from touch-down to snap-off, the last one with a friction drawn separately for every sample.
FRICTIONS = [0.0, 0.2, 0.4, 0.6]
EVENTS = [planar.events(CONTOUR, mu) for mu in FRICTIONS]
BASE = np.linspace(EVENTS[-1].x0[0], EVENTS[-1].x0[-1], SAMPLES)
RANDOM = np.random.default_rng(3).uniform(0.0, 0.4, SAMPLES)


def to_snap_off(end: float) -> np.ndarray:
    """The base positions before the end of a sweep, and closely spaced ones near the end, where the curves become vertical."""
    return np.union1d(BASE[end < BASE], end + np.linspace(0.0, 0.2, 8) ** 2)[::-1]


SWEEPS = [
    planar.sweep(CONTOUR, mu, base=to_snap_off(events.x0[-1])) for mu, events in zip(FRICTIONS, EVENTS, strict=True)
]
SWEEPS.append(planar.sweep(CONTOUR, RANDOM, base=BASE))
LABELS = [*(rf"$\mu = {mu:g}$" for mu in FRICTIONS), r"random $\mu \in [0, 0.4]$"]
# Okabe and Ito's green, orange and red, which colour-blind readers can distinguish.
COLORS = ["black", "#009E73", "#E69F00", "#D55E00", "0.65"]

# The shapes of the rod in panel (a).
SWEEP = planar.sweep(CONTOUR, friction=0.0, samples=LINES)
ELASTIC_LINES = planar.elastic_lines(*SWEEP.reactions)

STYLE = {
    "font.family": "serif",
    "font.size": 9,
    "mathtext.fontset": "cm",
    "axes.labelsize": 11,
    "legend.fontsize": 9,
    "legend.frameon": False,
    "lines.linewidth": 1.1,
    "lines.markersize": 4.5,
}


def draw() -> Figure:
    """The figure, two columns of a page wide."""
    with rc_context(STYLE):
        figure = Figure(figsize=(7.2, 5.6), layout="constrained")
        shapes, *reactions = figure.subplots(2, 2).flat
        outline = CONTOUR.points(np.linspace(-np.pi / 2, np.pi / 2, 200)).T
        shapes.fill(*outline, color="0.9")
        ELASTIC_LINES.plot(axes=shapes)
        shapes.set(xlim=(-1.35, 1.05), ylim=(0.0, 1.4))
        for swept, color, label in zip(SWEEPS, COLORS, LABELS, strict=True):
            swept.plot(axes=reactions, color=color, label=label, zorder=1.9 if swept is SWEEPS[-1] else 2)
        for axes, panel in zip(figure.axes, "abcd", strict=True):
            axes.set_title(f"({panel})", loc="left")
        reactions[0].legend(loc="upper right")
    return figure


if __name__ == "__main__":
    draw().savefig(sys.argv[1] if len(sys.argv) > 1 else Path(__file__).with_suffix(".png").name, dpi=150)
