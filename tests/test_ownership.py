"""Whose files there are: own inputs are never overwritten, and other files only where the user asks for it."""

import os
import re
import shutil
from dataclasses import replace
from pathlib import Path

import pytest
from matplotlib.figure import Figure
from small_scans import CUBE, EGG, FEW, scanned

import scan3d
from scan3d.cli import main
from scan3d.files.shapes import CLOUD_ENDINGS, SURFACE_ENDINGS, export
from scan3d.files.whole import RECORDING, check_file, earlier_files
from scan3d.pictures import figures
from scan3d.pictures.page import page
from scan3d.results import read_report, scene_of_folder

FOREIGN = "can't be recognised as written by scan3d; give --overwrite"
NEVER = "is the {} that this run reads, which is never overwritten; choose another place with {}"


@pytest.fixture
def folder(folder, tmp_path, monkeypatch, no_pictures):
    monkeypatch.chdir(tmp_path)
    shutil.copytree(folder, tmp_path / "out")
    shutil.copy(EGG, tmp_path / "egg.stl")
    return tmp_path / "out"


def tree(place=Path()):
    return {str(path): path.read_bytes() for path in place.rglob("*") if path.is_file()}


@pytest.fixture
def refused(capsys, monkeypatch):
    """A function that checks that a command is refused in a sentence before it computes, and changes nothing."""

    def check(arguments, sentence):
        before = tree()
        capsys.readouterr()
        with monkeypatch.context() as patched:
            for name in ("simulation.scan.simulate", "pipeline.analyse", "pictures.page.page", "pictures.views.movie"):
                patched.setattr(f"scan3d.{name}", lambda *_, **__: pytest.fail("it was computed"))
            assert main([str(argument) for argument in arguments]) == 1
        stdout, stderr = capsys.readouterr()
        assert stdout == ""
        assert re.fullmatch(rf"scan3d: .*{sentence}.*\n", stderr), stderr
        assert tree() == before

    return check


@pytest.mark.slow
@pytest.mark.parametrize(
    ("overwrite", "link"), [((), None), (("--overwrite",), None), (("--overwrite",), os.symlink), ((), os.link)]
)
def test_a_run_never_overwrites_what_it_reads(folder, refused, overwrite, link):
    mesh = Path("out/surface.ply")
    if link:
        link(mesh.resolve(), "link.ply")
        mesh = Path("link.ply")
    refused(["scan", mesh, "--out", "out", *FEW, *overwrite], rf"out/surface\.ply {NEVER.format('mesh', '--out')}")
    refused(
        ["reconstruct", "out/recording.csv", "--truth", mesh, "--out", "out", *overwrite],
        rf"surface\.ply {NEVER.format('true body', '--out')}",
    )
    for option, name in (("--html", "a.html"), ("--screenshot", "a.png"), ("--movie", "a.gif")):
        (link or shutil.copy)(EGG, name)
        source = EGG if link else name
        refused(["show", source, option, name, *overwrite], rf"{name} {NEVER.format('file', option)}")
        refused(["show", "out", "--truth", source, option, name, *overwrite], NEVER.format("true body", option))
    shutil.copy("out/cloud.ply", "cloud copy.ply")
    refused(["export", "cloud copy.ply", "--to", "cloud copy.ply", *overwrite], NEVER.format("source", "--to"))
    Path("log.toml").write_text("slices = 3\n")
    sentence = NEVER.format("file of settings", "--out")
    refused(["simulate", CUBE, "--config", "log.toml", "--out", "log.csv", *overwrite], rf"log\.toml {sentence}")
    os.replace("log.toml", "out/recording.toml")
    refused(["scan", CUBE, "--config", "out/recording.toml", "--out", "out", *overwrite], sentence)


@pytest.mark.slow
def test_a_result_replaces_only_what_the_program_wrote(folder, refused):
    scan = ["scan", str(CUBE), "--out", "out", *FEW]
    # by another program, and changed since it was written
    for name, since in (("cloud.png", ""), ("recording.toml", " or was changed since")):
        with open(folder / name, "ab") as file:
            file.write(b"\n")
        refused(
            scan, rf"{name} was not written by scan3d{since}.*; give --overwrite .* to replace it, or choose .* --out"
        )
    # the recording that this run reads stays that of the user
    os.unlink(folder / "cloud.png")
    assert main(["reconstruct", "out/recording.csv", "--out", "out", "--quiet"]) == 0
    assert "recording.toml" not in earlier_files(folder)
    assert main([*scan, "--overwrite"]) == 0
    for report in ("{}", "[1]", "Dear Sir or Madam", '{"files": ["report.json"], "versions": {"pandas": "2"}}'):
        (folder / "report.json").write_text(report)
        refused(scan, r"was not written by scan3d; give --overwrite")
    (folder / "cloud.png").mkdir()
    refused([*scan, "--overwrite"], r"can't write .*cloud\.png: Is a directory")


