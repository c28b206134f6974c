"""Units of length at the boundary: what the numbers of a mesh, a cloud or a surface mean."""

UNITS_M = {"m": 1.0, "cm": 1e-2, "mm": 1e-3, "um": 1e-6, "in": 0.0254}
"""Metres to the unit, by its symbol."""
