"""Two bodies between which a body without fine features lies: by balls that roll around contacts and free space (C19).

Premise: the body and its surroundings are unions of balls of radius R, so that nothing is thinner than 2R, no gap is narrower,
and no edge or groove is sharper; every part of the body was touched; and there is no cavity, so that the balls of the
surroundings are connected with the outside.

*Outer body.*  A ball in the body holds no free place.  So the body lies in the union of the balls about the centres that are at
least R away from all free places, as far as these centres are connected with such that reach a contact.

*Inner body.*  A ball in the surroundings holds no contact.  So the surroundings lie in the union of the balls about the centres
that are at least R away from all contacts, as far as these are connected with the outside.  Where contacts are apart by more
than 2R, balls roll in between, and nothing is claimed.  The sheets of free space play no part in it.

Every closed surface between the two is as close to the body's surface as they are to each other.  A contact outside the outer
body, or a free place inside the inner one, refutes the premise.

Centres and places are those of a grid.  Distances on it are never less than the true ones; how far a centre lies from the next
one of the grid, half the diagonal of a cell at most, is allowed for in each step.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy import ndimage
from scipy.spatial import cKDTree

from scan3d.arrays import Array, Index, Mask
from scan3d.bounds.free_space import Sheets, contradicted, joined, place_errors, sheets_of
from scan3d.cloud import Cloud
from scan3d.errors import InputError
from scan3d.recording import Recording
from scan3d.units import length

# Cells of the grid.
_CELLS = 4_000_000
# Cells in R at least, and cells around the balls.
_COARSEST, _AROUND = 4.0, 3
_EVERY_NEIGHBOUR = np.ones((3, 3, 3), dtype=bool)


@dataclass(frozen=True)
class Reach:
    """What contacts and free space prove of a body without features finer than R, in the cloud's unit."""

    outer: Any
    """A `trimesh.Trimesh` that contains the body; empty where nothing bounds it."""
    inner: Any
    """A `trimesh.Trimesh` in the body; empty where there is none."""
    bound: float
    """Upper bound of the Hausdorff distance between the surface and that of the body; infinite where nothing bounds it."""
    refuted: str | None
    """What contradicts the premise, in a sentence; None if nothing does."""
    unbounded: str | None
    """Why there is no bound although nothing refutes the premise, in a sentence; None if there is one."""


def reach(recording: Recording, cloud: Cloud, R: float, surface: Any = None) -> Reach:
    """The outer and the inner body of a body without features finer than R, in the cloud's unit, by all slices together.

    surface
        a closed `trimesh.Trimesh` that the bound is for; None: any between the two bodies.

    Raises InputError for an R that is no positive number or too fine for the grid, and as `surfaces.carved`.
    """
    if not (np.isfinite(R) and R > 0):
        raise InputError(f"the reach must be a positive number, got {R}")
    touched = cloud.fattened or cloud
    sheets = sheets_of(recording, touched, R)
    touched = touched.select(~contradicted(sheets, touched))
    contacts, errors = touched.points, place_errors(touched)
    free = np.concatenate([_free_places(sheet) for sheet in sheets])
    grid = _Grid.around(contacts, R)
    if grid.step * _COARSEST > R:
        raise InputError(
            f"a reach of {length(R, cloud.unit)} is too fine for a body of this size; it must be at least "
            f"{length(_COARSEST * grid.step, cloud.unit)}"
        )
    error = float(errors.max())
    of_free = max(sheet.cell for sheet in sheets) / np.sqrt(2) + error
    # every centre lies within half a diagonal of one of the grid; distances are linear between cells but for their curvature
    half = grid.step * np.sqrt(3) / 2
    level = R + half + 3 * grid.step**2 / (8 * R)
    to_contact = grid.distance(contacts)
    in_body = grid.distance(free) >= R - half - of_free
    touching = np.nonzero(in_body & (to_contact <= R + 3 * half + error))
    nearest = cKDTree(contacts).query(grid.origin + grid.step * np.stack(touching, axis=1))[0]
    seeds = np.zeros(grid.shape, dtype=bool)
    seeds[touching] = nearest <= R + half + error
    in_body = joined(in_body, seeds, _EVERY_NEIGHBOUR)
    in_air = joined(to_contact >= R - half - error, grid.border(), _EVERY_NEIGHBOUR)
    to_body, to_air = grid.from_cells(in_body), grid.from_cells(in_air)
    outer, inner = _below(to_body, level, grid), _below(-to_air, -level, grid)
    against = {
        "contacts lie outside the outer body": grid.at(to_body, contacts) > level + half + errors,
        "free places lie inside the inner body": grid.at(to_air, free) > level + half + of_free,
        "cells are outside the one and inside the other": (to_body > level) & (to_air > level),
    }
    contradictions = [f"{np.count_nonzero(where)} {what}" for what, where in against.items() if where.any()]
    refuted = unbounded = None
    bound = np.inf
    if contradictions:
        refuted = (
            f"the body has features finer than {length(R, cloud.unit)}, or rods touched at a second place unnoticed: "
            f"{' and '.join(contradictions)}; take a smaller reach"
        )
    elif (in_body & grid.border()).any():
        place = grid.centres(in_body & grid.border()).mean(axis=0)
        unbounded = (
            f"nothing bounds the body towards ({', '.join(f'{x:.3g}' for x in place)}) {cloud.unit}: slices farther apart than "
            "twice the reach, or none beyond the body's end; scan along further axes"
        )
    elif cloud.fattened is not None:
        unbounded = (
            "the two bodies are those of the body grown by the rod's radius; no bound of the body itself follows"
        )
    elif not (to_air > level).any():
        unbounded = "contacts are too far apart to enclose anything for this reach; take more slices and samples"
    else:
        between = (to_body <= level) & (to_air <= level)
        to_outer, to_inner = grid.from_cells(to_body > level), grid.from_cells(to_air > level)
        wide = np.maximum(to_outer, to_inner)
        bound = float(wide[between].max(initial=0.0) + half)
        if surface is not None:
            # from each face to the body's surface, which lies between the two, and back from all between the two
            corners = np.asarray(surface.triangles)
            middle = corners.mean(axis=1)
            there = grid.at(wide, middle) + np.linalg.norm(corners - middle[:, None], axis=2).max(axis=1)
            back = cKDTree(np.concatenate([middle, surface.vertices])).query(grid.centres(between))[0]
            bound = float(max(there.max(), back.max(initial=0.0)) + half)
    return Reach(outer, inner, bound, refuted, unbounded)


