"""The page: complete in one file, the same for the same scan; in a browser it shows the body and turns."""

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
from browser import HEIGHT, WIDTH, Tab
from small_scans import CUBE, scanned, scanned_in_space

import scan3d
from scan3d.pictures.page import page as html_page
from scan3d.pictures.scene import Scene


@pytest.fixture(scope="module")
def cube():
    return scanned(CUBE)


def data_of(page):
    return json.loads(re.search(r'id="data">(.*?)</script>', page.decode(), re.DOTALL)[1])


def layer(page, name):
    return next(layer for layer in data_of(page)["layers"] if layer["name"] == name)


def floats(text):
    return np.frombuffer(base64.b64decode(text), "<f4")


# --- what is in it ---


def test_the_page_holds_the_scan(cube):
    page = html_page(cube)
    data = data_of(page)
    names = [layer["name"] for layer in data["layers"]]
    assert names == ["surface", "contacts", "normals", "slices", "truth"]
    contacts = layer(page, "contacts")
    points = floats(contacts["position"]).reshape(-1, 3) + data["center"]
    assert points == pytest.approx(cube.points, abs=1e-5)
    assert [scale["title"] for scale in contacts["colors"]] == [
        "kind of contact",
        "contact force in mN",
        "coefficient of friction",
        "distance from the truth in mm",
    ]
    assert floats(contacts["colors"][1]["values"]) == pytest.approx(1e3 * cube.column("force"), rel=1e-6)
    surface = layer(page, "surface")
    assert [scale["title"] for scale in surface["colors"]] == ["signed deviation in mm", "certified bound in mm"]
    deviation = surface["colors"][0]
    assert deviation["low"] == -deviation["high"]  # symmetric
    faces = np.frombuffer(base64.b64decode(surface["index"]), "<u4").reshape(-1, 3)
    assert faces.max() < len(floats(surface["position"])) / 3
    for quantity, value in cube.key_figures:
        assert f"<th>{quantity}</th><td>{value}</td>" in page.decode()


def test_the_page_of_a_scan_in_space():
    scene = scanned_in_space()
    page = html_page(scene)
    names = [layer["name"] for layer in data_of(page)["layers"]]
    assert names == ["surface", "contacts", "normals", "contact paths"]
    contacts = layer(page, "contacts")
    bending = contacts["colors"][-1]
    assert bending["title"] == "bending out of the sweep's plane in °"
    assert bending["low"] == -bending["high"]  # symmetric
    angle = scan3d.reconstruct(scene.recording).bending_angle
    assert floats(bending["values"]) == pytest.approx(np.rad2deg(np.arcsin(np.sin(angle))), abs=1e-4)
    assert set(contacts["columns"]) == {"sweep"}
    # the lines of the paths run through contacts
    lines = floats(layer(page, "contact paths")["position"]).reshape(-1, 3)
    distance = np.linalg.norm(lines[:, None] - floats(contacts["position"]).reshape(-1, 3), axis=2).min(axis=1)
    assert distance.max() == 0


def test_the_page_needs_no_other_file(cube):
    text = html_page(cube).decode()
    assert not re.findall(r"https?:|//cdn|@import|\bfetch\(|XMLHttpRequest|\bsrc=", text)
    assert "default-src 'none'" in text


def test_the_same_scene_gives_the_same_page(cube):
    assert html_page(cube) == html_page(scanned(CUBE))


def test_names_that_look_like_code_stay_text(cube):
    name = "</script><b>@DATA@ & \\1"
    text = html_page(replace(cube, name=name)).decode()
    assert "<b>" not in text
    assert "&lt;/script&gt;&lt;b&gt;@DATA@ &amp; \\1" in text
    assert data_of(text.encode())["unit"] == "mm"


@pytest.mark.parametrize("what", ["contacts", "surface"])
def test_a_page_of_a_part_shows_that_part(cube, what):
    part = Scene("part", "um", **{what: getattr(cube, what)})
    page = html_page(part)
    names = {layer["name"] for layer in data_of(page)["layers"]}
    assert names == ({"contacts", "normals", "slices"} if what == "contacts" else {"surface"})
    assert data_of(page)["unit"] == "µm"


