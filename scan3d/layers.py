"""Former module of the slices, kept for one version; use `scan3d.reconstruction.slices`: a layer is called a slice."""

from scan3d.reconstruction.slices import Slice as Layer
from scan3d.reconstruction.slices import SliceStack as Layers
from scan3d.reconstruction.slices import stacks

__all__ = ["Layer", "Layers", "stacks"]