@pytest.mark.slow
def test_reconstruct_has_its_own_recording_beside_its_cloud(folder, refused):
    for name in RECORDING:
        shutil.copy(f"out/{name}", name.replace("recording", "log"))
    # its own input stays, and still counts as written by the program
    assert main(["reconstruct", "out/recording.csv", "--out", "out", "--quiet"]) == 0
    assert earlier_files(folder).keys() == {path.name for path in folder.iterdir()} >= {*RECORDING}
    # with another TOML file it is not the same recording
    Path("link.csv").symlink_to(folder / "recording.csv")
    shutil.copy("log.toml", "link.toml")
    refused(["reconstruct", "link.csv", "--out", "out"], r"recording\.csv is the recording that this run reads")
    # that of another run is replaced
    Path("log.csv").write_text("".join(Path("log.csv").read_text().splitlines(keepends=True)[:-1]))
    assert main(["reconstruct", "log.csv", "--out", "out", "--quiet"]) == 0
    assert (folder / "recording.csv").read_bytes() == Path("log.csv").read_bytes()
    # one that the user has put there is not
    (folder / "recording.csv").write_text(Path("log.csv").read_text() + "\n")
    refused(
        ["reconstruct", "log.csv", "--out", "out"], r"recording\.csv was not written by scan3d or was changed since"
    )
    # as the input of a run it belongs to the result, but remains the user's
    refused(["reconstruct", "out/recording.csv", "--table", "-9", "--out", "out"], "out keeps the recording .* --table")
    assert main(["reconstruct", "out/recording.csv", "--out", "out", "--quiet"]) == 0
    assert scene_of_folder(folder, read_report(folder), "mm").recording is not None
    assert "recording.csv" not in earlier_files(folder)


@pytest.mark.parametrize("overwrite", [(), ("--overwrite",)])
def test_no_file_of_a_result_is_replaced_by_another(folder, refused, overwrite):
    for name in ("cloud.ply", "surface.ply", "report.json", "view.html", "cloud.png", "recording.csv"):
        sentence = rf"{name} belongs to the scan in out; choose another place with "
        if name.endswith((".ply", ".csv")):
            refused(["export", "out", "--to", f"out/{name}", *overwrite], f"{sentence}--to")
        if name == "recording.csv":
            refused(
                ["simulate", CUBE, "--out", f"out/{name}", *FEW, *overwrite], "belongs to the scan in out; .* --out"
            )
        if name.endswith(".png"):
            refused(["show", "out", "--screenshot", f"out/{name}", *overwrite], f"{sentence}--screenshot")
        refused(["show", "out", "--html", f"out/{name}", *overwrite], f"{sentence}--html")


@pytest.mark.parametrize("overwrite", [(), ("--overwrite",)])
def test_devices_pipes_and_folders_are_not_replaced(folder, refused, overwrite):
    Path("folder.png").mkdir()
    refused(["show", "out", "--screenshot", "folder.png", *overwrite], r"can't write folder\.png: Is a directory")
    if os.name != "nt":
        os.mkfifo("pipe.html")
        Path("device.stl").symlink_to("/dev/null")
        refused(["show", "out", "--html", "pipe.html", *overwrite], r"pipe\.html: it is a device or a pipe; .* --html")
        refused(["export", "out", "--to", "device.stl", *overwrite], r"device\.stl: it is a device or a pipe; .* --to")
        assert Path("pipe.html").is_fifo()


