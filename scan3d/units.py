"""Units of length of meshes, clouds and surfaces."""

UNITS_M = {"m": 1.0, "cm": 1e-2, "mm": 1e-3, "um": 1e-6, "in": 0.0254}
"""Length of each unit in metres, by its symbol."""


def unit_symbol(unit: str) -> str:
    """The symbol of a unit as it is printed."""
    return unit.replace("um", "µm")
