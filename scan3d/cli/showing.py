"""The command show: its arguments, and what it does."""

from __future__ import annotations

import argparse
import dataclasses
from argparse import Namespace
from collections.abc import Callable
from pathlib import Path
from typing import Any

from scan3d.choices import CAMERAS, COLORS, MOVIES, VIEWS, one_of
from scan3d.cli.terminal import print_result, printable
from scan3d.errors import InputError
from scan3d.pictures.sheet import DPI, WITH_OTHER, Sheet, sheet
from scan3d.units import UNITS_M

EXAMPLES = {
    "show": """\
  scan3d show out
  scan3d show out --screenshot egg.png --view compare
  scan3d show out --screenshot egg.pdf --size 85x60mm --dpi 600 --camera 300,25
  scan3d show out --screenshot forces.svg --view forces
  scan3d show out --against other --screenshot difference.png
  scan3d show out/cloud.ply --screenshot friction.pdf --color friction
  scan3d show log.csv --html log.html --truth part.stl
  scan3d show out --movie sweep.gif"""
}


def add_show(commands: Any, add_overwrite: Callable[[argparse.ArgumentParser], None]) -> argparse.ArgumentParser:
    """Add the command show, which is returned."""
    show: argparse.ArgumentParser = commands.add_parser(
        "show", help="show a scan in a window, a picture, a page or a movie"
    )
    show.add_argument(
        "path", metavar="DIR|FILE", help="a scan's folder, a recording (.csv), a cloud or surface (.ply), a mesh"
    )
    show.add_argument("--screenshot", metavar="FILE", help="a picture, .png, .pdf or .svg, instead of a window")
    show.add_argument(
        "--html", metavar="FILE", help="an interactive page for any browser; it does not need the network"
    )
    show.add_argument("--movie", metavar="FILE", help="a .gif, or an .mp4 (needs imageio-ffmpeg)")
    show.add_argument(
        "--view",
        choices=VIEWS,
        metavar="VIEW",
        help=f"what the picture shows: {one_of(VIEWS)} (default surface, with --color cloud)",
    )
    show.add_argument(
        "--color",
        choices=COLORS,
        metavar="WHAT",
        help=f"colour of the contacts in a picture or the window: {one_of(COLORS)} (default force)",
    )
    _add_sheet(show)
    show.add_argument(
        "--movie-of",
        choices=MOVIES,
        metavar="WHAT",
        help=f"what the movie shows: {one_of(MOVIES)} (default {MOVIES[0]})",
    )
    show.add_argument(
        "--truth",
        metavar="MESH",
        help="mesh of the true body; by default the mesh that the report names, if it is found",
    )
    show.add_argument("--hull", action="store_true", help="take the convex hull of the true body")
    show.add_argument(
        "--against",
        metavar="FILE",
        help="another scan's folder, a surface or a mesh: the colour is the signed distance of the surface from it",
    )
    show.add_argument(
        "--unit", default="mm", choices=tuple(UNITS_M), metavar="UNIT", help="unit of a mesh (default mm)"
    )
    add_overwrite(show)
    show.set_defaults(command="show", misuse=show.error)
    return show


def _add_sheet(show: argparse.ArgumentParser) -> None:
    show.add_argument(
        "--size",
        metavar="SIZE",
        help="size of the picture: WIDTH or WIDTHxHEIGHT in mm, cm, in, pt or px, such as 85mm or 85x60mm (default 7in)",
    )
    show.add_argument("--dpi", metavar="N", help=f"pixels of the picture to the inch (default {DPI})")
    show.add_argument(
        "--camera",
        metavar="CAMERA",
        help=f"{one_of(CAMERAS)}, or AZIMUTH,ELEVATION in degrees such as 300,25; a further ,1.5 zooms (default: the view's)",
    )


def show(arguments: Namespace) -> int:
    """Show a scan's folder, a recording, a cloud or a mesh in files, or in a window if no file is named."""
    _check(arguments)
    chosen = _sheet(arguments)
    from scan3d.files.whole import check_file
    from scan3d.pictures import movie, views, window

    screenshot, html, film = arguments.screenshot, arguments.html, arguments.movie
    if not (screenshot or html or film) and not window.can_open():
        raise InputError(window.NO_DISPLAY)
    # file names are checked before the work
    if screenshot:
        views.check_path(screenshot)
    if film:
        movie.check_path(film)
    inputs = {"file": arguments.path, "true body": arguments.truth, "other surface": arguments.against}
    for option, file in (("--html", html), ("--movie", film), ("--screenshot", screenshot)):
        if file:
            check_file(file, inputs, arguments.overwrite, option)
    arguments.progress.tell("reading")
    scene = read_scene(Path(arguments.path), arguments.truth, arguments.hull, arguments.unit)
    if arguments.against:
        from scan3d.scans.others import other_surface

        scene = scene.against(other_surface(arguments.against, scene.unit, arguments.unit))
    arguments.progress.tell("drawing")
    files = _write(arguments, scene, chosen)
    if not files:
        arguments.progress.end()
        window.open_window(scene, print, arguments.color or "force")
        return 0
    text = "\n".join(printable(f"written to {file}") for file in files)
    return print_result(arguments, {"shown": scene.name, "files": files}, text)