def _free_places(sheet: Sheets) -> Array:
    """(n, 3) the centres of the free cells."""
    number, y, x = np.nonzero(sheet.free)
    flat = sheet.origin + sheet.cell * np.stack([x, y], axis=1)
    return flat @ sheet.frame[:2] + sheet.height[number, None] * sheet.frame[2]


@dataclass(frozen=True)
class _Grid:
    """Cubes around contacts."""

    origin: Array
    """(3,) centre of the first cube."""
    step: float
    shape: tuple[int, int, int]

    @classmethod
    def around(cls, points: Array, R: float) -> _Grid:
        low, high = points.min(axis=0) - R, points.max(axis=0) + R
        step = float(np.prod(high - low) / _CELLS) ** (1 / 3)
        count = np.ceil((high - low) / step).astype(int) + 2 * _AROUND + 1
        return cls(low - _AROUND * step, step, (int(count[0]), int(count[1]), int(count[2])))

    def border(self) -> Mask:
        border = np.ones(self.shape, dtype=bool)
        border[1:-1, 1:-1, 1:-1] = False
        return border

    def centres(self, cells: Mask) -> Array:
        """(n, 3) the centres of some cells."""
        return np.asarray(self.origin + self.step * np.stack(np.nonzero(cells), axis=1))

    def cells_of(self, points: Array) -> tuple[Index, Mask]:
        """The cells (n, 3) of those points that are in the grid, and which (m,) these are."""
        cells = np.round((points - self.origin) / self.step).astype(int)
        known: Mask = np.all((cells >= 0) & (cells < self.shape), axis=1)
        return cells[known], known

    def distance(self, points: Array) -> Array:
        """Distance of every cell's centre from a point (n, 3) nearby: never less than from the nearest."""
        cells, known = self.cells_of(points)
        flat = np.ravel_multi_index(tuple(cells.T), self.shape)
        chosen = np.full(int(np.prod(self.shape)), -1)
        chosen[flat] = np.flatnonzero(known)
        chosen = chosen.reshape(self.shape)
        nearest = ndimage.distance_transform_edt(chosen < 0, return_distances=False, return_indices=True)
        point = chosen[tuple(nearest)]
        squares = np.zeros(self.shape)
        for axis, n in enumerate(self.shape):
            place = self.origin[axis] + self.step * np.arange(n)
            squares += (place.reshape([-1 if k == axis else 1 for k in range(3)]) - points[:, axis][point]) ** 2
        return np.asarray(np.sqrt(squares))

    def from_cells(self, cells: Mask) -> Array:
        """Distance of every cell's centre from that of the nearest of some cells; infinite if there are none."""
        if not cells.any():
            return np.full(self.shape, np.inf)
        return self.step * ndimage.distance_transform_edt(~cells)

    def at(self, values: Array, points: Array) -> Array:
        """The values (n,) of the cells of points (n, 3); -inf for those outside the grid."""
        cells, known = self.cells_of(points)
        found = np.full(len(points), -np.inf)
        found[known] = values[tuple(cells.T)]
        return found


def _below(field: Array, level: float, grid: _Grid) -> Any:
    """The surface of the region below a level, as a `trimesh.Trimesh`, outward; empty where there is none.

    The field has values at the centres of the cells, above the level at the border, and is linear in between.
    """
    import trimesh
    from vtkmodules.util.numpy_support import numpy_to_vtk, vtk_to_numpy
    from vtkmodules.vtkCommonDataModel import vtkImageData
    from vtkmodules.vtkFiltersCore import vtkFlyingEdges3D

    image = vtkImageData()
    image.SetDimensions(*field.shape)
    image.SetOrigin(*grid.origin)
    image.SetSpacing(*np.full(3, grid.step))
    image.GetPointData().SetScalars(numpy_to_vtk(np.asarray(field, dtype=float).ravel(order="F"), deep=True))
    contour = vtkFlyingEdges3D()
    contour.SetInputData(image)
    contour.SetValue(0, level)
    contour.ComputeNormalsOff()
    contour.ComputeScalarsOff()
    contour.Update()
    found = contour.GetOutput()
    if not found.GetNumberOfPolys():
        return trimesh.Trimesh()
    vertices = vtk_to_numpy(found.GetPoints().GetData()).astype(float)
    faces = vtk_to_numpy(found.GetPolys().GetConnectivityArray()).reshape(-1, 3)
    mesh = trimesh.Trimesh(vertices, faces, process=False)
    return mesh if mesh.volume > 0 else trimesh.Trimesh(vertices, faces[:, ::-1], process=False)
