"""The page as an instrument, in headless Chromium: player, links, histogram, cutting plane, distances, pictures, keys."""

import json
import re
import time
from dataclasses import replace

import numpy as np
import pytest
from browser import HEIGHT, SECONDS, WIDTH, Tab
from PIL import Image
from small_scans import CUBE, scanned, scanned_in_space

from scan3d.geometry.distance import distances
from scan3d.pictures.page import page as html_page
from scan3d.pictures.parts import shown_surface, shown_sweep

pytestmark = [pytest.mark.browser, pytest.mark.slow]
CONTACTS = 100_000
NUMBER = r"[-−]?[\d.]+(?:e[-−]?\d+)?"


@pytest.fixture(scope="module")
def cube():
    return scanned(CUBE)


def opened(browser_path, scene, folder, **size):
    (folder / "page.html").write_bytes(html_page(scene))
    tab = Tab(browser_path, folder / "profile")
    tab.open(folder / "page.html", **size)
    return tab


@pytest.fixture(scope="module")
def browser_tab(browser_path, cube, tmp_path_factory):
    tab = opened(browser_path, cube, tmp_path_factory.mktemp("page"))
    yield tab
    tab.close()


@pytest.fixture
def tab(browser_tab):
    """The page as it is when it has just been opened; every test leaves it without complaints."""
    browser_tab("Page.reload")
    browser_tab.events.clear()
    while not any(event["method"] == "Page.loadEventFired" for event in browser_tab.events):
        browser_tab.receive()
    yield browser_tab
    assert browser_tab.complaints() == []


def place_of(tab, selector):
    """The middle of an element, scrolled into view."""
    script = f"""(() => {{ const e = document.querySelector({json.dumps(selector)}); e.scrollIntoView({{block: "nearest"}});
      const r = e.getBoundingClientRect(); return [r.x + r.width / 2, r.y + r.height / 2]; }})()"""
    return tab.run(script)


def press(tab, selector):
    tab.click(*place_of(tab, selector))


def front_contacts(tab):
    """Contacts that are seen, with their places on the screen: those that the page finds there."""
    return tab.run("""(() => { const found = [], p = contactLayer().points;
      for (let k = 0; k < p.length / 3; k += 7) {
        const [x, y] = onScreen(contactPoint(k));
        const at = contactAt(x, y);
        if (at === k && document.elementFromPoint(x, y) === canvas) found.push([k, x, y]);
      }
      return found; })()""")


def wait_for(tab, expression):
    end = time.monotonic() + SECONDS
    while not tab.run(expression):
        assert time.monotonic() < end, expression
        time.sleep(0.02)


def sample_of(scene, contact):
    """The values at a contact as the page's text has them."""
    row = int(scene.column("row")[contact])
    force, moment = 1e3 * scene.recording.force_N[row], 1e6 * scene.recording.moment_Nm[row]
    return [*force, moment]


def reactions_in(text):
    return [float(value.replace("−", "-")) for value in re.findall(rf"[fm]0[xyz]\s=\s({NUMBER})", text)]


# --- the player ---


