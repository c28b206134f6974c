# %% [markdown]
"""What does it cost to read a whisker, tapered and curved, as a straight uniform rod, and when is that rod good enough?

A whisker is drawn along an ellipse.  Read as the whisker that it is, it gives the contour to rounding; no straight uniform rod
has its reactions.  The table has what rods cost that are nearly straight and uniform, read as if they were.

Lengths are in rod lengths L, forces in EI/L² and curvatures in 1/L.  Run as a whole, the script prints the table and saves the
picture.

    python examples/whisker.py [FILE]

Reference: J. A. Birdwell et al., Biomechanical Models for Radial Distance Determination by the Rat Vibrissal System, Journal
of Neurophysiology 98, 2007, on tapered and curved whiskers; the equations are those of `planar.Rod`.
"""

import sys
from pathlib import Path

import numpy as np
from matplotlib.figure import Figure

import planar

# %% The whisker: a cone whose tip has a fifth of the diameter at its base, bent away from the body
whisker = planar.Rod(tip_diameter=0.2, curvature=-0.3)
ellipse = planar.Ellipse((0.5, 0.3), center=(0.0, 0.85), angle=0.3)
FRICTION = 0.3


# %% What a sweep with one rod gives when it is read as another
def read(true: planar.Rod, assumed: planar.Rod, contour: planar.Contour) -> tuple[planar.Sweep, planar.Contacts]:
    """A sweep, and the contacts that its reactions give."""
    sweep = planar.sweep(contour, FRICTION, samples=80, rod=true)
    # a sensor that was tared in the air does not show the weight that hangs on the free rod
    in_air = np.array(planar.free_reactions(true)) - planar.free_reactions(assumed)
    f0x, f0y, m0z = np.array(sweep.reactions[1:]) - np.reshape(in_air, (3, 1))
    return sweep, planar.reconstruct(sweep.x0, f0x, f0y, m0z, rod=assumed, tolerance=0.01)


# %% Rods that are nearly straight and uniform, in sweeps along a circle
DOWN = (0.0, -1.0)
NEARLY = {
    "tip 1 % thinner": planar.Rod(tip_diameter=0.99),
    "tip 10 % thinner": planar.Rod(tip_diameter=0.9),
    "tip half as thick": planar.Rod(tip_diameter=0.5),
    "curvature 0.02/L": planar.Rod(curvature=-0.02),
    "curvature 0.2/L": planar.Rod(curvature=-0.2),
    "weight 0.01 EI/L²": planar.Rod(weight=0.01, gravity=DOWN),
    "weight 0.1 EI/L²": planar.Rod(weight=0.1, gravity=DOWN),
    "clamp gives 0.02 L/EI": planar.Rod(compliance=0.02),
}
circle = planar.Circle(radius=0.9, center=(0.0, 1.3))


def biases() -> dict[str, tuple[float, float, float, int]]:
    """Of each rod, read as straight and uniform: median and largest error of contacts, error of the friction, rows refused."""
    found = {}
    for name, rod in NEARLY.items():
        sweep, contacts = read(rod, planar.Rod(), circle)
        pressed = np.hypot(sweep.f0x, sweep.f0y) > 0.2
        rows = pressed & (contacts.status == planar.Status.OK)
        off = np.linalg.norm(contacts.point - sweep.point, axis=1)[rows]
        friction = np.nanmedian(contacts.friction[rows & (sweep.phase == planar.Phase.TANGENTIAL)])
        found[name] = float(np.median(off)), float(off.max()), float(friction - FRICTION), int((pressed & ~rows).sum())
    return found


def table() -> str:
    """The biases in Markdown."""
    rows = [
        "| the rod is not straight and uniform: | contacts off, median, largest, in L | friction 0.3 read as | rows refused |",
        "|---|---|---|---|",
    ]
    for name, (median, largest, friction, refused) in biases().items():
        rows.append(f"| {name} | {median:.4f}, {largest:.4f} | {FRICTION + friction:.3f} | {refused} |")
    return "\n".join(rows)


# %% The picture
def draw() -> Figure:
    """The ellipse, what the whisker's reactions say of it, and what a uniform rod would say where two others were used."""
    figure = Figure(figsize=(7.2, 4.4), layout="constrained")
    axes = figure.subplots()
    axes.fill(*ellipse.points(np.linspace(0, 2 * np.pi, 400)).T, color="0.9")
    for true, assumed, look, what in (
        (whisker, whisker, {"marker": "o", "color": "#0072B2"}, "a whisker, read as it is"),
        (
            NEARLY["tip 10 % thinner"],
            planar.Rod(),
            {"marker": "s", "color": "#D55E00"},
            "tip 10 % thinner, read as uniform",
        ),
        (
            NEARLY["curvature 0.2/L"],
            planar.Rod(),
            {"marker": "^", "color": "#009E73"},
            "curvature 0.2/L, read as straight",
        ),
    ):
        _, contacts = read(true, assumed, ellipse)
        axes.plot(*contacts.point.T, linestyle="none", markersize=4, label=what, **look)
    axes.legend(loc="upper left")
    axes.set(xlabel="$x\\;/\\;L$", ylabel="$y\\;/\\;L$", ylim=(0.45, 1.5), aspect="equal")
    return figure


# %%
if __name__ == "__main__":
    print(table())
    draw().savefig(sys.argv[1] if len(sys.argv) > 1 else Path(__file__).with_suffix(".png").name, dpi=150)
