"""The page as an instrument, in headless Chromium: layers, player, links, cutting plane, distances, keys."""

import json
import re
import time

import numpy as np
import pytest
from browser import HEIGHT, SECONDS, WIDTH, Tab
from small_scans import any_rod, any_rod_in_space, ring, scanned_in_space

from scan3d.geometry.distance import distances
from scan3d.pictures.page import page
from scan3d.pictures.parts import is_spatial, shown_surface, shown_sweep
from scan3d.units import FORCES, MOMENTS, length, number

pytestmark = [pytest.mark.browser, pytest.mark.slow]
NUMBER = r"[-−]?[\d.,]*\d(?:e[-−]?\d+)?"


@pytest.fixture(scope="module")
def browser(browser_path, cube, tmp_path_factory):
    folder = tmp_path_factory.mktemp("page")
    (folder / "page.html").write_bytes(page(cube))
    tab = Tab(browser_path, folder / "profile")
    try:
        tab.open(folder / "page.html")
        yield tab, folder
    finally:
        tab.close()


@pytest.fixture
def tab(browser):
    """The page of the cube without the rod, as it comes back to; every test leaves it without complaints."""
    tab, _ = browser
    reload(tab)
    tab.run("switchPlayer(false)")
    yield tab
    assert tab.complaints() == []


def reload(tab):
    tab("Page.reload")
    tab.events.clear()
    while not any(event["method"] == "Page.loadEventFired" for event in tab.events):
        tab.receive()


@pytest.fixture
def shows(browser, cube):
    tab, folder = browser

    def show(scene):
        (folder / "page.html").write_bytes(page(scene))
        reload(tab)
        return tab

    yield show
    (folder / "page.html").write_bytes(page(cube))


def place_of(tab, selector):
    script = f"""(() => {{ const e = document.querySelector({json.dumps(selector)}); e.scrollIntoView({{block: "nearest"}});
      const r = e.getBoundingClientRect(); return [r.x + r.width / 2, r.y + r.height / 2]; }})()"""
    return tab.run(script)


def press(tab, selector):
    tab.click(*place_of(tab, selector))


def front_contacts(tab):
    """Contacts that are seen, with their places on the screen: those that the page finds there."""
    return tab.run("""(() => { const found = [], n = contacts.points.length / 3, step = Math.ceil(n / 120);
      for (let k = 0; k < n && found.length < 20; k += step) {
        const front = contactAt(...onScreen(contactPoint(k)));
        if (front < 0) continue;
        const [x, y] = onScreen(contactPoint(front));
        if (contactAt(x, y) === front && document.elementFromPoint(x, y) === canvas) found.push([front, x, y]);
      }
      return found; })()""")


def wait_for(tab, expression):
    end = time.monotonic() + SECONDS
    while not tab.run(expression):
        assert time.monotonic() < end, expression
        time.sleep(0.02)


def reactions_in(text):
    """The reactions that the page's text states, in N and N m."""
    found = re.findall(rf"[fm]0[xyz] = ({NUMBER}) ([mµn]?N(?: (?:mm|m)\b)?)", text.replace("\xa0", " "))
    return [float(value.replace("−", "-").replace(",", "")) * float((FORCES | MOMENTS)[unit]) for value, unit in found]


def of_contact(scene, contact):
    row = int(scene.column("row")[contact])
    return [*scene.recording.force_N[row], scene.recording.moment_Nm[row]]


def differing(image, other):
    return (np.abs(image - other).max(axis=2) > 20).mean()


def blue(image):
    """Pixels as pale blue as the cube's top, which lies below the truth by half the bound, right of the panel."""
    image = image[:460, 345:]
    return ((image[:, :, 2] - image[:, :, 0] > 20) & (image[:, :, 0] > 90)).mean()


def drawn(image):
    """Right of the panel, above the player: what isn't white."""
    return (image[:460, 345:] < 250).any(axis=2)


# --- the view ---


