# %% [markdown]
"""Which reactions does a rod have that is drawn along a circle, and can the circle and its friction be recovered from them?

One sweep in both directions: from the circle to the reactions at the clamp, and from these to contacts, friction and normals.

Each `# %%` opens a cell for editors that run scripts cell by cell; run as a whole, the script prints the table at its end
and saves the picture.  Lengths are in rod lengths L, forces in EI/L², moments in EI/L.

    python examples/one_sweep.py [FILE]

Reference: L. Merker, J. Steigenberger, C. Behn, Friction Invariant Object Reconstruction Using a Vibrissa-inspired Tactile
Sensor Concept, Section II.
"""

import sys
from pathlib import Path

import numpy as np
from matplotlib.figure import Figure

import planar

# %% The object
# A circle above the base line.  The rod is clamped at (x0, 0), points up, and its base moves to the left.
contour = planar.Circle(radius=0.9, center=(0.0, 1.3))

# %% Step 1: from the contour to the reactions
# Without `base`, the samples are evenly spaced from touch-down to the base position at which the rod snaps off.
sweep = planar.sweep(contour, friction=0.3, samples=41)

# First the tip is in contact, then the rod is tangential to the circle, and at the end the tip slides up on the other side.
phases = [planar.Phase(phase).name.lower() for phase in sweep.phase]

# %% The events of the sweep
# `events` finds the base positions of the transitions exactly, independently of the samples.
events = planar.events(contour, friction=0.3)
reasons = [planar.EventKind(kind).sentence for kind in events.kind]

# %% Step 2: from the reactions to the contacts
# The inputs are the base position and the reactions.  The force of the first sample is zero, and determines no contact.
contacts = planar.reconstruct(sweep.x0, sweep.f0x, sweep.f0y, sweep.m0z)
valid = contacts.status == planar.Status.OK
largest_error = contour.distance(contacts.point[valid]).max()

# %% The friction, which is not an input of the reconstruction
# In tangential contact (14) separates friction and slope; in tip contact only a lower bound of the friction is known.
tangential = contacts.phase == planar.Phase.TANGENTIAL
friction = float(np.median(contacts.friction[tangential]))

# With the friction estimated from the tangential contacts, tip contacts have a normal as well.
with_normals = planar.reconstruct(sweep.x0, sweep.f0x, sweep.f0y, sweep.m0z, friction=friction)
largest_turn = np.abs(with_normals.slope - sweep.slope)[valid].max()

# %% The landmarks of sweeps with increasing friction
frictions = (0.0, 0.2, 0.4, 0.6)
landmarks = {mu: planar.events(contour, mu) for mu in frictions}


def table() -> str:
    """The landmarks in Markdown: base position, contact force and clamping moment at each."""
    rows = [
        "| μ | touch-down: x0 | tip to tangential: x0, f, m0z | tangential to tip: x0, f, m0z | snap-off: x0, f, m0z |",
        "|---|---|---|---|---|",
    ]
    for mu, landmark in landmarks.items():
        # force and moment just before the event
        states = zip(landmark.x0, landmark.force[:, 0], landmark.m0z[:, 0], strict=True)
        _, *others = (f"{x0:.6f}, {force:.6f}, {moment:.6f}" for x0, force, moment in states)
        rows.append(f"| {mu:g} | {landmark.x0[0]:.6f} | {' | '.join(others)} |")
    return "\n".join(rows)


# %% The picture
def draw() -> Figure:
    """The rod in every state of the sweep; the contacts found, and their normals turned inwards."""
    figure = Figure(figsize=(7.2, 4.0), layout="constrained")
    axes = figure.subplots()
    circle = contour.points(np.linspace(-np.pi / 2, np.pi / 2, 200))
    axes.fill(*circle.T, color="0.9")
    planar.elastic_lines(sweep.x0, sweep.f0x, sweep.f0y, sweep.m0z).plot(axes=axes)
    inwards = contacts.point - 0.2 * with_normals.normal
    axes.plot(*np.stack([contacts.point, inwards]).transpose(2, 0, 1), color="0.5", linewidth=0.8)
    axes.plot(*contacts.point.T, "k.", markersize=5)
    axes.set(xlim=(-1.4, 1.1), ylim=(0.0, 1.3))
    return figure


# %%
if __name__ == "__main__":
    for x0, reason in zip(events.x0, reasons, strict=True):
        print(f"x0 = {x0:+.4f}: {reason}")
    print(f"{valid.sum()} contacts within {largest_error:.1e} of the circle, slopes within {largest_turn:.1e} rad")
    print(f"friction {friction:.12f} estimated, 0.3 set\n")
    print(table())
    draw().savefig(sys.argv[1] if len(sys.argv) > 1 else Path(__file__).with_suffix(".png").name, dpi=150)
