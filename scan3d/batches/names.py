"""Names of folders: one for each run, readable, and allowed by all file systems."""

from __future__ import annotations

import hashlib
import re
from collections import Counter
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from scan3d.files.whole import BATCH

# Characters of a name; what is longer ends with a hash.  Longer, paths could exceed 260 characters, which Windows allows by
# default; shorter, names would not say all settings.
_LONGEST = 100
# Names that Windows keeps for devices, and those of the batch's own files.
_RESERVED = re.compile(r"(con|prn|aux|nul|com\d|lpt\d)(\..*)?", re.IGNORECASE)


def body_names(paths: Sequence[Path]) -> list[str]:
    """A name for each mesh file: its stem, and before or behind it what tells it from others of that stem.

    Files of one folder differ by their ending (``part-stl``, ``part-obj``), others by the names of their folders
    (``left-part``, ``right-part``).  The names are distinct even where a file system does not distinguish capitals.
    """
    stems = [_allowed(path.stem) for path in paths]
    alike = Counter(stem.casefold() for stem in stems)
    groups: dict[str, list[int]] = {}
    for number, stem in enumerate(stems):
        if alike[stem.casefold()] > 1:
            groups.setdefault(stem.casefold(), []).append(number)
    for group in groups.values():
        for number, name in zip(group, _told_apart([paths[number] for number in group]), strict=True):
            stems[number] = name
    return distinct(stems)


def run_name(body: str, varied: Mapping[str, Any]) -> str:
    """The name of a run: that of the body, and the settings that the grid varies."""
    values = [f"{name}={_text(value)}" for name, value in varied.items()]
    return _allowed("_".join([body, *values]))


def distinct(names: Sequence[str]) -> list[str]:
    """The names, with a number behind those that others have too, also those of a batch's own files."""
    taken = {name.casefold() for name in BATCH.results}
    chosen = []
    for name in names:
        candidate, number = name, 1
        while candidate.casefold() in taken:
            number += 1
            candidate = f"{name}-{number}"
        taken.add(candidate.casefold())
        chosen.append(candidate)
    return chosen


def _told_apart(paths: Sequence[Path]) -> list[str]:
    """Names of files of one stem: with as few of their folders as make them distinct, or as many as there are."""
    names = [_allowed(path.stem) for path in paths]
    for depth in range(0, max(len(path.absolute().parts) for path in paths)):
        for ending in (False, True):
            names = [_with_folders(path.absolute(), depth, ending) for path in paths]
            if len({name.casefold() for name in names}) == len(names):
                return names
    return names


def _with_folders(path: Path, depth: int, ending: bool) -> str:
    folders = path.parent.parts[1:]
    last = [path.stem, path.suffix[1:]] if ending else [path.stem]
    return _allowed("-".join([*folders[len(folders) - min(depth, len(folders)) :], *last]))


def _text(value: Any) -> str:
    if isinstance(value, (list, tuple)):
        return ",".join(map(_text, value))
    return str(value).replace(":", "-")


def _allowed(text: str) -> str:
    """The text with a hyphen for characters that a file system or a shell may not take, shortened if it is long."""
    name = re.sub(r"[^\w.,=+-]+", "-", text).strip(".-") or "body"
    if _RESERVED.fullmatch(name):
        name = f"{name}-body"
    if len(name) <= _LONGEST:
        return name
    return f"{name[: _LONGEST - 9]}-{hashlib.sha256(text.encode(errors='replace')).hexdigest()[:8]}"