def test_the_body_is_seen_and_turns(tab, cube):
    first = tab.picture()
    assert first.shape == (HEIGHT, WIDTH, 3)
    # in the middle of the space right of the panel, on a white page
    assert 0.2 < drawn(first).mean() < 0.8
    assert drawn(first)[250:350, 230:330].all()
    assert blue(first) > 0.03
    tab.run("byId('figures').open = true")
    assert tab.run("document.querySelector('table').innerText") == "\n".join(map("\t".join, cube.key_figures))
    # the top goes out of sight when it is looked at from the side
    tab.drag((600, 250), (640, 193))
    turned = tab.picture()
    assert blue(turned) < 0.2 * blue(first)
    # the wheel zooms, a double click goes back
    tab.mouse("mouseWheel", 600, 300, deltaX=0, deltaY=600)
    assert drawn(tab.picture()).mean() < 0.5 * drawn(turned).mean()
    for count in (1, 2):
        tab.mouse("mousePressed", 880, 20, button="left", buttons=1, clickCount=count)
        tab.mouse("mouseReleased", 880, 20, button="left", clickCount=count)
    assert differing(tab.picture(), first) < 1e-3


def test_layers_and_colours(tab):
    tab.run("for (const box of document.querySelectorAll('input')) if (box.checked) box.click()")
    assert not drawn(tab.picture()).any()
    shown = {}
    for name in tab.run("[...document.querySelectorAll('#layers input')].map(box => box.name)"):
        tab.run(f"document.querySelector('input[name=\"{name}\"]').click()")
        shown[name] = drawn(tab.picture()).mean()
        tab.run(f"document.querySelector('input[name=\"{name}\"]').click()")
    layers = {"surface", "contacts", "normals", "slices", "truth", "axes and scale"}
    assert set(shown) == {*layers, "rod, clamp and reactions"}
    assert min(shown.values()) > 1e-3
    assert shown["truth"] == pytest.approx(shown["surface"], rel=0.05)

    tab.run("switchPlayer(false); document.querySelector('input[name=\"surface\"]').click()")
    choose = (
        "(s => {{ s.selectedIndex = {}; s.onchange(); return s.value; }})(document.querySelector('#layers select'))"
    )
    assert tab.run(choose.format(2)) == "plain"
    plain = tab.picture()
    assert not blue(plain)
    assert tab.run(choose.format(1)) == "certified bound in µm"
    assert differing(tab.picture(), plain) > 0.05
    # the bars have the heights of the shares
    heights = tab.run("[...document.querySelectorAll('.histogram')[0].children].map(bar => bar.offsetHeight)")
    assert np.argmax(heights) == np.argmax(tab.run("data.layers[0].colors[1].shares"))


def test_the_cutting_plane_takes_away_one_side(tab):
    def row():
        return (tab.picture()[:440, 345:] < 250).any(axis=2)[200]

    tab.run("along('x')")  # seen against x: y to the right
    whole = row()
    left, right = np.flatnonzero(whole)[[0, -1]]
    middle = (left + right) // 2
    tab.run("byId('cut-axis').value = 'y'; byId('cut-axis').onchange()")
    half = row()
    assert tab.run("byId('cut-text').textContent") == "y = 0 mm"
    assert half[left + 5 : middle - 5].all()
    assert not half[middle + 5 : right + 20].any()
    # contacts that are cut off are not found any more
    assert all(tab.run(f"contactPoint({contact})[1]") < 1e-4 for contact, _, _ in front_contacts(tab)[:5])
    press(tab, "#cut-flip")
    assert not row()[left : middle - 5].any()
    tab.run("byId('cut-axis').value = ''; byId('cut-axis').onchange()")
    assert (row() == whole).mean() > 0.99


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
    assert [float(v) for v in re.findall(r"Δ. = (\S+) mm", text.replace("−", "-"))] == pytest.approx(expected, abs=6e-3)
    # between places of the surface without contact: the middle of the page is on the body
    tab.key("Escape")
    press(tab, "#measure")
    x, y = tab.run("(v => [v.x, v.y])(measures())")
    tab.run("contacts.on = false; redraw()")
    tab.click(x, y)
    tab.click(x + 30, y)
    points = np.array(tab.run("marks.points")) + tab.run("data.center")
    assert distances(points, shown_surface(cube)[0]).max() < 1e-3
    tab.run("document.activeElement.blur()")
    tab.key("Escape")
    assert tab.run("[marks.points.length, picked.hidden]") == [0, True]