@pytest.mark.parametrize("ending", [*CLOUD_ENDINGS[:-1], *SURFACE_ENDINGS])
def test_an_export_replaces_an_earlier_one_and_nothing_else(folder, ending):
    to = Path(f"exported{ending}")
    what = "surface" if ending in SURFACE_ENDINGS else "cloud"
    export(folder, to, what)
    first = to.read_bytes()
    export(folder, to, what)
    assert to.read_bytes() == first
    # that of another scan; points as bare numbers can't be recognised
    shutil.copytree(folder, "other")
    is_bare = ending in (".xyz", ".xyzn")
    export("other", to, what, unit=None if ending == ".glb" else "m", overwrite=is_bare or ending == ".csv")
    assert ending == ".glb" or to.read_bytes() != first
    touches = b"x_mm,y_mm,z_mm,nx,ny,nz\n1,2,3,0,0,1\n"
    for foreign in (b"", b"ply\ncomment a surface\n", b"0.5 1.5 2.5\n", b"x_m,y_m,z_m,fx_N\n", touches):
        to.write_bytes(foreign)
        with pytest.raises(scan3d.InputError, match=FOREIGN):
            export(folder, to, what)
        assert to.read_bytes() == foreign
    export(folder, to, what, overwrite=True)
    assert to.read_bytes() == first


@pytest.mark.parametrize("name", ["a.html", "a.png", "a.pdf", "a.svg"])
def test_pages_and_pictures_can_be_recognised(tmp_path, name):
    path = tmp_path / name
    if name == "a.html":
        path.write_bytes(page(scanned(CUBE)))
    else:
        figures.save(Figure(), path)
    check_file(path, {}, overwrite=False, option="--out")
    path.write_bytes(b"of the user")
    with pytest.raises(scan3d.InputError, match=FOREIGN):
        check_file(path, {}, overwrite=False, option="--out")


def test_a_recording_replaces_a_simulated_one_and_nothing_else(folder, refused):
    simulate = ["simulate", CUBE, "--out", "log.csv", *FEW]
    for _ in range(2):
        assert main([*map(str, simulate)]) == 0
    toml = Path("log.toml").read_text()
    for other in ("[tool]\nname = 'x'\n", "not TOML", toml.replace("simulation", "laboratory")):
        Path("log.toml").write_text(other)
        refused(simulate, r"log\.toml can't be recognised as a simulation by scan3d; give --overwrite")
        with pytest.raises(
            scan3d.InputError, match=r"log\.toml can't be recognised as a simulation by scan3d; .* path"
        ):
            scan3d.write_recording(scanned(CUBE).recording, "log.csv")
    Path("log.toml").unlink()
    refused(simulate, r"log\.csv can't be recognised as a simulation by scan3d; give --overwrite")
    before = Path("log.csv").read_bytes()
    with pytest.raises(scan3d.InputError, match=r"log\.csv can't be recognised as a simulation by scan3d; .* path"):
        scan3d.write_recording(scanned(CUBE).recording, "log.csv")
    assert Path("log.csv").read_bytes() == before
    assert not Path("log.toml").exists()
    with pytest.raises(scan3d.InputError, match=r"log\.csv can't be recognised as a recording by scan3d; .* path"):
        scan3d.write_recording(replace(scanned(CUBE).recording, source={}), "log.csv")
    assert main([*map(str, simulate), "--overwrite"]) == 0
    assert "simulation" in Path("log.toml").read_text()


@pytest.mark.slow
@pytest.mark.parametrize("name", ["cloud.ply", "surface.ply", *RECORDING])
def test_a_file_that_does_not_belong_to_the_report_is_not_shown_with_it(folder, capsys, name):
    with open(folder / name, "ab") as file:
        file.write(b"\n")
    assert main(["show", "out", "--html", "a.html"]) == 1
    sentence = f"out/{name} is not the file that report.json beside it names: it was changed, or is of another run"
    assert sentence in capsys.readouterr().err
    assert not Path("a.html").exists()
    if name.endswith(".ply"):
        assert main(["export", "out", "--what", name.removesuffix(".ply"), "--to", "a.ply"]) == 1
        assert sentence in capsys.readouterr().err
        # nor without the report that would say so
        report = (folder / "report.json").read_text()
        (folder / "report.json").write_text(report[: len(report) // 2])
        assert main(["export", "out", "--what", name.removesuffix(".ply"), "--to", "a.ply"]) == 1
        assert "report.json" in capsys.readouterr().err
        (folder / "report.json").write_text(report)
    # files that were removed are missed by nobody
    (folder / name).unlink()
    assert main(["show", "out", "--html", "a.html"]) == (1 if name == "recording.toml" else 0)
