"""The mesh files that a batch is given: files, folders, patterns and lists."""

from __future__ import annotations

import glob
import os
from collections.abc import Iterable, Iterator
from pathlib import Path

from scan3d.errors import InputError
from scan3d.files.meshes import FORMATS
from scan3d.files.reading import read_small
from scan3d.files.whole import earlier_files

_KINDS = f".{', .'.join(FORMATS)}"


def mesh_files(given: Iterable[str | os.PathLike[str]]) -> list[Path]:
    """The mesh files that are meant, in the order in which they are given, each once.

    given
        files, which need not exist; folders, for the mesh files in them; patterns such as ``parts/**/*.stl``; and lists
        ``@FILE``, text files with one of the former in each line, relative to the folder of the list.  In a list, empty lines
        and those that begin with ``#`` are left out.  Files that a scan has written are left out of folders and patterns.

    Raises InputError for lists that can't be read, for folders and patterns without a mesh, and if nothing is given.
    """
    found: dict[str, Path] = {}
    for entry in given:
        name = os.fspath(entry)
        if isinstance(entry, str) and name.startswith("@") and not Path(name).exists():
            paths = [path for line in _lines(Path(name[1:])) for path in _meant(line)]
        else:
            paths = list(_meant(name))
        for path in paths:
            found.setdefault(os.path.abspath(path), path)
    if not found:
        raise InputError("there is no mesh to scan; name mesh files, folders, patterns such as 'parts/*.stl', or @LIST")
    return list(found.values())


def _lines(path: Path) -> list[str]:
    """The entries of a list, relative to the current folder."""
    try:
        lines = [line.strip() for line in read_small(path).splitlines()]
    except (OSError, ValueError) as error:
        reason = error.strerror if isinstance(error, OSError) else "it is not text in UTF-8"
        raise InputError(
            f"can't read the list {path}: {reason}; expected a text file with a mesh in each line"
        ) from None
    entries = [str(path.parent / line) for line in lines if line and not line.startswith("#")]
    if not entries:
        raise InputError(f"the list {path} is empty; expected a mesh in each line")
    return entries


def _meant(name: str) -> Iterator[Path]:
    """The files that an entry means."""
    path = Path(name)
    if path.is_dir():
        files = sorted(path.iterdir())
    elif glob.has_magic(name) and not path.exists():
        files = [Path(match) for match in sorted(glob.glob(name, recursive=True))]
    else:
        yield path
        return
    meshes = [file for file in files if file.suffix[1:].lower() in FORMATS and file.is_file()]
    written = {folder: earlier_files(folder) for folder in {file.parent for file in meshes}}
    meshes = [file for file in meshes if file.name not in written[file.parent]]
    if not meshes:
        what = "the folder" if path.is_dir() else "the pattern"
        raise InputError(f"{what} {name} has no mesh file; expected files that end with {_KINDS}")
    yield from meshes
