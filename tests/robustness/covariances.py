"""Do the contacts' stated covariances hold?  Scans with noise against the same scans without, row by row.

    python -m tests.robustness.covariances [--slices 24] [--noise 1e-5 1e-4 1e-3]

For each body and noise: the fraction of the contacts that lie within their ellipse of 95 % in the slice's plane, of all, of
those at the rod's tip and along it, and by the smallest and the largest tenth of the force, and the fraction of the normals
whose angle is within 1.96 of its standard deviations.  Then the same for all bodies together, and by tenths of the force.
Fails where a fraction of at least 1000 contacts, or that of any tenth by force of all bodies together, lies outside 93 to 97 %.
"""

from __future__ import annotations

import argparse
import dataclasses
import sys
from pathlib import Path
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

import planar
import scan3d
from scan3d.cloud import Cloud
from scan3d.reconstruction.contacts import contacts

MESHES = Path(__file__).parents[2] / "meshes"
BODIES = ("egg.stl", "cube.stl", "pebble.obj", "needle.ply")
NOISE = (1e-5, 1e-4, 1e-3)
ALLOWED = (0.93, 0.97)
# Contacts from which a fraction is judged: by chance it is off by 0.7 % at this number.
FEWEST = 1000
TENTHS = 10


class Checked(NamedTuple):
    """Which contacts (n,) and which of the tangential contacts' normals lie within what is stated of them."""

    place: NDArray[np.bool_]
    normal: NDArray[np.bool_]
    judged: NDArray[np.bool_]
    """Whether the contact is tangential with and without noise."""
    phase: NDArray[np.int8]
    tenth: NDArray[np.int64]
    """Of the force within the scan, 0 for the lightest touches."""

    def fractions(self) -> dict[str, tuple[float, int]]:
        """Fraction within what is stated, and the number of contacts, by the kind of contact."""
        parts = {
            "all": self.place,
            "tip": self.place[self.phase == planar.Phase.TIP],
            "tangential": self.place[self.phase == planar.Phase.TANGENTIAL],
            "normals": self.normal[self.judged],
        }
        return {name: (float(part.mean()) if len(part) else np.nan, len(part)) for name, part in parts.items()}

    def by_force(self) -> list[float]:
        return [float(self.place[self.tenth == k].mean()) for k in range(TENTHS)]


def check(noisy: Cloud, exact: Cloud) -> Checked:
    """The contacts of a scan along z against those of the same scan without noise."""
    _, rows, true = np.intersect1d(noisy.row, exact.row, return_indices=True)
    error = (noisy.points[rows] - exact.points[true])[:, :2]
    assert noisy.covariance is not None
    assert noisy.normal_sd is not None
    inverse = np.linalg.inv(noisy.covariance[rows][:, :2, :2])
    place = np.einsum("ni,nij,nj->n", error, inverse, error) < -2 * np.log(0.05)
    n, m = noisy.in_plane_normals[rows], exact.in_plane_normals[true]
    turned = np.arctan2(n[:, 1] * m[:, 0] - n[:, 0] * m[:, 1], (n * m).sum(axis=1))
    judged = (noisy.phase[rows] == planar.Phase.TANGENTIAL) & (exact.phase[true] == planar.Phase.TANGENTIAL)
    force = exact.force_N[true]
    tenth = np.argsort(np.argsort(force)) * TENTHS // len(force)
    normal = np.abs(turned) < 1.96 * noisy.normal_sd[rows]
    return Checked(place, normal, judged, noisy.phase[rows], tenth)


def scans(name: str, noise: tuple[float, ...] = NOISE, slices: int = 24, seed: int = 0) -> dict[float, Checked]:
    """What is stated of the contacts of a body's scans, by their noise."""
    mesh = scan3d.load_mesh(MESHES / name)
    # heights that do not depend on the noise
    plan = scan3d.Plan(slices=slices, spacing="cosine", friction=0.3, seed=seed)
    exact = contacts(scan3d.simulate(mesh, plan))
    noisy = {level: dataclasses.replace(plan, noise=level, seed=seed + k) for k, level in enumerate(noise)}
    return {level: check(contacts(scan3d.simulate(mesh, plan)), exact) for level, plan in noisy.items()}


def together(parts: list[Checked]) -> Checked:
    return Checked(*(np.concatenate(columns) for columns in zip(*parts, strict=True)))


def outside(checked: Checked) -> list[str]:
    """The kinds of contact whose fraction is not as stated."""
    low, high = ALLOWED
    return [
        name for name, (value, count) in checked.fractions().items() if count >= FEWEST and not low <= value <= high
    ]


def line(label: str, checked: Checked) -> str:
    parts = [f"{name} {100 * value:5.1f} % of {count}" for name, (value, count) in checked.fractions().items()]
    tenths = checked.by_force()
    return f"{label:24} {', '.join(parts)}; least force {100 * tenths[0]:.1f} %, largest {100 * tenths[-1]:.1f} %"


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--slices", type=int, default=24)
    parser.add_argument("--noise", type=float, nargs="+", default=NOISE)
    parser.add_argument("--seed", type=int, default=0)
    arguments = parser.parse_args()
    every, wrong = [], []
    for name in BODIES:
        for noise, checked in scans(name, tuple(arguments.noise), arguments.slices, arguments.seed).items():
            label = f"{name} noise {noise:.0e}"
            print(line(label, checked), flush=True)
            every.append(checked)
            wrong += [f"{label}: {kind}" for kind in outside(checked)]
    total = together(every)
    print(line("all", total))
    tenths = total.by_force()
    print("by tenths of the force  ", ", ".join(f"{100 * value:.1f}" for value in tenths), "%")
    wrong += [f"all: {kind}" for kind in outside(total)]
    wrong += [
        f"all: tenth {k + 1} of the force" for k, value in enumerate(tenths) if not ALLOWED[0] <= value <= ALLOWED[1]
    ]
    print("\n".join([f"outside {ALLOWED[0]:.0%} to {ALLOWED[1]:.0%}: {text}" for text in wrong]) or "all as stated")
    return int(bool(wrong))


if __name__ == "__main__":
    sys.exit(main())