@pytest.mark.parametrize("model", ["planar", "spatial"])
def test_the_rod_in_the_page_is_the_elastic_line(browser_path, tmp_path, model, cube):
    """Against `planar.elastic_lines`, which computes it in closed form: within a hundredth of a pixel, 1e-5 rod lengths."""
    scene = cube if model == "planar" else scanned_in_space()
    tab = opened(browser_path, scene, tmp_path)
    try:
        sweep = shown_sweep(scene)
        first = tab.run(f"player.numbers.indexOf({sweep.number})")
        samples = np.flatnonzero(scene.column("sweep") == sweep.number)
        rods = tab.run(
            f"[...player.contact].filter(k => sweepOf(k) === {first}).map(k => {{ const r = rodAt(k);"
            " return [r.base, r.points[r.contact], r.points[r.points.length - 1], r.force, r.moment]; })"
        )
        assert len(rods) == len(samples) == len(sweep.base)
        base, contact, tip, force, moment = np.array(rods).transpose(1, 0, 2)
        center = np.array(tab.run("data.center"))
        length = 1e3 * scene.recording.rod.length_m
        assert base + center == pytest.approx(sweep.base, abs=1e-5 * length)
        assert np.abs(contact + center - sweep.contact).max() < 1e-5 * length
        assert np.abs(tip + center - sweep.rods[:, -1]).max() < 1e-5 * length
        # the reactions point where they do in the world
        rows = scene.column("row")[samples].astype(int)
        recording = scene.recording
        if model == "spatial":
            wrench = recording.wrench()
        else:
            zero = np.zeros(len(recording))
            wrench = np.column_stack([recording.force_N, zero]), np.column_stack([zero, zero, recording.moment_Nm])
        for drawn, scale, expected in zip((force, moment), (1e3, 1e6), wrench, strict=True):
            world = scale * np.einsum("ni,nij->nj", expected[rows], recording.axes()[rows])
            assert np.abs(drawn - world).max() < 1e-5 * np.abs(world).max()
        assert tab.complaints() == []
    finally:
        tab.close()


def test_mouse_and_keys_move_the_player(tab, cube):
    assert tab.run("[dock.hidden, curves.hidden, player.on]") == [False, True, False]
    body = tab.picture()
    press(tab, "#charts")
    assert tab.run("[curves.hidden, player.on, byId('charts').getAttribute('aria-pressed')]") == [False, True, "true"]
    assert (np.abs(tab.picture() - body).max(axis=2) > 20).mean() > 0.05
    # the sliders by keys, as a user without a mouse has them
    tab.run("byId('sample').focus()")
    before = tab.run("player.sample")
    tab.key("ArrowRight")
    tab.key("ArrowRight")
    assert tab.run("player.sample") == before + 2
    tab.run("byId('sweep').focus()")
    number = tab.run("player.sweep")
    tab.key("ArrowLeft")
    assert tab.run("player.sweep") == number - 1
    sweep = tab.run("player.numbers[player.sweep]")
    assert tab.run("byId('sweep').getAttribute('aria-valuetext')") == f"sweep {sweep}"
    tab.key("Home")
    assert tab.run("[player.sweep, player.sample]") == [0, tab.run("player.sample")]
    # in the view, by keys of their own
    tab.run("canvas.focus()")
    before = tab.run("player.sample")
    tab.key(".")
    assert tab.run("player.sample") == before + 1
    tab.key(",")
    tab.key("]")
    assert tab.run("player.sweep") == 1
    tab.key("[")
    tab.picture()
    # what stands there are the recording's numbers
    contact = tab.run("player.contactOf[player.sample]")
    assert contact >= 0
    text = tab.run("now.textContent")
    assert text.startswith(f"sweep {cube.column('sweep')[contact]:.0f} ")
    assert reactions_in(text) == pytest.approx(sample_of(cube, contact), rel=6e-3, abs=1e-9)


def test_it_plays_to_the_end_and_through_all_sweeps(tab):
    tab.run("goTo(0, 0); byId('speed').selectedIndex = 3")
    press(tab, "#play")
    assert tab.run("byId('play').getAttribute('aria-label')") == "pause"
    wait_for(tab, "!player.playing")
    assert tab.run("[player.sweep, player.sample]") == [0, tab.run("player.starts[1] - 1")]
    press(tab, "#through")
    press(tab, "#play")
    wait_for(tab, "player.sweep >= 3")
    press(tab, "#play")
    assert not tab.run("player.playing")
    stopped = tab.run("player.sample")
    tab.picture()
    assert tab.run("player.sample") == stopped


