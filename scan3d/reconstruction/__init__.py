"""Step 2: a recording, simulated or measured, becomes contacts with the normals of the surface."""

from scan3d.reconstruction.normals import reconstruct

__all__ = ["reconstruct"]
