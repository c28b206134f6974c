"""What is the coefficient of friction of the circle, according to the reactions alone?

Figure 5 of the paper, from the reactions of Figure 3: (a) the angle ``β`` of (12) over the base position, its phase
transitions marked with circles: between them it is the friction angle ``ζ``, outside them it is smaller; (b) the coefficient
of friction ``μ = tan ζ`` (14) between the transitions, and as dots the values that were set at random.

    python examples/paper_figure_5.py [FILE]

Reference: L. Merker, J. Steigenberger, C. Behn, Friction Invariant Object Reconstruction Using a Vibrissa-inspired Tactile
Sensor Concept, Figure 5, Section III-C.
"""

import sys
from pathlib import Path

from matplotlib import rc_context
from matplotlib.figure import Figure
from paper_figure_3 import COLORS, LABELS, STYLE, SWEEPS

import planar

CONTACTS = [planar.reconstruct(*swept.reactions) for swept in SWEEPS]


def draw() -> Figure:
    """The figure, two columns of a page wide."""
    with rc_context(STYLE):
        figure = Figure(figsize=(7.2, 3.2), layout="constrained")
        angle, coefficient = figure.subplots(1, 2, sharex=True)
        for swept, contacts, color, label in zip(SWEEPS, CONTACTS, COLORS, LABELS, strict=True):
            columns = ("friction_angle_bound", "friction")
            contacts.plot(*columns, over=swept.x0, axes=(angle, coefficient), color=color, label=label)
        random = SWEEPS[-1]
        tangential = random.phase == planar.Phase.TANGENTIAL
        coefficient.plot(random.x0[tangential], random.friction[tangential], ".", color=COLORS[-1], markersize=3.5)
        angle.set_title("(a)", loc="left")
        coefficient.set_title("(b)", loc="left")
        figure.legend(*angle.get_legend_handles_labels(), loc="outside upper center", ncols=len(LABELS))
    return figure


if __name__ == "__main__":
    draw().savefig(sys.argv[1] if len(sys.argv) > 1 else Path(__file__).with_suffix(".png").name, dpi=150)