def test_numbers_are_those_of_the_terminal(tab):
    values = [*np.random.default_rng(0).normal(size=40) * 10.0 ** np.arange(-9, 11, 0.5), 999.96, 0.0, 1234567.0]
    shown = tab.run(f"{[float(value) for value in values]}.map(x => number(x))")
    assert [text.replace("−", "-") for text in shown] == [number(value) for value in values]
    bounds = np.abs(values)
    shown = tab.run(f"{[float(value) for value in bounds]}.map(x => lengthText(x, 3, true))")
    assert shown == [length(value, "mm", up=True) for value in bounds]


# --- the player ---


def test_the_page_opens_with_a_rod(browser):
    tab, _ = browser
    reload(tab)
    assert tab.run("[player.on, player.playing, curves.hidden, player.sweep === player.shown]") == [
        True,
        False,
        True,
        True,
    ]
    middle = tab.run("Math.floor((player.ends[player.sweep] - player.starts[player.sweep]) / 2)")
    assert tab.run("player.sample - player.starts[player.sweep]") == middle


@pytest.mark.parametrize("scanned", [None, scanned_in_space, any_rod, any_rod_in_space])
def test_the_rod_in_the_page_is_the_elastic_line(shows, scanned, cube):
    """Against `march.shapes`, which integrates it by another method: within a hundredth of a pixel, 1e-5 rod lengths."""
    scene = cube if scanned is None else scanned()
    tab = shows(scene)
    sweep = shown_sweep(scene)
    samples = np.flatnonzero(scene.column("sweep") == sweep.number)
    rods = tab.run(
        f"[...player.contact].filter(k => player.numbers[sweepOf(k)] === {sweep.number}).map(k => {{ const r = rodAt(k);"
        " return [r.base, r.points[r.contact], r.points[r.points.length - 1], r.force, r.moment]; })"
    )
    assert len(rods) == len(samples) == len(sweep.base)
    base, contact, tip, force, moment = np.array(rods).transpose(1, 0, 2)
    center, recording = np.array(tab.run("data.center")), scene.recording
    length = 1e3 * recording.rod.length_m
    assert base + center == pytest.approx(sweep.base, abs=1e-5 * length)
    assert np.abs(contact + center - sweep.contact).max() < 1e-5 * length
    assert np.abs(tip + center - sweep.rods[:, -1]).max() < 1e-5 * length
    # the reactions point where they do in the world
    rows = scene.column("row")[samples].astype(int)
    zero = np.zeros(len(recording))
    wrench = np.column_stack([recording.force_N, zero]), np.column_stack([zero, zero, recording.moment_Nm])
    if is_spatial(scene):
        wrench = recording.wrench()
    for shown, expected in zip((force, moment), wrench, strict=True):
        world = np.einsum("ni,nij->nj", expected[rows], recording.axes()[rows])
        scale = np.linalg.norm(shown) / np.linalg.norm(world)
        assert np.log10(scale) / 3 == pytest.approx(round(np.log10(scale) / 3), abs=1e-6)  # N, mN or µN
        assert np.abs(shown - scale * world).max() < 1e-5 * np.abs(shown).max()
    assert tab.complaints() == []


def test_a_probing_is_called_one_and_a_slice_has_its_number(shows):
    scene = ring()
    tab, slices = shows(scene), scene.column("slice")
    swept, probed = np.flatnonzero(slices >= 0)[0], np.flatnonzero(slices < 0)[0]
    for row, words in ((swept, f"slice {int(slices[swept])}"), (probed, "a probing")):
        tab.run(
            f"(k => {{ goTo(sweepOf(k), k - player.starts[sweepOf(k)]); buildRod(); }})(player.contactOf.indexOf({row}))"
        )
        assert f"), {words}, sample" in tab.run("now.textContent")
    assert tab.complaints() == []


