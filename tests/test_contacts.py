"""Contacts from a recording: what they are under extreme noise, and which row of the recording each one comes from."""

import numpy as np
import pytest
import trimesh

import scan3d
from scan3d.reconstruction.contacts import contacts


@pytest.mark.parametrize("noise", [0.3, 0.6])
def test_noise_beyond_the_signal_raises_nothing(noise):
    plan = scan3d.Plan(slices=4, samples=16, noise=noise)
    recording = scan3d.simulate(trimesh.creation.box((20, 30, 40)), plan)
    assert np.isfinite(contacts(recording).points).all()
