"""The command show: a scan in a window, a picture, a page or a movie."""

from __future__ import annotations

import dataclasses
from pathlib import Path
from typing import Annotated, Any

from cyclopts import Parameter

from scan3d.choices import WITH_OTHER, Color, View, one_of
from scan3d.cli.terminal import File, Flag, Mesh, Output, Overwrite, print_result, printable
from scan3d.errors import InputError, UsageError
from scan3d.units import Unit, length


def show(
    path: Path,
    /,
    *,
    screenshot: File | None = None,
    html: File | None = None,
    movie: File | None = None,
    view: View | None = None,
    color: Color | None = None,
    size: Annotated[str | None, Parameter(metavar="SIZE")] = None,
    dpi: Annotated[str | None, Parameter(metavar="N")] = None,
    camera: Annotated[str | None, Parameter(metavar="CAMERA", allow_leading_hyphen=True)] = None,
    truth: Mesh | None = None,
    hull: Flag = False,
    against: File | None = None,
    unit: Unit = "mm",
    overwrite: Overwrite = False,
    output: Output = Output(),
) -> int:
    """Show a scan in a window, a picture, a page or a movie.

    For example:
      scan3d show out
      scan3d show out --view compare
      scan3d show out --screenshot egg.png --view compare
      scan3d show out --screenshot egg.pdf --size 85x60mm --dpi 600 --camera 300,25
      scan3d show out --screenshot forces.svg --view forces
      scan3d show out --against other --screenshot difference.png
      scan3d show out/cloud.ply --screenshot friction.pdf --color friction
      scan3d show log.csv --html log.html --truth part.stl
      scan3d show out --movie egg.gif

    Parameters
    ----------
    path
        a scan's folder, a recording (.csv), a cloud or surface (.ply), a mesh
    screenshot
        a picture, .png, .pdf or .svg, instead of a window
    html
        an interactive page for any browser; it does not need the network
    movie
        the body as it grows, a .gif
    view
        what the picture shows (default: surface, with --color cloud); without --screenshot it is NAME-VIEW.png, here
    color
        colour of the contacts in a picture or the window (default: force)
    size
        size of the picture: WIDTH or WIDTHxHEIGHT in mm, cm, in, pt or px, such as 85mm or 85x60mm (default: 7in)
    dpi
        pixels of the picture to the inch (default: 200)
    camera
        front, back, left, right, top, bottom or iso, or AZIMUTH,ELEVATION in degrees such as 300,25; a further ,1.5 zooms
        (default: the view's)
    truth
        mesh of the true body; by default the mesh that the report names, if it is found
    hull
        take the convex hull of the true body
    against
        another scan's folder, a surface or a mesh: the colour is the signed distance of the surface from it
    unit
        unit of a mesh
    """
    if not path.exists():
        raise InputError(
            f"there is no {path}; show a scan's folder, a recording (.csv), a cloud or a surface (.ply), or a mesh"
        )
    if view and not (screenshot or html or movie):
        screenshot = Path(f"{path.resolve().stem}-{view}.png")
    _check_picture(screenshot, html or movie, {"view": view, "size": size, "dpi": dpi, "camera": camera}, color)
    if against:
        _check_against(truth or hull, movie, color, view)
    from scan3d.files.whole import check_file, write_atomic
    from scan3d.pictures import canvas, drawing, figures, page, views

    try:
        chosen = figures.sheet(size, dpi, camera)
    except InputError as error:
        raise UsageError(str(error)) from None

    if not (screenshot or html or movie):
        canvas.need_display()
    # file names are checked before the work
    if screenshot:
        views.check_path(screenshot)
    if movie:
        views.check_path(movie, views.MOVIES, "movie")
    inputs = {"file": path, "true body": truth, "other surface": against}
    for option, file in (("--html", html), ("--movie", movie), ("--screenshot", screenshot)):
        if file:
            check_file(file, inputs, overwrite, option)
    output.progress.tell("reading")
    scene = read_scene(path, truth, hull, unit)
    if truth and scene.bound is not None:
        scene = _if_refuted(output, scene, truth)
    if against:
        from scan3d.results import other_surface

        scene = scene.against(other_surface(against, scene.unit, unit))
    output.progress.tell("drawing")
    if not (screenshot or html or movie):
        output.progress.end()
        canvas.Window(scene, print, color or "force").plotter.show(title=f"{scene.name} – scan3d")
        return 0
    if html:
        write_atomic(html, page.page(scene), "--html")
    if movie:
        write_atomic(movie, drawing.draw(scene, [(movie.suffix.lower(), {})])[0], "--movie")
    if screenshot:
        shown = view or ("cloud" if color or scene.surface is None else "surface")
        write_atomic(screenshot, drawing.picture(scene, screenshot, shown, color or "force", chosen), "--screenshot")
    files = [str(file) for file in (html, movie, screenshot) if file]
    text = "\n".join(printable(f"written to {file}") for file in files)
    return print_result(output, {"shown": scene.name, "files": files}, text)


