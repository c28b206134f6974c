"""Contacts of smooth bodies that noise hides a second one of, against the true bodies.

    python -m tests.robustness.hidden_contacts --count 30

Bodies, noises from 1e-5 to 1e-3 of the units of force and moment, and frictions of 0, 0.1 and 0.3 are drawn.  A contact that is
off by more than five of its stated standard deviations is none.  At most 0.1 % may be; else the exit code is 1.
"""

from __future__ import annotations

import numpy as np
import trimesh

import scan3d
from scan3d.geometry.distance import distances
from tests.robustness import options
from tests.robustness.shot_rods import noisy

SIGMAS, ALLOWED = 5.0, 1e-3


def body(random):
    """A ball with waves in six directions, which has hollows."""
    ball = trimesh.creation.icosphere(subdivisions=4)
    radius = 1 + sum(
        0.09 * np.cos(ball.vertices @ random.normal(scale=2.2, size=3) + random.uniform(0, 7)) for _ in range(6)
    )
    return trimesh.Trimesh(20 * ball.vertices * radius[:, None], ball.faces, process=False)


def trial(seed):
    """Numbers of contacts, and of those that are none, of one body."""
    random = np.random.default_rng(seed)
    mesh, noise, friction = body(random), float(10 ** random.uniform(-5, -3)), float(random.choice([0.0, 0.1, 0.3]))
    plan = scan3d.Plan(slices=2, spacing="uniform", samples=40, sweeps=12, friction=friction, seed=seed, probing="off")
    cloud = scan3d.reconstruct(noisy(scan3d.simulate(mesh, plan), noise, random))
    off = distances(cloud.points, mesh)
    return len(cloud), int((off > SIGMAS * cloud.place_sd).sum())


def main():
    """Draw bodies, and print the share of contacts that are none."""
    found = np.array([trial(seed) for seed in range(options(__doc__, count=30).count)])
    contacts, wrong = found.sum(axis=0)
    print(f"{wrong} of {contacts} contacts of {len(found)} bodies are none: {100 * wrong / contacts:.3g} %")
    raise SystemExit(int(wrong > ALLOWED * contacts))


if __name__ == "__main__":
    main()