def test_mouse_and_keys_move_the_player(tab, cube):
    assert tab.run("[dock.hidden, curves.hidden, player.on]") == [False, True, False]  # as the fixture leaves it
    body = tab.picture()
    press(tab, "#charts")
    assert tab.run("[curves.hidden, player.on, byId('charts').getAttribute('aria-pressed')]") == [False, True, "true"]
    assert differing(tab.picture(), body) > 0.05
    tab.run("goTo(1, 0)")
    # the sliders by keys, as a user without a mouse has them; and the view by keys of its own
    for place, key, expected in (
        ("byId('sample')", "ArrowRight", [1, 1]),
        ("byId('sweep')", "ArrowLeft", [0, None]),
        ("canvas", "]", [1, None]),
        ("canvas", "[", [0, None]),
    ):
        tab.run(f"{place}.focus()")
        tab.key(key)
        sweep, sample = tab.run("[player.sweep, player.sample - player.starts[player.sweep]]")
        assert [sweep, expected[1] and sample] == expected, key
    before = tab.run("player.sample")
    for key, step in ((".", 1), (",", 0)):
        tab.key(key)
        assert tab.run("player.sample") == before + step
    assert tab.run("byId('sweep').getAttribute('aria-valuetext') === `sweep ${player.numbers[player.sweep]}`")
    tab.picture()
    # what stands there are the recording's numbers
    contact = tab.run("player.contactOf[player.sample]")
    text = tab.run("now.textContent")
    assert text.startswith(f"sweep {cube.column('sweep')[contact]:.0f} ")
    assert reactions_in(text) == pytest.approx(of_contact(cube, contact), rel=6e-3, abs=1e-12)


def test_it_plays_to_the_end(tab):
    # slowly, so that it still plays when the label is read
    tab.run("play(false); goTo(0, 0); byId('speed').selectedIndex = 0")
    tab.picture()
    press(tab, "#play")
    assert tab.run("byId('play').getAttribute('aria-label')") == "pause"
    tab.run("byId('speed').selectedIndex = 2")
    wait_for(tab, "!player.playing")
    assert tab.run("[player.sweep, player.sample]") == [0, tab.run("player.starts[1] - 1")]


