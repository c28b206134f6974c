# %% [markdown]
"""What does a bent rod reach of a body that is not convex?

A rod is drawn along an L from six directions, with its base near the body, and far away, from where its end probes like a
finger.  What the rods have passed is free; where no contact is near, nothing is known of the contour.  Two sweeps that are
aimed at the widest such stretch enter the bay.  The surface of a scan shows what is known, estimated between slices, and
unknown.

Run as a whole, the script saves the picture.

    python examples/what_a_rod_reaches.py [FILE]

Reference: the page on bodies that are not convex, of this manual; what rods have passed is free by the winding number about the
loop of two neighbouring rods.
"""

import functools
import sys
from pathlib import Path

import numpy as np
from matplotlib.collections import PolyCollection
from matplotlib.figure import Figure
from matplotlib.patches import Patch

import planar
import scan3d

# %% The slice, in rod lengths
L = np.array([[0, 0], [40, 0], [40, 12], [12, 12], [12, 40], [0, 40]]) / 56
FRICTION, NEAR, FAR, SNAP = 0.3, 0.3, 0.8, 5  # SNAP: travel of the tip in steps of the base
SIX = np.radians(np.arange(0, 360, 60))
KNOWN, ESTIMATED, UNKNOWN, FREE = "#0072B2", "#9ECAE1", "#D55E00", "#DDEEDD"


@functools.cache
def swept(direction: float, clearance: float) -> tuple[np.ndarray, np.ndarray]:
    """Contacts (n, 2) of one sweep with the rod in a direction, and the areas (a, v, 2) that the rods have passed."""
    y = np.array([np.cos(direction), np.sin(direction)])
    axes = np.stack([[y[1], -y[0]], y])
    origin = ((L @ y).min() - clearance) * y
    sweep = planar.sweep(planar.Polygon((L - origin) @ axes.T), FRICTION, samples=64)
    single = sweep.status <= planar.SweepStatus.ONE_CONTACT
    lines = planar.elastic_lines(sweep.x0, *np.nan_to_num(sweep.reactions[1:]))
    rods = np.concatenate([lines.curved, lines.straight[:, 1:]], axis=1)
    # between neighbours with a single contact that no snap parts
    near = np.hypot(*np.diff(rods[:, -1], axis=0).T) < SNAP * np.abs(np.diff(sweep.x0))
    loops = np.concatenate([rods[:-1], rods[1:, ::-1]], axis=1)[single[1:] & single[:-1] & near]
    return sweep.point[sweep.status == planar.SweepStatus.ONE_CONTACT] @ axes + origin, loops @ axes + origin


def contour(count: int = 2000) -> np.ndarray:
    """Places (n, 2) of the contour, evenly along it."""
    closed = np.vstack([L, L[:1]])
    along = np.append(0, np.cumsum(np.linalg.norm(np.diff(closed, axis=0), axis=1)))
    at = np.linspace(0, along[-1], count)
    return np.column_stack([np.interp(at, along, closed[:, k]) for k in (0, 1)])


def reached(sweeps: list[tuple[float, float]]) -> tuple[np.ndarray, list[np.ndarray], np.ndarray]:
    """Contacts, areas, and the distance (n,) of the contour's places from the nearest contact, of some sweeps."""
    points, loops = zip(*(swept(*one) for one in sweeps), strict=True)
    contacts = np.concatenate(points)
    away = np.linalg.norm(contour()[:, None] - contacts, axis=2).min(axis=1)
    return contacts, list(loops), away


# %% Near, near and far, and aimed at the bay
near = [(angle, NEAR) for angle in SIX]
far = near + [(angle, FAR) for angle in SIX]
aimed = far + [(np.radians(angle), 0.45) for angle in (195, 225)]
WIDE = 0.03  # of the rod, beyond which nothing supports the contour


def surface() -> tuple[np.ndarray, np.ndarray]:
    """Facets (f, 3, 3), and the least class of their corners, of a scan of the L with few slices."""
    mesh = Path(__file__).parents[1] / "meshes" / "hollow" / "l.stl"
    found = scan3d.scan(mesh, slices=5, samples=32, probing="off").surface
    return np.asarray(found.triangles), found.vertex_attributes["known"][found.faces].min(axis=1)


# %% The picture
def draw() -> Figure:
    """Three slices, and the surface by its classes."""
    figure = Figure(figsize=(10.5, 3.4), layout="constrained")
    for k, (name, sweeps) in enumerate((("near", near), ("and far", far), ("and aimed", aimed))):
        axes = figure.add_subplot(1, 4, k + 1)
        contacts, loops, away = reached(sweeps)
        for some in loops:
            axes.add_collection(PolyCollection(some, facecolor=FREE, edgecolor="none"))
        axes.fill(*L.T, color="0.85")
        axes.plot(*contour()[away > WIDE].T, ".", color=UNKNOWN, markersize=4)
        axes.plot(*contacts.T, ".", color=KNOWN, markersize=3)
        axes.set(
            title=f"{name}: {np.mean(away > WIDE):.0%} unknown", xlim=(-0.1, 0.82), ylim=(-0.1, 0.82), aspect="equal"
        )
        axes.set_xlabel("$x\\;/\\;L$")
    axes = figure.add_subplot(1, 4, 4, projection="3d")
    triangles, known = surface()
    from mpl_toolkits.mplot3d.art3d import Poly3DCollection

    axes.add_collection3d(
        Poly3DCollection(triangles, facecolor=np.array([UNKNOWN, ESTIMATED, KNOWN])[known], linewidth=0)
    )
    axes.set(
        xlim=(0, 40), ylim=(0, 40), zlim=(0, 16), xlabel="x in mm", ylabel="y in mm", title="surface, z up to 16 mm"
    )
    axes.set(box_aspect=(40, 40, 16), zticks=(0, 16))
    axes.view_init(40, 50)
    figure.legend(
        handles=[
            Patch(color=color, label=label)
            for color, label in (
                (KNOWN, "contacts, known"),
                (ESTIMATED, "estimated between slices"),
                (UNKNOWN, "unknown"),
                (FREE, "passed by rods"),
            )
        ],
        loc="outside lower center",
        ncols=4,
        frameon=False,
    )
    return figure


# %%
if __name__ == "__main__":
    draw().savefig(sys.argv[1] if len(sys.argv) > 1 else Path(__file__).with_suffix(".png").name, dpi=150)
