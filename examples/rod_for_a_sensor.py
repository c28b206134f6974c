"""Which rod for my sensor?

A force-torque sensor has a resolution in N and N·m that does not depend on the rod.  A stiff rod makes large reactions,
compared with which the resolution is small, but it presses on the object; a soft rod presses little, and its contacts are
lost in the noise.  In rod lengths the error of a contact depends only on the noise over ``EI/L²`` and ``EI/L``: it falls
with the fourth power of the diameter, and the forces rise with it.  A short thick wire may also be strained beyond its
elastic limit: the strain is half its diameter times its curvature, which is largest at the clamp.

Round nitinol wires of three lengths and many diameters sweep along a round object, and noise of the sensor's resolution is
added to the reactions: (a) the median distance of the contacts to the true contour; (b) the largest force on the object.
Hollow markers: the strain is above 1 %, where the wire is no longer linearly elastic.  Samples whose force does not exceed
the noise count as samples without contact.

    python examples/rod_for_a_sensor.py [--out FILE]

Reference: L. Merker, J. Steigenberger, C. Behn, Friction Invariant Object Reconstruction Using a Vibrissa-inspired Tactile
Sensor Concept, equation (1) (the units); moduli of `scan3d.rods`.
"""

import argparse
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from matplotlib import rc_context
from matplotlib.figure import Figure
from paper_figure_3 import STYLE

import planar
import scan3d
from scan3d.rods import MODULI_PA

# A small six-axis sensor: standard deviations of a force and of a moment.
FORCE_N, MOMENT_NM = 1e-3, 20e-6
# The object: a circle, swept at a distance of 40 % of the rod.
RADIUS_M, CLEARANCE, FRICTION = 0.02, 0.4, 0.3
LENGTHS_M = (0.05, 0.08, 0.12)
DIAMETERS_M = np.geomspace(0.2e-3, 1.2e-3, 9)
# Enough for the median of the error to be steady to a few percent.
SAMPLES = 2000
# A force of this many standard deviations of its noise is a contact: with fewer, noise alone would be one now and then.
SIGMAS = 8.0
# Strain up to which a nitinol wire is linearly elastic.
LARGEST_STRAIN = 0.01
COLORS, MARKERS = ("#0072B2", "#D55E00", "#009E73"), "os^"


def trial(length_m: float, diameter_m: float) -> tuple[float, float, float]:
    """Median error of the contacts in m, largest contact force in N and largest strain, of a sweep with such a wire."""
    rod = scan3d.Rod.wire(length_m, diameter_m, MODULI_PA["nitinol"])
    radius = RADIUS_M / rod.length_m
    contour = planar.Circle(radius, (0.0, CLEARANCE + radius))
    swept = planar.sweep(contour, FRICTION, samples=SAMPLES)
    noise = np.array([FORCE_N / rod.force_unit_N] * 2 + [MOMENT_NM / rod.moment_unit_Nm])
    reactions = np.stack([swept.f0x, swept.f0y, swept.m0z])
    disturbed = reactions + noise[:, None] * np.random.default_rng(1).standard_normal(reactions.shape)
    contacts = planar.reconstruct(swept.x0, *disturbed, tolerance=min(4 * noise.max(), 0.5))
    touched = (contacts.status == planar.Status.OK) & (np.hypot(*disturbed[:2]) > SIGMAS * noise[0])
    error = contour.distance(contacts.point[touched]) * rod.length_m
    force = np.hypot(swept.f0x, swept.f0y) * rod.force_unit_N
    strain = np.nanmax(np.abs(swept.m0z)) / rod.length_m * diameter_m / 2
    return float(np.median(error)) if touched.any() else np.nan, float(np.nanmax(force)), float(strain)


TRIALS = np.array([[trial(length, diameter) for diameter in DIAMETERS_M] for length in LENGTHS_M])


def draw() -> Figure:
    """The figure, two columns of a page wide."""
    with rc_context(STYLE):
        figure = Figure(figsize=(7.2, 3.4), layout="constrained")
        error, force = figure.subplots(1, 2, sharex=True)
        for length, color, marker, values in zip(LENGTHS_M, COLORS, MARKERS, TRIALS, strict=True):
            for axes, value in zip((error, force), (values[:, 0] * 1e3, values[:, 1]), strict=True):
                axes.loglog(DIAMETERS_M * 1e3, value, color=color, marker=marker, label=f"{length * 1e3:g} mm long")
                strained = values[:, 2] > LARGEST_STRAIN
                axes.plot(DIAMETERS_M[strained] * 1e3, value[strained], marker, color=color, mfc="white")
        for axes in (error, force):
            ticks = [0.2, 0.3, 0.5, 0.8, 1.2]
            axes.set_xticks(ticks, [f"{tick:g}" for tick in ticks])
            axes.set_xticks([], minor=True)
            axes.set_xlabel("diameter in mm")
            axes.grid(color="0.92", linewidth=0.6)
        error.set_ylabel("median error of the contacts in mm")
        force.set_ylabel("largest force in N")
        error.set_title("(a)", loc="left")
        force.set_title("(b)", loc="left")
        figure.legend(*error.get_legend_handles_labels(), loc="outside upper center", ncols=len(LENGTHS_M))
    return figure


def main(arguments: Sequence[str] | None = None) -> None:
    parser = argparse.ArgumentParser(description="Figure of the error and the force over a rod's diameter and length.")
    parser.add_argument("--out", type=Path, default=Path(Path(__file__).with_suffix(".png").name))
    given = parser.parse_args(arguments)
    for length, values in zip(LENGTHS_M, TRIALS, strict=True):
        for diameter, (error, force, strain) in zip(DIAMETERS_M, values, strict=True):
            wire = f"{length * 1e3:4g} mm, Ø {diameter * 1e3:.2f} mm"
            print(f"{wire}: error {error * 1e3:.2g} mm, {force:.2g} N, {strain:.1%} strain")
    draw().savefig(given.out, dpi=150)


if __name__ == "__main__":
    main()