def test_contacts_and_curves_are_linked_both_ways(tab, cube):
    press(tab, "#charts")
    tab.picture()
    contact, x, y = front_contacts(tab)[10]
    # a click beside the body shows nothing, one on a contact chooses it, and shows what was measured at it
    tab.click(880, 300)
    assert tab.run("picked.hidden")
    tab.click(x, y)
    assert tab.run("player.sample") == tab.run(f"player.contact[{contact}]")
    text = tab.run("picked.textContent")
    assert text.startswith(f"contact {contact}\n")
    point = [float(coordinate) for coordinate in re.findall(r"[xyz] = (\S+) mm", text.replace("−", "-"))]
    assert point == pytest.approx(cube.points[contact], abs=1e-3)
    assert f"sweep {cube.column('sweep')[contact]:.0f}\n" in text

    # a click on a place in a chart chooses the sample there
    tab.run("goTo(0, 0)")
    frames = tab.run("(() => { const r = curves.getBoundingClientRect();"
                     " return curveFrames().map(f => [r.x + f.x, f.w, r.y + f.y + f.h / 2]); })()")  # fmt: skip
    assert len(frames) == 3
    travel = np.array(tab.run("[...travelOf(0)]"))
    for k, (left, width, middle) in zip((3, len(travel) // 2, len(travel) - 2), frames, strict=True):
        at = left + width * travel[k] / travel[-1]
        tab.click(at, middle)
        assert tab.run("player.sample") == k


# --- for everybody, on every screen ---


def test_every_control_has_a_name(tab):
    """As screen readers get them from the browser."""
    press(tab, "#charts")
    tab.run("for (const e of document.querySelectorAll('details')) e.open = true")
    tab.picture()
    controls = {}
    for node in tab("Accessibility.getFullAXTree")["nodes"]:
        if not node["ignored"]:
            controls.setdefault(node["role"]["value"], []).append(node.get("name", {}).get("value", ""))
    for role in ("button", "checkbox", "slider", "combobox", "application", "DisclosureTriangle", "image"):
        assert "" not in controls[role], role
    assert controls["slider"] == ["sweep", "sample"]
    assert {"colour of surface", "colour of contacts", "speed"} <= set(controls["combobox"])
    assert any(
        name.startswith("histogram of signed deviation in µm: half of the area is within ±")
        for name in controls["image"]
    )
    assert any(name.startswith("reactions over the travel of the clamp") for name in controls["image"])
    live = tab.run("[...document.querySelectorAll('[aria-live=polite], [role=status]')].map(e => e.id)")
    assert live == ["now", "picked"]


def test_the_keys_reach_everything(tab):
    """By Tab alone, from the view through all controls that are seen."""
    tab.run("canvas.focus()")
    reached = set()
    for _ in range(40):
        tab.key("Tab")
        reached.add(tab.run("(e => e.id || e.name || e.tagName)(document.activeElement)"))
    assert {"play", "sweep", "sample", "speed", "charts", "cut-axis", "measure", "reset", "surface"} <= reached


@pytest.mark.parametrize(("width", "height", "is_open"), [(390, 844, False), (1024, 768, True), (1440, 900, True)])
def test_headline_and_legend_are_seen_at_once_and_cover_no_part_of_the_body(tab, width, height, is_open):
    try:
        tab("Emulation.setDeviceMetricsOverride", width=width, height=height, deviceScaleFactor=1, mobile=not is_open)
        wait_for(tab, f"innerWidth === {width}")
        reload(tab)
        assert tab.run("panel.open") == is_open
        for opened in (is_open, True):  # and as a user opens it
            tab.run(f"panel.open = {str(opened).lower()}; 1")
            wait_for(tab, f"document.body.classList.contains('with-panel') === {str(opened).lower()}")
            picture = tab.picture()
            box = tab.run("panel.getBoundingClientRect().toJSON()")
            for seen in (".headline", ".bar" if opened else "#brief .bar"):
                bars = tab.run(f"[...document.querySelectorAll('{seen}')].map(e => e.getBoundingClientRect().toJSON())")
                assert any(bar["width"] > 0 and bar["bottom"] <= box["bottom"] <= height for bar in bars)
            x, y = np.reshape(tab.run("[...onScreen(data.layers[0].points)]"), (-1, 3)).T[:2]
            assert ((x >= box["right"]) | (y >= box["bottom"])).all()
            body = picture[int(y.min()) : int(y.max()), int(x.min()) : int(x.max())]
            assert (body.min(axis=-1) < 240).mean() > 0.3  # and it is drawn
        # nothing is cut off where the panel is beside the body
        assert not is_open or tab.run("panel.scrollHeight <= panel.clientHeight")
    finally:
        tab("Emulation.setDeviceMetricsOverride", width=WIDTH, height=HEIGHT, deviceScaleFactor=1, mobile=False)
        reload(tab)


def test_nothing_leaves_the_window(tab):
    try:
        for width, height in [(360, 640), (844, 390), (1920, 1080)]:
            size = dict(width=width, height=height, deviceScaleFactor=1, mobile=width < 500)
            tab.run("switchPlayer(true); reset()")
            tab("Emulation.setDeviceMetricsOverride", **size)
            wait_for(tab, f"innerWidth === {width}")
            tab.picture()  # the page hears of its new size before it draws a frame
            # a view that nobody has moved keeps the whole body beside panel and player
            x, y = np.reshape(tab.run("[...onScreen(data.layers[0].points)]"), (-1, 3)).T[:2]
            view = tab.run("measures()")
            assert view["left"] <= x.min() < x.max() <= view["left"] + view["wide"]
            assert 0 <= y.min() < y.max() <= height - view["bottom"]
            reload(tab)
            press(tab, "#charts")
            for box in tab.run("[panel, dock].map(e => e.getBoundingClientRect().toJSON())"):
                assert min(box["left"], box["top"]) >= 0
                assert box["right"] <= width
                assert box["bottom"] <= height
            # some of the body is seen beside them
            view = tab.run("measures()")
            assert view["wide"] * view["high"] > 0.12 * width * height
            assert tab.run("[...dock.querySelectorAll('button, input, select')].every(e => {"
                           " const r = e.getBoundingClientRect(), d = dock.getBoundingClientRect();"
                           " return r.left >= d.left && r.right <= d.right && r.bottom <= d.bottom; })")  # fmt: skip
    finally:
        tab("Emulation.setDeviceMetricsOverride", width=WIDTH, height=HEIGHT, deviceScaleFactor=1, mobile=False)
