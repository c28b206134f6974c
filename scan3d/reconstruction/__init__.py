"""The first half of step 2: from a recording, simulated or measured, to contacts with the normals of the surface."""

from scan3d.reconstruction.normals import reconstruct

__all__ = ["reconstruct"]
