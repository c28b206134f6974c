"""Settings of a scan, heights of its slices, approach directions and poses, from contacts and never from the true body."""

from scan3d.planning.heights import next_heights
from scan3d.planning.plan import Plan

__all__ = ["Plan", "next_heights"]
