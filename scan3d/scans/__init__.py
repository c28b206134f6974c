"""Whole scans, from a mesh to a folder of results, and the folder read back."""

from scan3d.scans.calls import open, scan
from scan3d.scans.performing import perform, with_origin
from scan3d.scans.results import Scan, StoredScan

__all__ = ["Scan", "StoredScan", "open", "perform", "scan", "with_origin"]
