"""Is the friction that is found from touch the friction that was set, contact by contact, and with noise?

A rod sweeps along a circle, and the coefficient of friction is drawn separately for every sample.  In tangential contact the
angle ``β = arcsin((m0z² - 2 f0y) / (2 f))`` of (12) is the friction angle, so that the friction follows from each sample
alone; in tip contact it does not.

(a) the estimated friction over the friction that was set, from exact reactions and from noisy ones; (b) the error with noise
along the sweep, which runs from right to left, and twice its standard deviation, propagated from the noise to first order

    σ_β = σ √(m0z² + (1 + sin β cos α)² + (sin β sin α)²) / (f cos β),        σ_μ = (1 + μ²) σ_β.

The standard deviation can be computed without the truth.  Samples in which it is too large are left out; among them are tip
contacts with a small force, which noise makes look like tangential contacts.

    python examples/friction_from_touch.py [--out FILE]

Reference: L. Merker, J. Steigenberger, C. Behn, Friction Invariant Object Reconstruction Using a Vibrissa-inspired Tactile
Sensor Concept, Section III-C (there without noise).
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

CONTOUR = planar.Circle(radius=0.9, center=(0.0, 1.3))
SAMPLES = 400
# Standard deviation of f0x, f0y and m0z; of a steel wire of 0.3 mm and 50 mm, 0.03 mN and 1.7 µN·m.
NOISE = 1e-3
# Contacts farther than this many standard deviations of the reactions from the tip count as tangential: with fewer, noise
# would turn tip contacts into tangential ones.
TIP_SIGMAS = 10.0
# Estimates with a larger standard deviation are left out: more would be scattered, fewer would be shown.
LARGEST_DEVIATION = 4 * NOISE
EXACT, NOISY = "#0072B2", "#D55E00"

# Step 1, with a friction for every sample, and the noise of a sensor.
RANDOM = np.random.default_rng(5)
SWEEP = planar.sweep(CONTOUR, RANDOM.uniform(0.0, 0.8, SAMPLES), samples=SAMPLES)
REACTIONS = np.stack([SWEEP.f0x, SWEEP.f0y, SWEEP.m0z])
DISTURBED = REACTIONS + NOISE * RANDOM.standard_normal(REACTIONS.shape)

# Step 2 knows the base positions and the reactions.
CONTACTS = planar.reconstruct(SWEEP.x0, *REACTIONS)
ESTIMATED = planar.reconstruct(SWEEP.x0, *DISTURBED, tolerance=TIP_SIGMAS * NOISE)


def deviation(contacts: planar.Contacts, moment: np.ndarray, noise: float) -> np.ndarray:
    """Standard deviation (n,) of the coefficient of friction, to first order, from that of the reactions."""
    sine, cosine = np.sin(contacts.friction_angle), np.cos(contacts.friction_angle)
    alpha = contacts.force_angle
    gain = np.sqrt(moment**2 + (1 + sine * np.cos(alpha)) ** 2 + (sine * np.sin(alpha)) ** 2)
    return noise * gain / (contacts.force * cosine) * (1 + contacts.friction**2)


DEVIATION = deviation(ESTIMATED, DISTURBED[2], NOISE)
RELIABLE = DEVIATION < LARGEST_DEVIATION
ERROR = (ESTIMATED.friction - SWEEP.friction)[RELIABLE]


def draw() -> Figure:
    """The figure, two columns of a page wide."""
    with rc_context(STYLE):
        figure = Figure(figsize=(7.2, 3.6), layout="constrained")
        friction, error = figure.subplots(1, 2)
        draw_friction(friction)
        draw_errors(error)
        friction.set_title("(a)", loc="left")
        error.set_title("(b)", loc="left")
    return figure


def draw_friction(axes: Axes) -> None:
    """The estimated friction over the friction that was set."""
    axes.plot([0.0, 0.8], [0.0, 0.8], color="0.6", linewidth=0.8)
    noisy, style = ESTIMATED.friction[RELIABLE], dict(ms=3.6, mfc="none", mew=0.7)
    axes.plot(SWEEP.friction[RELIABLE], noisy, "s", color=NOISY, label="noise $10^{-3}$", **style)
    axes.plot(SWEEP.friction, CONTACTS.friction, ".", color=EXACT, ms=3, label="exact")
    axes.set(xlabel=r"$\mu$ set", ylabel=r"$\mu$ estimated", aspect="equal", xlim=(0.0, 0.8))
    axes.legend(loc="upper left")


def draw_errors(axes: Axes) -> None:
    """The error with noise over the base position, and twice its standard deviation."""
    expected = 2 * DEVIATION[RELIABLE]
    axes.vlines(SWEEP.x0[RELIABLE], -expected, expected, color="0.8", linewidth=1.2, label=r"$\pm 2\,\sigma_\mu$")
    axes.plot(SWEEP.x0[RELIABLE], ERROR, "s", color=NOISY, ms=2.6, mfc="none", mew=0.7, label="noise $10^{-3}$")
    axes.set(xlabel="$x_0\\;/\\;L$", ylabel=r"$\mu_\mathrm{estimated} - \mu_\mathrm{set}$", ylim=(-0.007, 0.007))
    axes.legend(loc="upper right", ncols=2)


def main(arguments: Sequence[str] | None = None) -> None:
    parser = argparse.ArgumentParser(description="Figure of the friction found from touch.")
    parser.add_argument("--out", type=Path, default=Path(Path(__file__).with_suffix(".png").name))
    given = parser.parse_args(arguments)
    scaled = ERROR / DEVIATION[RELIABLE]
    tangential = (SWEEP.phase == planar.Phase.TANGENTIAL).sum()
    print(f"{RELIABLE.sum()} of {SAMPLES} samples have a reliable friction; {tangential} are in tangential contact")
    print(f"exact reactions: within {np.nanmax(np.abs(CONTACTS.friction - SWEEP.friction)):.1e}")
    print(f"noise {NOISE:g}: rms {np.sqrt(np.mean(ERROR**2)):.1e}, mean {ERROR.mean():+.1e}")
    print(f"error over its standard deviation: rms {np.sqrt(np.mean(scaled**2)):.2f}, mean {scaled.mean():+.2f}")
    draw().savefig(given.out, dpi=150)


if __name__ == "__main__":
    main()
