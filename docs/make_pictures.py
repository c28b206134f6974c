"""Remakes the pictures of README and manual in docs/pictures, all of them or those that are named.

    python docs/make_pictures.py [NAME ...]

A picture is that of an example of the same name, that of a script in this folder, or a view of a scan that `scan3d show` draws.
All take about half an hour, most of it for error_by_slices.
"""

import argparse
import functools
import os
import subprocess
import sys
import tempfile
from collections.abc import Sequence
from pathlib import Path

ROOT = Path(__file__).parents[1]
PICTURES = ROOT / "docs" / "pictures"
MESHES = ROOT / "meshes"
# The mesh that `scan3d scan` is given for each folder that the views show, if it is not the egg, and the options.
OTHERS = {"mug": MESHES / "hollow" / "mug.stl"}
SCANS = {
    "egg": ("--friction", "0.0:0.4"),
    "few": ("--slices", "24", "--samples", "40"),
    "space": ("--friction", "0.0:0.4", "--model", "spatial", "--slices", "16"),
    "mug": ("--friction", "0.0:0.4"),
}
# Of each picture the folder and the options of `scan3d show`; HULL is a surface by another method of the same recording.
HULL = "hull"
VIEWS = {
    "explain": ("egg", "--view", "explain"),
    "space": ("space", "--view", "explain"),
    "histogram": ("egg", "--view", "histogram"),
    "forces": ("egg", "--view", "forces"),
    "compare": ("egg", "--view", "compare"),
    "mug": ("mug", "--camera", "330,40"),
    "difference": ("egg", "--against", HULL, "--size", "120x90mm", "--camera", "300,15"),
}
# Likewise of each movie.
MOVIES = {"growth": ("few",)}


def scripts() -> dict[str, Path]:
    """The scripts that draw a picture, by the picture's name."""
    examples = [path for path in sorted((ROOT / "examples").glob("*.py")) if ".savefig(" in path.read_text("utf-8")]
    return {**{path.stem: path for path in examples}, "own_rig": ROOT / "docs" / "own_rig_figure.py"}


def run(*command: str | Path, folder: Path) -> None:
    """Run a Python command in a folder, with this checkout's packages."""
    path = os.pathsep.join(filter(None, [str(ROOT), os.environ.get("PYTHONPATH")]))
    environment = {**os.environ, "PYTHONPATH": path}
    subprocess.run(
        [sys.executable, *map(str, command)], cwd=folder, env=environment, check=True, stdout=subprocess.DEVNULL
    )


class Folders:
    """The folders of scans, made when they are first asked for."""

    def __init__(self, place: Path) -> None:
        self._place = place

    @functools.cache  # noqa: B019 - there is one
    def __call__(self, name: str) -> Path:
        """The folder of a scan, or of its recording reconstructed as a hull."""
        folder = self._place / name
        if name == HULL:
            recording = self("egg") / "recording.csv"
            run("-m", "scan3d", "reconstruct", recording, "--out", folder, "--method", "hull", folder=self._place)
        else:
            # the mesh beside the folder, where `show` finds it
            mesh = OTHERS.get(name, MESHES / "egg.stl")
            (self._place / mesh.name).write_bytes(mesh.read_bytes())
            run("-m", "scan3d", "scan", mesh.name, "--out", folder, *SCANS[name], folder=self._place)
        return folder


def make(name: str, folders: Folders, place: Path) -> None:
    """Make the picture of a name."""
    picture = PICTURES / f"{name}.{'gif' if name in MOVIES else 'png'}"
    if name in VIEWS or name in MOVIES:
        folder, *options = {**VIEWS, **MOVIES}[name]
        given = [folders(HULL) if option == HULL else option for option in options]
        kind = "--movie" if name in MOVIES else "--screenshot"
        run("-m", "scan3d", "show", folders(folder), kind, picture, "--overwrite", *given, folder=place)
        return
    script = scripts()[name]
    option = ["--out"] if '"--out"' in script.read_text(encoding="utf-8") else []
    run(script, *option, picture, folder=place)


def main(arguments: Sequence[str] | None = None) -> None:
    names = [*scripts(), *VIEWS, *MOVIES]
    parser = argparse.ArgumentParser(description="Remake the pictures in docs/pictures.")
    parser.add_argument("names", nargs="*", metavar="NAME", help=f"of {', '.join(names)} (default all)")
    chosen = parser.parse_args(arguments).names or names
    unknown = [name for name in chosen if name not in names]
    if unknown:
        parser.error(f"there is no picture {unknown[0]}: expected {', '.join(names)}")
    with tempfile.TemporaryDirectory() as folder:
        place = Path(folder)
        folders = Folders(place)
        for number, name in enumerate(chosen, start=1):
            print(f"{number}/{len(chosen)} {name}", flush=True)
            make(name, folders, place)


if __name__ == "__main__":
    main()
