"""Many scans: meshes and settings, computed in this process, in others, or by a cluster, with one summary."""

from scan3d.batches.scheduler import scheduled
from scan3d.batches.study import Batch, batch

__all__ = ["Batch", "batch", "scheduled"]
