"""The page: complete in one file, the same for the same scan; its data are those of the scan and of its recording."""

import base64
import fnmatch
import hashlib
import json
import re
import tomllib
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from small_scans import CUBE, ring, scanned, scanned_in_space

import scan3d
from scan3d.pictures.page import page, player
from scan3d.pictures.parts import Scene
from scan3d.units import FORCES, MOMENTS


def array(data):
    ((kind, text),) = data.items()
    return np.frombuffer(base64.b64decode(text), f"<{kind}")


def data_of(text):
    return json.loads(re.search(r'id="data">(.*?)</script>', text.decode(), re.DOTALL)[1])


def layers_of(text):
    return {layer["name"]: layer for layer in data_of(text)["layers"]}


def test_the_page_holds_the_scan(cube):
    text = page(cube)
    layers, center = layers_of(text), data_of(text)["center"]
    assert list(layers) == ["surface", "contacts", "normals", "slices", "truth"]
    points = array(layers["contacts"]["points"]).reshape(-1, 3) + center
    assert points == pytest.approx(cube.points, abs=1e-5)
    colors = layers["contacts"]["colors"]
    assert [scale["title"] for scale in colors] == [
        "kind of contact",
        "contact force in mN",
        "coefficient of friction",
        "distance from the truth in nm",
    ]
    assert array(colors[1]["values"]) == pytest.approx(1e3 * cube.column("force"), rel=1e-6)
    deviation, bound = layers["surface"]["colors"]
    assert (deviation["title"], bound["title"]) == ("signed deviation in µm", "certified bound in µm")
    assert deviation["low"] == -deviation["high"]  # symmetric
    assert array(layers["surface"]["faces"]).max() < len(array(layers["surface"]["points"])) / 3
    size = np.ptp(array(layers["truth"]["points"]).reshape(-1, 3), axis=0)
    assert size == pytest.approx(scan3d.load_mesh(CUBE).extents, rel=1e-6)
    for quantity, value in cube.key_figures:
        assert f"<th>{quantity}</th><td>{value}</td>" in text.decode()
    assert page(cube) == text


@pytest.mark.slow
def test_the_page_of_a_scan_in_space():
    scene = scanned_in_space()
    layers = layers_of(page(scene))
    assert list(layers) == ["surface", "contacts", "normals", "contact paths"]
    bending = layers["contacts"]["colors"][-1]
    assert bending["title"] == "bending out of the sweep's plane in °"
    assert bending["low"] == -bending["high"]  # symmetric
    angle = scan3d.reconstruct(scene.recording).bending_angle
    assert array(bending["values"]) == pytest.approx(np.rad2deg(np.arcsin(np.sin(angle))), abs=1e-4)
    assert set(layers["contacts"]["columns"]) == {"sweep"}
    # the lines of the paths run through contacts
    lines, contacts = (array(layers[name]["points"]).reshape(-1, 3) for name in ("contact paths", "contacts"))
    assert np.linalg.norm(lines[:, None] - contacts, axis=2).min(axis=1).max() == 0


def test_the_page_needs_no_other_file_and_runs_its_own_script_only(cube):
    """By the hash in its content security policy; without it any script that got into the page would run."""
    text = page(cube).decode()
    assert not re.findall(r"https?:|//cdn|@import|\bfetch\(|XMLHttpRequest|\bsrc=", text)
    script = re.search(r"<script>(.*?)</script>", text, re.DOTALL)[1]
    digest = base64.b64encode(hashlib.sha256(script.encode()).digest()).decode()
    assert "default-src 'none'" in text
    assert f"script-src 'sha256-{digest}'" in text
    assert text.count("<script") == 2  # this one, and the data
    assert not re.search(r"\son\w+=", text[: text.index("<script")])
    assert "eval(" not in script


def test_names_that_look_like_code_stay_text(cube):
    text = page(replace(cube, name="</script><b>@DATA@ & \\1")).decode()
    assert "<b>" not in text
    assert "&lt;/script&gt;&lt;b&gt;@DATA@ &amp; \\1" in text
    assert data_of(text.encode())["unit"] == "mm"


