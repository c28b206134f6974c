"""How results show themselves: as text, and in a notebook."""

from __future__ import annotations

import textwrap

# that of `typing`, whose import takes longer than that of this module, which `import scan3d` needs
TYPE_CHECKING = False
if TYPE_CHECKING:
    import os
    from collections.abc import Callable
    from typing import Any

    import pandas
    import pyvista
    from PIL.Image import Image

Rows = list[tuple[str, str]]
"""Name and value of each quantity in a table."""

_LOADERS: dict[str, Callable[[], Any]] = {}


def register(**loaders: Callable[[], Any]) -> None:
    """State what loads the modules that draw (`drawn`) and save (`saved`) results, when a result is first asked for that.

    The package does so from above, because the modules of results may not depend on those.
    """
    _LOADERS.update(loaders)


class Described:
    """A result that shows itself as a short table, and prints it whole."""

    def summary(self) -> Rows:
        """The rows that `print` shows, as pairs of name and value."""
        raise NotImplementedError

    def _title(self) -> str:
        return type(self).__name__

    def _lines(self) -> list[str]:
        return [self._title(), *(f"  {name:21} {value}" for name, value in self.summary())]

    def __repr__(self) -> str:
        return "\n".join(line if len(line) <= 120 else f"{line[:117]}..." for line in self._lines())

    def __str__(self) -> str:
        lines = (textwrap.wrap(line, 120, subsequent_indent=24 * " ", break_on_hyphens=False) for line in self._lines())
        return "\n".join(part for line in lines for part in line)


class Shown(Described):
    """A result that has a picture and a table in HTML."""

    def plot(self, **options: Any) -> Image:
        """A picture of the result; `options` are those of `scan3d.plot`."""
        return _LOADERS["drawn"]().plot(self, **options)

    def _repr_html_(self) -> str:
        return _LOADERS["drawn"]().to_html(self)


class Exported(Described):
    """Contacts that can be written to files and handed to other libraries.

    In all of them `truth` is the true body, a `trimesh.Trimesh` or the path of its mesh: where it is given, the column
    ``quality`` is the distance of each contact from it, else NaN or missing.
    """

    def save(self, path: str | os.PathLike[str], *, truth: Any = None, overwrite: bool = False) -> None:
        """Write the contacts to a file, as `scan3d.save`: ``.ply``, ``.pcd``, ``.vtp``, ``.xyz``, ``.csv`` and others."""
        _LOADERS["saved"]().save(self, path, truth=truth, overwrite=overwrite)

    def to_pandas(self, truth: Any = None) -> pandas.DataFrame:
        """A `pandas.DataFrame` with a row for each contact.  Raises InputError if pandas is missing."""
        return _LOADERS["saved"]().to_pandas(self, truth)

    def to_pyvista(self, truth: Any = None) -> pyvista.PolyData:
        """A `pyvista.PolyData` with normals, force, friction and all other columns as point data."""
        return _LOADERS["saved"]().to_pyvista(self, truth)

    def to_open3d(self, truth: Any = None) -> Any:
        """An `open3d.t.geometry.PointCloud` with the same columns.  Raises InputError if open3d can't be imported."""
        return _LOADERS["saved"]().to_open3d(self, truth)
