"""Contacts grow in the page of a browser while rows come in."""

import time

import numpy as np
import pytest
from browser import SECONDS, Tab
from small_scans import EGG

import scan3d
from scan3d import InputError


@pytest.fixture(scope="module")
def recording():
    plan = scan3d.Plan(model="spatial", slices=2, sweeps=3, samples=40, noise=1e-4)
    return scan3d.simulate(scan3d.load_mesh(EGG), plan)


def push(live, recording, rows):
    wrench = np.hstack(recording.wrench())
    for k in rows:
        live.push(0.01 * k, recording.position_m[k], recording.quaternion[k], wrench[k])


@pytest.mark.browser
@pytest.mark.slow
def test_contacts_and_rod_are_those_of_the_rows_so_far(recording, browser_path, tmp_path):
    live, half = scan3d.Live(recording), len(recording) // 2
    tab = Tab(browser_path, tmp_path)
    try:
        with scan3d.LivePage(live) as page:
            tab.open(page.url)
            assert "Waiting" in tab.run("document.body.textContent")
            seen = 0
            for rows in (range(half), range(half, len(recording) - 1)):
                push(live, recording, rows)
                end = time.monotonic() + SECONDS
                while seen < len(live.contacts) and time.monotonic() < end:
                    time.sleep(0.2)
                    seen = tab.run("typeof data === 'object' ? data.layers[0].points.length / 3 : 0")
                assert seen == len(live.contacts) > 10
            shown = np.array(tab.run("Array.from(data.layers[0].points)")).reshape(-1, 3)
            points = np.array([one.point for one in live.contacts])
            np.testing.assert_allclose(np.diff(shown, axis=0), np.diff(points, axis=0), atol=1e-4)
            rod = np.array(tab.run("Array.from(data.layers.find(layer => layer.name === 'rod').points)")).reshape(-1, 3)
            length = np.linalg.norm(np.diff(rod, axis=0), axis=1).sum()
            assert length == pytest.approx(1e3 * recording.rod.length_m, rel=1e-3)
            if live.state == "touching":
                assert np.linalg.norm(rod - shown[-1], axis=1).min() < 1e-2
            assert f"{len(live.contacts)} contacts" in tab.run("document.querySelector('.headline').textContent")
        end = time.monotonic() + SECONDS
        while "has ended" not in (said := tab.run("document.querySelector('.headline').textContent")):
            assert time.monotonic() < end, said
            time.sleep(0.2)
    finally:
        tab.close()


@pytest.mark.slow
def test_a_port_in_use_is_refused(recording):
    live = scan3d.Live(recording)
    with scan3d.LivePage(live) as page, pytest.raises(InputError, match="choose another one, or 0"):
        scan3d.LivePage(live, int(page.url.rsplit(":", 1)[1].strip("/")))