def _write(arguments: Namespace, scene: Any, chosen: Sheet) -> list[str]:
    """Write the page, the movie and the picture that are asked for; the files that were written."""
    from scan3d.files.whole import atomic, write_atomic
    from scan3d.pictures import drawing, movie, page

    screenshot, html, film = arguments.screenshot, arguments.html, arguments.movie
    files = []
    if html:
        write_atomic(html, page.page(scene), "--html")
        files.append(html)
    if film:
        if arguments.movie_of == "growth":
            write_atomic(film, drawing.draw(scene, [(Path(film).suffix.lower(), {"subject": "growth"})])[0], "--movie")
        else:  # nothing is rendered
            with atomic(film, "--movie") as path:
                movie.movie(scene, path)
        files.append(film)
    if screenshot:
        default = "cloud" if arguments.color or scene.surface is None else "surface"
        view, color = arguments.view or default, arguments.color or "force"
        write_atomic(screenshot, drawing.picture(scene, Path(screenshot), view, color, chosen), "--screenshot")
        files.append(screenshot)
    return files


def _check(arguments: Namespace) -> None:
    """Exit with a usage error for options that would have no effect."""
    for option in ("view", "size", "dpi", "camera"):
        if getattr(arguments, option) is not None and not arguments.screenshot:
            what = "says what a picture shows" if option == "view" else "is that of a picture"
            arguments.misuse(f"--{option} {what}: give --screenshot FILE as well")
    if arguments.color and not arguments.screenshot and (arguments.html or arguments.movie):
        arguments.misuse("--color is for a picture or the window: give --screenshot FILE as well")
    if arguments.color and arguments.view not in (None, "cloud"):
        arguments.misuse(
            f"--color is that of the contacts in the view cloud: leave it out with --view {arguments.view}"
        )
    if arguments.movie_of and not arguments.movie:
        arguments.misuse("--movie-of says what a movie shows: give --movie FILE as well")
    if not arguments.against:
        return
    if arguments.truth or arguments.hull:
        arguments.misuse("--against takes another surface in the place of the true body: leave out --truth and --hull")
    if arguments.movie:
        arguments.misuse("--against is for a picture, a page or the window: leave out --movie")
    if arguments.color or arguments.view not in (None, *WITH_OTHER):
        arguments.misuse(f"--against compares surfaces: give the view {one_of(WITH_OTHER)}, and no --color")


def _sheet(arguments: Namespace) -> Sheet:
    """Size, resolution and camera of the picture; exits with a usage error for values that they can't have."""
    try:
        return sheet(arguments.size, arguments.dpi, arguments.camera)
    except InputError as error:
        arguments.misuse(str(error))
        raise


def read_scene(path: Path, truth: str | None, hull: bool, unit: str) -> Any:
    """The scene of a path, with the true body if it is named or found."""
    from scan3d.files.meshes import load_mesh, read_mesh
    from scan3d.pictures import stored
    from scan3d.pictures.scene import Scene

    if not path.exists():
        raise InputError(
            f"there is no {path}; show a scan's folder, a recording (.csv), a cloud or a surface (.ply), or a mesh"
        )
    if path.is_dir():
        scene, report = stored.read_folder(path, unit)
        truth = truth or stored.find_truth(path, report)
        hull = hull or bool((report.get("mesh") or {}).get("hull"))
    elif path.suffix.lower() in (".csv", ".parquet"):
        scene = _recording_scene(path)
    else:
        stored_scene = stored.read_ply_scene(path, unit) if path.suffix.lower() == ".ply" else None
        scene = stored_scene or Scene(path.stem, unit, surface=read_mesh(path))
    return dataclasses.replace(scene, truth=load_mesh(truth, hull=hull)) if truth else scene


def _recording_scene(path: Path) -> Any:
    """The scene of a recording: its contacts, and their surface where they span a body."""
    from scan3d import workflow
    from scan3d.files.recordings import read_recording
    from scan3d.pictures.scene import of_cloud
    from scan3d.reconstruction import reconstruct as reconstruct_recording

    recording = read_recording(path)
    try:
        scene = workflow.to_scene(workflow.analyse(recording))
    except InputError:  # contacts in one plane do not span a body, but can be shown
        return of_cloud(reconstruct_recording(recording), name=path.stem, recording=recording)
    return dataclasses.replace(scene, name=path.stem)