def test_contacts_and_curves_are_linked_both_ways(tab):
    press(tab, "#charts")
    tab.picture()
    seen = front_contacts(tab)
    assert len(seen) > 10
    contact, x, y = seen[len(seen) // 2]
    # the contact under the pointer is shown in the curves, as long as it is there
    chosen = tab.run("player.sample")
    tab.mouse("mouseMoved", x, y)
    wait_for(tab, f"marks.hovered === {contact}")
    tab.picture()
    assert tab.run("shownSample()") == tab.run(f"player.contact[{contact}]") != chosen
    assert f"sweep {tab.run(f'contactLayer().columns.sweep[{contact}]')} " in tab.run("now.textContent")
    tab.mouse("mouseMoved", 890, 5)
    wait_for(tab, "marks.hovered === -1")
    assert tab.run("shownSample()") == chosen
    # a click chooses it
    tab.click(x, y)
    assert tab.run("player.sample") == tab.run(f"player.contact[{contact}]")
    assert tab.run("picked.textContent").startswith(f"contact {contact}\n")

    # a place in a chart shows its sample and contact in the view, a click chooses it
    tab.run("goTo(0, 0); redraw()")
    before = tab.picture()
    frames = tab.run("(() => { const r = curves.getBoundingClientRect();"
                     " return curveFrames().map(f => [r.x + f.x, f.w, r.y + f.y + f.h / 2]); })()")  # fmt: skip
    assert len(frames) == 3
    travel = np.array(tab.run("[...travelOf(0)]"))
    assert travel[0] == 0
    assert (np.diff(travel) > 0).all()
    chosen = 0
    for k, (left, width, middle) in zip((3, len(travel) // 2, len(travel) - 2), frames, strict=True):
        at = left + width * travel[k] / travel[-1]
        tab.mouse("mouseMoved", at, middle)
        assert tab.run("[shownSample(), player.sample]") == [k, chosen]
        tab.click(at, middle)
        assert tab.run("player.sample") == k
        chosen = k
    tab.mouse("mouseMoved", 890, 5)
    assert (np.abs(tab.picture() - before).max(axis=2) > 20).mean() > 1e-3


# --- values ---


def test_the_histogram_counts_area(tab, cube):
    mesh, deviation, bound = shown_surface(cube)
    weight = np.zeros(len(mesh.vertices))
    np.add.at(weight, np.asarray(mesh.faces), np.asarray(mesh.area_faces)[:, None] / 3)
    largest = np.abs(deviation).max()
    choose = "{{ const s = document.querySelector('#layers select'); s.selectedIndex = {}; s.onchange(); }}"
    for k, (values, low, high) in enumerate([(deviation, -largest, largest), (bound, 0, cube.bound.max())]):
        tab.run(choose.format(k))
        legend = "document.querySelector('#layers .legend')"
        shares = np.array(
            tab.run(f"[...{legend}.querySelectorAll('.histogram > span')].map(bar => +bar.dataset.share)")
        )
        expected = np.histogram(np.clip(values, low, high), 32, (low, high), weights=weight)[0] / weight.sum()
        # values of equal size at an edge of a bin may be rounded into the next
        assert shares.sum() == pytest.approx(1)
        assert np.abs(np.cumsum(shares) - np.cumsum(expected)).max() < 0.02
        note = tab.run(f"{legend}.querySelector('.note').textContent")
        quantiles = [float(q.replace("−", "-")) for q in re.search("below (.*?);", note)[1].split(", ")]
        order = np.argsort(values)
        share = np.cumsum(weight[order]) / weight.sum()
        for part, quantile in zip((0.05, 0.5, 0.95), quantiles, strict=True):
            near = values[order][np.searchsorted(share, [part - 0.01, part + 0.01])]
            assert near[0] - 6e-3 * abs(near[0]) <= quantile <= near[1] + 6e-3 * abs(near[1])
        heights = tab.run(f"[...{legend}.querySelectorAll('.histogram > span')].map(bar => bar.offsetHeight)")
        assert np.argmax(heights) == np.argmax(shares)


def test_the_cutting_plane_takes_away_one_side(tab, cube):
    tab.run("along('x')")  # seen against x: y to the right
    whole = (tab.picture()[:440, 320:] < 250).any(axis=2)
    left, right = np.flatnonzero(whole[200])[[0, -1]]
    place_of(tab, "#cut-axis")
    tab.run("byId('cut-axis').focus()")
    tab.run("byId('cut-axis').value = 'y'; byId('cut-axis').onchange()")
    assert tab.run("byId('cut-text').textContent") == "y = 0 mm"
    half = (tab.picture()[:440, 320:] < 250).any(axis=2)
    middle = (left + right) // 2
    assert half[200, left + 5 : middle - 5].all()
    assert not half[200, middle + 5 : right + 20].any()
    # contacts that are cut off are not found any more
    y = "contactPoint({})[1]"
    assert all(tab.run(y.format(contact)) < 1e-4 for contact, _, _ in front_contacts(tab))
    press(tab, "#cut-flip")
    other = (tab.picture()[:440, 320:] < 250).any(axis=2)
    assert not other[200, left : middle - 5].any()
    tab.run("byId('cut-at').focus()")
    tab.key("End")
    assert (tab.picture()[:440, 320:] < 250).any(axis=2)[200].sum() < 5
    tab.run("byId('cut-axis').value = ''; byId('cut-axis').onchange()")
    assert ((tab.picture()[:440, 320:] < 250).any(axis=2) == whole).mean() > 0.999


def test_the_distance_between_two_points(tab, cube):
    press(tab, "#measure")
    seen = front_contacts(tab)
    (a, *first), (b, *second) = seen[0], seen[-1]
    tab.click(*first)
    assert "pick the second point" in tab.run("picked.textContent")
    tab.click(*second)
    text = tab.run("picked.textContent")
    expected = cube.points[b] - cube.points[a]
    assert float(re.search(r"distance = (\S+) mm", text)[1]) == pytest.approx(np.linalg.norm(expected), rel=1e-4)
    assert [float(v) for v in re.findall(r"Δ. = (\S+) mm", text)] == pytest.approx(expected, abs=2e-3)
    # between places of the surface without contact: the middle of the page is on the body
    x, y = tab.run("(v => [v.x, v.y])(measures())")
    tab.run("contactLayer().on = false; redraw()")
    tab.click(x, y)
    tab.click(x + 30, y)
    a, b = np.array(tab.run("marks.points"))
    mesh, _, _ = shown_surface(cube)
    center = np.array(tab.run("data.center"))
    assert distances(np.array([a, b]) + center, mesh).max() < 1e-3
    tab.run("canvas.focus()")
    tab.key("Escape")
    assert tab.run("[marks.points.length, picked.hidden]") == [0, True]


def test_a_picture_is_saved_as_it_is_seen(tab, tmp_path, cube):
    session, tab.session = tab.session, None
    tab("Browser.setDownloadBehavior", behavior="allow", downloadPath=str(tmp_path))
    tab.session = session
    tab.run("turn(0.4, 0.1)")
    seen = tab.picture()
    press(tab, "#save")
    end = time.monotonic() + SECONDS
    while not (tmp_path / "cube.png").exists():
        assert time.monotonic() < end
        time.sleep(0.05)
    saved = np.asarray(Image.open(tmp_path / "cube.png").convert("RGB")).astype(int)
    assert saved.shape == (HEIGHT - tab.run("measures().bottom"), WIDTH, 3)
    # beside the controls it is what the screen shows
    assert (np.abs(saved - seen[: len(saved)])[:440, 330:].max(axis=2) > 8).mean() < 1e-3
    # in their place are the name and the scales of colours
    assert 0.01 < (saved[:250, :300] < 250).any(axis=2).mean() < 0.5


# --- for everybody, on every screen ---


def test_every_control_has_a_name(tab):
    """As screen readers get them from the browser."""
    press(tab, "#charts")
    tab.run("for (const e of document.querySelectorAll('details')) e.open = true")
    nodes = [node for node in tab("Accessibility.getFullAXTree")["nodes"] if not node["ignored"]]
    controls = {}
    for node in nodes:
        role = node["role"]["value"]
        if role in ("button", "checkbox", "slider", "combobox", "application", "DisclosureTriangle", "image", "group"):
            controls.setdefault(role, []).append(node.get("name", {}).get("value", ""))
    assert {"button", "checkbox", "slider", "combobox", "application", "image"} <= set(controls)
    named = [name for role, names in controls.items() if role != "group" for name in names]
    assert "" not in named
    # two sliders of the player, choices of colours, cutting plane and speed; three histograms or charts
    assert controls["slider"] == ["sweep", "sample"]
    assert {"colour of surface", "colour of contacts", "speed"} <= set(controls["combobox"])
    assert any(name.startswith("histogram of signed deviation in mm: 5 %, 50 % and 95 %") for name in controls["image"])
    assert any(name.startswith("reactions over the travel of the clamp") for name in controls["image"])
    live = tab.run("[...document.querySelectorAll('[aria-live=polite], [role=status]')].map(e => e.id)")
    assert live == ["now", "picked"]


def test_the_keys_reach_everything(tab):
    """By Tab alone, from the view through all controls that are seen."""
    tab.run("canvas.focus()")
    reached = set()
    for _ in range(60):
        tab.key("Tab")
        reached.add(
            tab.run("document.activeElement.id || document.activeElement.name || document.activeElement.tagName")
        )
    assert {"play", "sweep", "sample", "speed", "charts", "cut-axis", "measure", "save", "reset", "surface"} <= reached
    tab.run("canvas.focus(); reset()")
    before = tab.run("({...eye})")
    tab.key("ArrowLeft")
    tab.key("+")
    after = tab.run("({...eye})")
    assert after["azimuth"] != before["azimuth"]
    assert after["zoom"] > before["zoom"]
    tab.key("z")
    assert tab.run("eye.elevation") == pytest.approx(np.pi / 2, abs=1e-3)
    tab.key("0")
    assert tab.run("({...eye})") == before


@pytest.mark.parametrize("size", [(360, 640), (390, 844), (844, 390), (1920, 1080)], ids=str)
def test_nothing_leaves_the_window(tab, size):
    width, height = size
    tab("Emulation.setDeviceMetricsOverride", width=width, height=height, deviceScaleFactor=1, mobile=width < 500)
    try:
        tab("Page.reload")
        wait_for(tab, "document.readyState === 'complete' && typeof player === 'object' && !dock.hidden")
        for shown in (False, True):
            if shown:
                press(tab, "#charts")
            boxes = tab.run("[panel, dock].map(e => { const r = e.getBoundingClientRect();"
                            " return [r.left, r.top, r.right, r.bottom]; })")  # fmt: skip
            for left, top, right, bottom in boxes:
                assert left >= 0
                assert top >= 0
                assert right <= width
                assert bottom <= height
            # some of the body is seen beside them
            view = tab.run("measures()")
            assert view["wide"] * view["high"] > 0.12 * width * height
            inner = tab.run("[...dock.querySelectorAll('button, input, select')].every(e => {"
                            " const r = e.getBoundingClientRect(), d = dock.getBoundingClientRect();"
                            " return r.left >= d.left && r.right <= d.right && r.bottom <= d.bottom; })")  # fmt: skip
            assert inner
    finally:
        tab("Emulation.setDeviceMetricsOverride", width=WIDTH, height=HEIGHT, deviceScaleFactor=1, mobile=False)


# --- a hundred thousand contacts ---


def many(scene, count):
    """The scene with at least so many contacts: its recording and its contacts repeated, sweep after sweep."""
    recording, contacts = scene.recording, scene.contacts
    times = -(-count // len(contacts))
    repeat = np.arange(times)
    tiled = {name: np.concatenate([getattr(recording, name)] * times)
             for name in ("position_m", "quaternion", "force_N", "moment_Nm")}  # fmt: skip
    sweep = (recording.sweep + (recording.sweep.max() + 1) * repeat[:, None]).ravel()
    rows = np.tile(contacts, times)
    rows["row"] = (contacts["row"] + len(recording) * repeat[:, None]).ravel()
    rows["sweep"] = sweep[rows["row"]]
    # apart from each other on the screen
    rows["z"] *= 1 - 0.1 * np.random.default_rng(0).random(len(rows))
    return replace(scene, contacts=rows, recording=replace(recording, sweep=sweep, **tiled))


@pytest.fixture(scope="module")
def full_tab(browser_path, cube, tmp_path_factory):
    scene = many(cube, CONTACTS)
    tab = opened(browser_path, scene, tmp_path_factory.mktemp("many"))
    yield tab, scene
    tab.close()


def test_a_hundred_thousand_contacts(full_tab):
    """All that a user does with few; and pictures in motion are made in the time of 30 in a second, even by software."""
    tab, scene = full_tab
    assert tab.run("contactLayer().points.length / 3") == len(scene.contacts) >= CONTACTS
    press(tab, "#charts")
    tab.picture()
    # links, both ways
    contact, x, y = front_contacts(tab)[5]
    tab.mouse("mouseMoved", x, y)
    wait_for(tab, f"marks.hovered === {contact}")
    tab.click(x, y)
    assert tab.run("player.contactOf[player.sample]") == contact
    assert reactions_in(tab.run("buildRod() || now.textContent")) == pytest.approx(
        sample_of(scene, contact), rel=6e-3, abs=1e-9
    )
    tab.run("byId('sweep').focus()")
    tab.key("End")
    assert tab.run("player.numbers[player.sweep]") == scene.column("sweep").max()
    # histogram, cutting plane, distance
    counts = tab.run("[...document.querySelectorAll('.legend')][1].innerText")
    assert sum(int(count) for count in re.findall(r": (\d+) \(", counts)) == len(scene.contacts)
    tab.run("byId('cut-axis').value = 'x'; byId('cut-axis').onchange()")
    assert all(tab.run(f"contactPoint({contact})[0]") < 1e-4 for contact, _, _ in front_contacts(tab)[:20])
    tab.run("byId('cut-axis').value = ''; byId('cut-axis').onchange()")
    tab.run("canvas.focus()")
    tab.key("m")
    assert tab.run("marks.points.length") == 1
    tab.key("Escape")
    # a picture
    assert tab.run("picture().width") == WIDTH
    # which is opaque, although contacts that are close together let the surface shine through
    assert tab.run("pointStyle(contactLayer(), measures()).alpha") < 1
    alpha = (
        "(c => c.getContext('2d').getImageData(0, 0, c.width, c.height).data.filter((_, k) => k % 4 === 3))(picture())"
    )
    assert tab.run(f"{alpha}.every(a => a === 255)")
    # pictures in motion; the fastest, as the machine may be busy
    moving = """(() => { const times = [], pixel = new Uint8Array(4);
      for (let k = 0; k < 40; k++) {
        const before = performance.now();
        eye.azimuth += 0.05; draw(levels.length - 1);
        gl.readPixels(0, 0, 1, 1, gl.RGBA, gl.UNSIGNED_BYTE, pixel);
        times.push(performance.now() - before);
      }
      return Math.min(...times); })()"""
    assert tab.run(moving) < 1000 / 30
    # and where they come late, the page changes to these by itself, and back when it is still
    tab.run("pace.level = 1; redraw()")
    wait_for(tab, "canvas.width < innerWidth")
    wait_for(tab, "canvas.width === innerWidth")
    assert tab.complaints() == []
