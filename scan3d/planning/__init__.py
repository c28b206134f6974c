"""What is to be scanned, and how: heights of the slices, approach directions, poses; from contacts, never from the truth."""

from scan3d.planning.adaptive import next_heights
from scan3d.planning.plan import Plan

__all__ = ["Plan", "next_heights"]
