"""A grid of cubes around places, distances on it, and the surfaces of regions in it.

Centres and places are those of the grid.  Distances on it are never less than the true ones.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy import ndimage
from scipy.spatial import cKDTree

from scan3d.arrays import AT_ONCE, Array, Index, Mask
from scan3d.geometry.distance import poly_data
from scan3d.spatial.bodies import diameter

EVERY_NEIGHBOUR = np.ones((3, 3, 3), dtype=bool)
# Cubes around the places.
_AROUND = 3


@dataclass(frozen=True)
class Grid:
    """Cubes around contacts."""

    origin: Array
    """(3,) centre of the first cube."""
    step: float
    shape: tuple[int, int, int]

    @classmethod
    def around(cls, points: Array, R: float) -> Grid:
        low, high = points.min(axis=0) - R, points.max(axis=0) + R
        step = float(np.prod(high - low) / AT_ONCE) ** (1 / 3)
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

    def patches(self, cells: Mask) -> list[dict[str, Any]]:
        """The connected parts of some cells with their `center`, `volume` and `extent`, the largest first.

        Parts of fewer cells than a cube has corners are too small to tell.
        """
        label, count = ndimage.label(cells, structure=EVERY_NEIGHBOUR)
        found = []
        for number, around in enumerate(ndimage.find_objects(label), start=1):
            places = np.argwhere(label[around] == number)
            if len(places) < 8:
                continue
            places = self.origin + self.step * (places + [part.start for part in around])
            found.append(
                {
                    "center": places.mean(axis=0).tolist(),
                    "volume": len(places) * self.step**3,
                    "extent": diameter(places) + self.step,
                }
            )
        return sorted(found, key=lambda patch: -patch["volume"])

    def inside(self, surface: Any) -> Mask:
        """Which cells have their centres inside of a closed `trimesh.Trimesh`."""
        from vtkmodules.util.numpy_support import vtk_to_numpy
        from vtkmodules.vtkImagingStencil import vtkImageStencilToImage, vtkPolyDataToImageStencil

        stencil, image = vtkPolyDataToImageStencil(), vtkImageStencilToImage()
        stencil.SetInputData(poly_data(surface.vertices.view(np.ndarray), surface.faces.view(np.ndarray)))
        stencil.SetOutputOrigin(*self.origin)
        stencil.SetOutputSpacing(*np.full(3, self.step))
        stencil.SetOutputWholeExtent(*(end for n in self.shape for end in (0, n - 1)))
        image.SetInputConnection(stencil.GetOutputPort())
        image.SetInsideValue(1)
        image.SetOutsideValue(0)
        image.SetOutputScalarTypeToUnsignedChar()
        image.Update()
        return np.asarray(
            vtk_to_numpy(image.GetOutput().GetPointData().GetScalars()).reshape(self.shape, order="F") > 0
        )

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

    def curvature(self, R: float) -> float:
        """By how much a surface of distance R, linear along the edges of the cubes, may lie inside that of the true distance.

        A distance d from some centres is concave but for ``|x|²/2d``: along an edge its interpolation exceeds it by step²/8d at
        most, and at a mean of places in one cube, whose mean square from their mean is 3 step²/4 at most, by 3 step²/8d.
        The least d in a cube through which the surface passes is R less half its diagonal.
        """
        return self.step**2 / (2 * (R - self.step * np.sqrt(3) / 2))

    def within(self, cells: Mask, points: Array, most: Array) -> Mask:
        """(n,) whether points (n, 3) are within distances (n,) of the centre of one of some cells, or in one of them."""
        edge = cells & ~ndimage.binary_erosion(cells, EVERY_NEIGHBOUR)
        if not edge.any():
            return np.zeros(len(points), dtype=bool)
        near = cKDTree(self.centres(edge)).query(points)[0] <= most
        return np.asarray(near | (self.at(cells.astype(float), points) > 0))

    def at(self, values: Array, points: Array) -> Array:
        """The values (n,) of the cells of points (n, 3); -inf for those outside the grid."""
        cells, known = self.cells_of(points)
        found = np.full(len(points), -np.inf)
        found[known] = values[tuple(cells.T)]
        return found


def below(field: Array, level: float, grid: Grid) -> Any:
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