def test_a_folder_of_an_earlier_version_has_a_page_without_player(cube):
    """Its contacts do not state their rows of the recording."""
    columns = [name for name in cube.contacts.dtype.names if name != "row"]
    page = html_page(replace(cube, contacts=cube.contacts[columns]))
    assert [layer["name"] for layer in data_of(page)["layers"]] == ["surface", "contacts", "normals", "slices", "truth"]
    assert "player" in data_of(html_page(cube))
    assert "player" not in data_of(page)


def test_the_page_runs_its_own_script_only(cube):
    """By the hash in its content security policy; without it any script that got into the page would run."""
    text = html_page(cube).decode()
    script = re.search(r"<script>(.*?)</script>", text, re.DOTALL)[1]
    digest = base64.b64encode(hashlib.sha256(script.encode()).digest()).decode()
    assert f"script-src 'sha256-{digest}'" in text
    assert text.count("<script") == 2  # this one, and the data
    assert not re.search(r"\son\w+=", text[: text.index("<script")])
    assert "eval(" not in script


def test_the_package_contains_the_empty_page():
    """And every other file beside its modules: files that no pattern matches would be missing from a wheel."""
    root = Path(__file__).parents[1]
    tool = tomllib.loads((root / "pyproject.toml").read_text(encoding="utf-8"))["tool"]["setuptools"]
    folders = {module.parent for package in ("planar", "scan3d") for module in (root / package).rglob("*.py")}
    matched = set()
    for folder in folders:
        name = ".".join(folder.relative_to(root).parts)
        assert (folder / "__init__.py").is_file()
        assert any(fnmatch.fnmatch(name, pattern) for pattern in tool["packages"]["find"]["include"])
        data = {path for pattern in tool["package-data"].get(name, ()) for path in folder.glob(pattern)}
        assert data == {path for path in folder.iterdir() if path.is_file() and path.suffix not in (".py", ".pyc")}
        matched |= data
    assert {root / "scan3d" / "pictures" / name for name in ("page.html", "page.css", "page_view.js")} <= matched


def test_a_page_of_nothing():
    with pytest.raises(scan3d.InputError, match="void has nothing to show: neither contacts nor a surface"):
        html_page(Scene("void", "mm"))


# --- in a browser ---


@pytest.fixture(scope="module")
def tab(browser_path, cube, tmp_path_factory):
    folder = tmp_path_factory.mktemp("page")
    (folder / "page.html").write_bytes(html_page(cube))
    tab = Tab(browser_path, folder / "profile")
    try:
        tab.open(folder / "page.html")
        yield tab
    finally:
        tab.close()


def blue(image):
    """Pixels as blue as the cube's top, which lies farthest below the truth."""
    return (image[:, :, 2] - image[:, :, 0] > 50) & (image[:, :, 0] < 40)


def drawn(image):
    """Right of the panel, above the player: what isn't white."""
    return (image[:460, 320:] < 250).any(axis=2)


@pytest.mark.browser
@pytest.mark.slow
def test_the_page_in_a_browser(tab, cube):
    first = tab.picture()
    assert first.shape == (HEIGHT, WIDTH, 3)
    # the body, in the middle of the space right of the panel, on a white page
    assert 0.2 < drawn(first).mean() < 0.8
    assert drawn(first)[250:350, 240:340].all()
    assert not drawn(first)[:, -20:].any()
    assert blue(first[:460, 320:]).mean() > 0.03
    assert tab.run("document.querySelector('table').innerText") == "\n".join(map("\t".join, cube.key_figures))

    # it turns with the mouse: the top goes out of sight when it is looked at from the side
    tab.drag((600, 250), (640, 193))
    turned = tab.picture()
    assert (np.abs(turned - first).max(axis=2) > 20).mean() > 0.1
    assert blue(turned[:460, 320:]).mean() < 0.2 * blue(first[:460, 320:]).mean()

    # the wheel zooms, a double click goes back
    tab.mouse("mouseWheel", 600, 300, deltaX=0, deltaY=600)
    assert drawn(tab.picture()).mean() < 0.5 * drawn(turned).mean()
    for count in (1, 2):
        tab.mouse("mousePressed", 880, 20, button="left", buttons=1, clickCount=count)
        tab.mouse("mouseReleased", 880, 20, button="left", clickCount=count)
    assert (np.abs(tab.picture() - first).max(axis=2) > 20).mean() < 1e-3

    # meanwhile no errors, and no access to the network
    assert tab.complaints() == []