@pytest.mark.parametrize(
    ("what", "names"), [("contacts", {"contacts", "normals", "slices"}), ("surface", {"surface"}), (None, None)]
)
def test_a_page_of_a_part_shows_that_part(cube, what, names):
    part = Scene("part", "um", **({what: getattr(cube, what)} if what else {}))
    if what is None:
        with pytest.raises(scan3d.InputError, match="part has nothing to show: neither contacts nor a surface"):
            page(part)
        return
    text = page(part)
    assert set(layers_of(text)) == names
    assert data_of(text)["unit"] == "µm"


def test_the_package_contains_every_file_beside_its_modules():
    """Files that no pattern matches would be missing from a wheel."""
    root = Path(__file__).parents[1]
    tool = tomllib.loads((root / "pyproject.toml").read_text(encoding="utf-8"))["tool"]["setuptools"]
    for folder in {module.parent for package in ("planar", "scan3d") for module in (root / package).rglob("*.py")}:
        name = ".".join(folder.relative_to(root).parts)
        assert (folder / "__init__.py").is_file()
        assert any(fnmatch.fnmatch(name, pattern) for pattern in tool["packages"]["find"]["include"])
        data = {path for pattern in tool["package-data"].get(name, ()) for path in folder.glob(pattern)}
        assert data == {path for path in folder.iterdir() if path.is_file() and path.suffix not in (".py", ".pyc")}


def test_the_clamp_travels_along_the_rod_in_probings():
    data, scene = player(ring(), np.zeros(3)), ring()
    starts, travel = data["starts"], array(data["travel"])
    probings = scene.recording.in_probings[[np.flatnonzero(scene.recording.sweep == k)[0] for k in data["numbers"]]]
    last = travel[np.append(starts[1:], len(travel)) - 1]
    assert probings.any()
    assert (last[probings] > 1.0).all()


@pytest.mark.slow
@pytest.mark.parametrize("model", ["planar", "spatial"])
def test_the_player_has_the_poses_and_reactions_of_the_recording(model):
    scene = scanned(CUBE) if model == "planar" else scanned_in_space()
    center = np.array([1.0, -2.0, 3.0])
    data, recording = player(scene, center), scene.recording
    of_contact, rows = array(data["contact"]), scene.column("row").astype(int)
    position = array(data["position"]).reshape(-1, 3) + center
    assert position[of_contact] == pytest.approx(1e3 * recording.position_m[rows], abs=1e-4)
    width = sum(len(chart["names"]) for chart in data["labels"])
    reactions = array(data["reactions"]).reshape(len(position), width)
    force, moment = recording.force_N, recording.moment_Nm[:, None]
    if width == 6:
        force, moment = recording.wrench()
    units = [chart["title"].partition(" in ")[2] for chart in data["labels"] for _ in chart["names"]]
    expected = np.hstack([force, moment])[rows] / [float((FORCES | MOMENTS)[unit]) for unit in units]
    assert reactions[of_contact] == pytest.approx(expected, rel=1e-6)
    # the orientation of a sample is the last one that begins at it or before
    turned, turns = array(data["turned"]), array(data["turns"]).reshape(-1, 3, 3)
    chosen = turns[np.searchsorted(turned, of_contact, "right") - 1]
    assert chosen == pytest.approx(recording.axes()[rows], abs=1e-6)
    # every sample is in the sweep of its contact, whose largest force and moment, and whose travel are known
    sweeps = np.searchsorted(data["starts"], of_contact, "right") - 1
    assert np.array_equal(np.array(data["numbers"])[sweeps], scene.column("sweep"))
    part = reactions[data["starts"][1] : data["starts"][2]]
    middle = width - width // 2
    largest = [np.linalg.norm(columns, axis=1).max() for columns in (part[:, :middle], part[:, middle:])]
    assert data["largest"][1] == pytest.approx(largest, rel=1e-6)
    travel = array(data["travel"])[: data["starts"][1]]
    assert travel[0] == 0
    assert (np.diff(travel) > 0).all()
    assert data["length"] == pytest.approx(1e3 * recording.rod.length_m)
