"""Closed surfaces around the part of a grid where a field is below a level."""

from __future__ import annotations

from typing import Any

import numpy as np

from scan3d.arrays import Array


def below(field: Array, level: float, origin: Array, step: float) -> Any:
    """The surface of the region below a level, as a `trimesh.Trimesh`, outward; empty where there is none.

    field (nx, ny, nz)
        values at ``origin + step * (i, j, k)``, linear in between; above the level at the border of the grid.
    """
    import trimesh
    from vtkmodules.util.numpy_support import numpy_to_vtk, vtk_to_numpy
    from vtkmodules.vtkCommonDataModel import vtkImageData
    from vtkmodules.vtkFiltersCore import vtkFlyingEdges3D

    image = vtkImageData()
    image.SetDimensions(*field.shape)
    image.SetOrigin(*origin)
    image.SetSpacing(step, step, step)
    image.GetPointData().SetScalars(numpy_to_vtk(np.asarray(field, dtype=float).ravel(order="F"), deep=True))
    contour = vtkFlyingEdges3D()
    contour.SetInputData(image)
    contour.SetValue(0, level)
    contour.ComputeNormalsOff()
    contour.ComputeGradientsOff()
    contour.ComputeScalarsOff()
    contour.Update()
    found = contour.GetOutput()
    if not found.GetNumberOfPolys():
        return trimesh.Trimesh()
    vertices = vtk_to_numpy(found.GetPoints().GetData()).astype(float)
    faces = vtk_to_numpy(found.GetPolys().GetConnectivityArray()).reshape(-1, 3)
    mesh = trimesh.Trimesh(vertices, faces, process=False)
    return mesh if mesh.volume > 0 else trimesh.Trimesh(vertices, faces[:, ::-1], process=False)
