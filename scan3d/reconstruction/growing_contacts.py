"""Contacts of a recording that grows slice by slice, without computing those of earlier slices again."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from scan3d.arrays import Index
from scan3d.cloud import Cloud
from scan3d.reconstruction.contacts import NoContactError, in_slices, with_unresolved_slices
from scan3d.reconstruction.resolution import Noise
from scan3d.recording import Recording, joined

# Errors of exact recordings.
_EXACT = Noise(0.0, 0.0, 0.0, 0.0, True)
# What a cloud has for every contact, as far as exact contacts in slices have it.
_COLUMNS = (
    "points",
    "normals",
    "normal_source",
    "in_plane_normals",
    "phase",
    "slice",
    "sweep",
    "row",
    "force_N",
    "friction",
    "slice_axis",
    "slice_height",
)


class GrowingContacts:
    """The contacts of exact recordings by one rod, each of whole slices that no earlier one has.

    They are those of `contacts`, but for tip contacts, which have no normals: a common friction depends on all contacts.
    """

    def __init__(self) -> None:
        self._cloud: Cloud | None = None
        self._rows = 0
        self._left_out: Index = np.empty(0, dtype=np.intp)
        self._empty: list[Recording] = []
        self._number: list[NDArray[np.int32]] = []
        self._proven = True
        """Whether all slices without contact prove an end: further contacts do not change that."""

    def add(self, recording: Recording) -> None:
        """Add a recording; its sweeps are numbered after those of the earlier ones."""
        found = in_slices(recording, _EXACT, tips=False)
        before = 0 if self._cloud is None else len(self._cloud.slice_height)
        number = (before + found.number).astype(np.int32)
        new = replace(
            found.cloud,
            slice=(before + found.cloud.slice).astype(np.int32),
            row=(self._rows + found.cloud.row).astype(np.int32),
        )
        both = [new] if self._cloud is None else [self._cloud, new]
        columns: dict[str, Any] = {name: np.concatenate([getattr(part, name) for part in both]) for name in _COLUMNS}
        self._cloud = replace(new, **columns)
        self._rows += len(recording)
        self._left_out = np.concatenate([self._left_out, before + found.left_out])
        empty = ~np.isin(number, new.slice)
        if empty.any():
            self._empty.append(_of_rows(recording, np.flatnonzero(empty)))
            self._number.append(number[empty])
            self._proven = False

    def cloud(self) -> Cloud:
        """All contacts so far.  Raises InputError if there are none."""
        if self._cloud is None or not len(self._cloud):
            raise NoContactError("there is no contact yet")
        if self._proven:
            return self._cloud
        number = np.concatenate(self._number)
        found = with_unresolved_slices(self._cloud, joined(self._empty), number, self._left_out, 0.0)
        self._proven = found.unresolved is None
        return found


def _of_rows(recording: Recording, rows: Index) -> Recording:
    """Some rows of a recording of planar reactions."""
    names = "sweep", "position_m", "quaternion", "force_N", "moment_Nm"
    columns: dict[str, Any] = {name: getattr(recording, name)[rows] for name in names}
    return replace(recording, **columns)