def _if_refuted(output: Output, scene: Any, truth: Path) -> Any:
    """The scene; where the body is farther from the surface than is certified, by more than the digits of files, that is said,
    and is the headline of its page."""
    from scan3d.pictures.parts import shown_surface

    _, off, bound, _ = shown_surface(scene)
    assert off is not None
    assert bound is not None
    if not (abs(off) > bound + 1e-6 * scene.diagonal).any():
        return scene
    words = f"refuted: {truth} is up to {length(abs(off).max(), scene.unit)} off the surface, more than is certified"
    output.progress.say(
        f"{words}: it is not the body that was touched, lies elsewhere or has another unit, or a premise of the certificate "
        "does not hold"
    )
    others = [row for row in scene.key_figures if row[0] != "scan"]
    return dataclasses.replace(scene, key_figures=(("scan", words), *others))


def _check_picture(
    screenshot: Path | None, other: Path | None, given: dict[str, str | None], color: Color | None
) -> None:
    for name, value in given.items():
        if value is not None and not screenshot:
            what = "says what a picture shows" if name == "view" else "is that of a picture"
            raise UsageError(f"--{name} {what}: give --screenshot FILE as well")
    if color and not screenshot and other:
        raise UsageError("--color is for a picture or the window: give --screenshot FILE as well")
    if color and given["view"] not in (None, "cloud"):
        raise UsageError(f"--color is that of the contacts in the view cloud: leave it out with --view {given['view']}")


def _check_against(truth: Any, movie: Path | None, color: Color | None, view: View | None) -> None:
    if truth:
        raise UsageError("--against takes another surface in the place of the true body: leave out --truth and --hull")
    if movie:
        raise UsageError("--against is for a picture, a page or the window: leave out --movie")
    if color or view not in (None, *WITH_OTHER):
        raise UsageError(f"--against compares surfaces: give the view {one_of(WITH_OTHER)}, and no --color")


def read_scene(path: Path, truth: Path | None, hull: bool, unit: str) -> Any:
    """The scene of a path, with the true body if it is named or found."""
    from scan3d import results
    from scan3d.files.meshes import load_mesh

    if path.suffix.lower() in (".csv", ".parquet") and not path.is_dir():
        scene = _recording_scene(path)
    else:
        scene, report = results.read_scene(path, unit)
        truth = truth or results.find_truth(path, report)
        hull = hull or results.of_hull(report)
    return dataclasses.replace(scene, truth=load_mesh(truth, hull=hull, unit=scene.unit)) if truth else scene


def _recording_scene(path: Path) -> Any:
    from scan3d import pipeline
    from scan3d.files.recordings import read_recording

    return dataclasses.replace(pipeline.to_scene(pipeline.analyse(read_recording(path))), name=path.stem)
