"""Units of length of meshes, clouds and surfaces."""

from typing import Any, Literal

Unit = Literal["m", "cm", "mm", "um", "in"]
UNITS_M: dict[str, float] = {"m": 1.0, "cm": 1e-2, "mm": 1e-3, "um": 1e-6, "in": 0.0254}
"""Length of each unit in metres, by its symbol."""


def unit_of(mesh: Any, given: str | None) -> str:
    """The unit of a `trimesh.Trimesh`: the given one, or that which the mesh states, or mm."""
    return given or (mesh.units if mesh.units in UNITS_M else "mm")


def unit_symbol(unit: str) -> str:
    """The symbol of a unit as it is printed."""
    return unit.replace("um", "µm")
