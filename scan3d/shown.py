"""How results show themselves in a notebook."""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Any, cast

if TYPE_CHECKING:
    from PIL.Image import Image


class Shown:
    """A result that has a picture and a table in HTML.

    Both are made by `scan3d.pictures.notebook`, which is imported only when a picture or a table is asked for, because the
    modules of results may not depend on those of pictures.  This is the only import of a higher wing.
    """

    def plot(self, **options: Any) -> Image:
        """A picture of the result; `options` are those of `scan3d.plot`."""
        return cast("Image", import_module("scan3d.pictures.notebook").plot(self, **options))

    def _repr_html_(self) -> str:
        return cast(str, import_module("scan3d.pictures.notebook").to_html(self))
