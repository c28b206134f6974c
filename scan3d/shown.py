"""How results show themselves: as text, and in a notebook."""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Any, cast

if TYPE_CHECKING:
    import os

    import pandas
    import pyvista
    from PIL.Image import Image

Rows = list[tuple[str, str]]
"""Name and value of each quantity in a table."""

# Characters of a line, and those of the names in it.
_WIDTH, _NAMES = 120, 21


def described(title: str, rows: Rows) -> str:
    """A table as text: the title, and below it a line of at most 120 characters for each row."""
    lines = [title, *(f"  {name:{_NAMES}} {value}" for name, value in rows)]
    return "\n".join(line if len(line) <= _WIDTH else f"{line[: _WIDTH - 3]}..." for line in lines)


class Described:
    """A result that prints itself as a short table."""

    def summary(self) -> Rows:
        """The rows that `print` shows, as pairs of name and value."""
        raise NotImplementedError

    def __repr__(self) -> str:
        return described(type(self).__name__, self.summary())


class Shown(Described):
    """A result that has a picture and a table in HTML.

    Both are made by `scan3d.pictures.notebook`, which is imported only when a picture or a table is asked for, because the
    modules of results may not depend on those of pictures.  These classes have the only imports of higher
    wings.
    """

    def plot(self, **options: Any) -> Image:
        """A picture of the result; `options` are those of `scan3d.plot`."""
        return cast("Image", import_module("scan3d.pictures.notebook").plot(self, **options))

    def _repr_html_(self) -> str:
        return cast(str, import_module("scan3d.pictures.notebook").to_html(self))


class Exported(Described):
    """Contacts that can be written to files and handed to other libraries, by ``scan3d.saving``, which is imported likewise.

    In all of them `truth` is the true body, a `trimesh.Trimesh` or the path of its mesh: where it is given, the column
    ``quality`` is the distance of each contact from it, else NaN or missing.
    """

    def save(self, path: str | os.PathLike[str], *, truth: Any = None, overwrite: bool = False) -> None:
        """Write the contacts to a file, as `scan3d.save`: ``.ply``, ``.pcd``, ``.vtp``, ``.xyz``, ``.csv`` and others."""
        import_module("scan3d.saving").save(self, path, truth=truth, overwrite=overwrite)

    def to_pandas(self, truth: Any = None) -> pandas.DataFrame:
        """A `pandas.DataFrame` with a row for each contact.  Raises InputError if pandas is missing."""
        return cast("pandas.DataFrame", import_module("scan3d.saving").to_pandas(self, truth))

    def to_pyvista(self, truth: Any = None) -> pyvista.PolyData:
        """A `pyvista.PolyData` with normals, force, friction and all other columns as point data."""
        return cast("pyvista.PolyData", import_module("scan3d.saving").to_pyvista(self, truth))

    def to_open3d(self, truth: Any = None) -> Any:
        """An `open3d.t.geometry.PointCloud` with the same columns.  Raises InputError if open3d can't be imported."""
        return import_module("scan3d.saving").to_open3d(self, truth)