@pytest.mark.browser
@pytest.mark.slow
def test_layers_and_colours_in_a_browser(tab):
    before = tab.picture()
    tab.run("for (const box of document.querySelectorAll('input')) if (box.checked) box.click()")
    assert not drawn(tab.picture()).any()
    shown = {}
    for name in tab.run("[...document.querySelectorAll('#layers input')].map(box => box.name)"):
        tab.run(f"document.querySelector('input[name=\"{name}\"]').click()")
        shown[name] = drawn(tab.picture()).mean()
        tab.run(f"document.querySelector('input[name=\"{name}\"]').click()")
    layers = {"surface", "contacts", "normals", "slices", "truth", "axes and scale"}
    assert set(shown) == {*layers, "rod, clamp and reactions", "rods along the sweep"}
    assert min(shown.values()) > 1e-3
    assert shown["truth"] == pytest.approx(shown["surface"], rel=0.05)
    assert shown["normals"] < shown["surface"]

    again = "['surface', 'contacts', 'axes and scale']"
    tab.run(f'for (const name of {again}) document.querySelector(`input[name="${{name}}"]`).click()')
    tab.run("switchPlayer(false); reset()")
    assert (np.abs(tab.picture() - before).max(axis=2) > 20).mean() < 1e-3
    choose = "const s = document.querySelector('select'); s.selectedIndex = {}; s.onchange(); s.value"
    assert tab.run("{" + choose.format(2) + "}") == "plain"
    plain = tab.picture()
    assert not blue(plain[:460, 320:]).any()
    assert tab.run("{" + choose.format(1) + "}") == "certified bound in mm"
    assert (np.abs(tab.picture() - plain).max(axis=2) > 20).mean() > 0.05
    assert tab.complaints() == []


@pytest.mark.browser
def test_a_click_shows_what_was_measured(tab, cube):
    panel = "document.getElementById('picked')"
    tab.mouse("mousePressed", 880, 300, button="left", buttons=1, clickCount=1)
    tab.mouse("mouseReleased", 880, 300, button="left", clickCount=1)
    assert tab.run(panel + ".hidden") is True
    place = """(() => {
      const p = data.layers.find(layer => layer.kind === "points").points, m = turned(), {w, h, scale, shift} = measures();
      let best = 0, front = -1e9;
      for (let k = 0; k < p.length; k += 3) {
        const d = m[2] * p[k] + m[5] * p[k + 1] + m[8] * p[k + 2];
        if (d > front) { front = d; best = k; }
      }
      const [u, v] = [0, 1].map(i => m[i] * p[best] + m[3 + i] * p[best + 1] + m[6 + i] * p[best + 2]);
      return [best / 3, (u * scale[0] + shift[0] + 1) * w / 2, (1 - v * scale[1] - shift[1]) * h / 2];
    })()"""
    contact, x, y = tab.run(place)
    tab.mouse("mousePressed", x, y, button="left", buttons=1, clickCount=1)
    tab.mouse("mouseReleased", x, y, button="left", clickCount=1)
    text = tab.run(panel + ".textContent")
    assert text.startswith(f"contact {contact}\n")
    assert f"sweep {cube.column('sweep')[contact]:.0f}\n" in text
    point = [float(coordinate) for coordinate in re.findall(r"[xyz] = (\S+) mm", text)]
    assert point == pytest.approx(cube.points[contact], abs=1e-3)


def test_the_truth_is_that_of_the_mesh(cube):
    truth = layer(html_page(cube), "truth")
    size = np.ptp(floats(truth["position"]).reshape(-1, 3), axis=0)
    assert size == pytest.approx(scan3d.load_mesh(CUBE).extents, rel=1e-6)
