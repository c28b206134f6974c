"""Equilibria of the rod in tip contact."""

import numpy as np
import pytest

from planar import elastica, equilibria


def test_the_bend_of_a_tip_contact_is_found_in_few_steps(monkeypatch):
    """For all directions of the force, at heights between that of the straight rod and that of the tangential contact."""
    rng = np.random.default_rng(7)
    slope, friction = rng.uniform(-1.0, 1.4, 500), rng.uniform(0.0, 0.5, 500)
    alpha, q_upper = slope + friction, elastica.tangential_q(slope, friction)
    bent = elastica.bend(alpha, q_upper)
    low, high = bent.y / bent.length, elastica.unbowed_height(alpha)
    height = low + rng.uniform(0.05, 0.95, 500) * (high - low)
    steps = []

    def counted(bent):
        steps.append(len(bent.shape.length))
        return original(bent)

    original = equilibria.tip_ratios
    monkeypatch.setattr(equilibria, "tip_ratios", counted)
    root = equilibria._tip_root(alpha, height, q_upper)
    bent = elastica.bend(alpha, root)
    assert bent.y / bent.length == pytest.approx(height, abs=1e-14)
    assert sum(steps) < 5.3 * len(alpha), sum(steps) / len(alpha)
