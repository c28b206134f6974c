"""Pictures, tables and short descriptions of sweeps, contacts, events and elastic lines."""

import dataclasses
import inspect
import re
import sys

import matplotlib
import numpy as np
import pytest
from matplotlib import pyplot
from matplotlib.colors import same_color
from matplotlib.figure import Figure

import planar
from planar.plots import TANGENTIAL_COLOR, TIP_COLOR

CIRCLE = planar.Circle(radius=0.9, center=(0.0, 1.3))
SWEEP = planar.sweep(CIRCLE, friction=0.3)
CONTACTS = planar.reconstruct(*SWEEP.reactions)
EVENTS = planar.events(CIRCLE, friction=0.3)


@pytest.fixture(autouse=True)
def _off_screen():
    matplotlib.use("Agg")
    yield
    pyplot.close("all")


def test_curves_of_columns_have_circles_where_the_phase_changes():
    f0x, f0y, m0z = SWEEP.plot(label="a")
    np.testing.assert_array_equal(f0y.lines[0].get_ydata(), SWEEP.f0y)
    spacing = np.diff(SWEEP.x0).min()
    np.testing.assert_allclose(m0z.lines[1].get_xdata(), EVENTS.x0[1:3], atol=abs(spacing))
    assert m0z.lines[0].get_label() == "a"
    angle, friction = CONTACTS.plot("friction_angle_bound", "friction", over=SWEEP.x0)
    np.testing.assert_allclose(np.nanmax(angle.lines[0].get_ydata()), np.degrees(np.arctan(0.3)), rtol=1e-9)
    assert (angle.get_ylabel(), friction.get_xlabel()) == ("$\\beta$ in degrees", "$x_0\\;/\\;L$")


def test_points_and_lines_tell_the_phases_apart():
    axes = CONTACTS.plot()
    drawn = {line.get_color(): line.get_xydata() for line in axes.lines}
    np.testing.assert_array_equal(drawn[TIP_COLOR], CONTACTS.point[CONTACTS.phase == planar.Phase.TIP])
    np.testing.assert_array_equal(drawn[TANGENTIAL_COLOR], CONTACTS.point[CONTACTS.phase == planar.Phase.TANGENTIAL])
    assert all(same_color(line.get_color(), "red") for line in CONTACTS.plot(color="red").lines)
    given = Figure().subplots()
    assert planar.elastic_lines(*planar.sweep(CIRCLE, samples=9).reactions).plot(axes=given) is given
    assert len(given.lines) == 9 + sum(line.get_color() == "black" for line in given.lines)


def test_events_show_the_moment_before_and_after():
    axes = EVENTS.plot(axes=SWEEP.plot("m0z")[0])
    assert [text.get_text() for text in axes.get_legend().get_texts()] == [
        "touch down",
        "to tangential",
        "to tip",
        "snap off",
    ]
    assert repr(EVENTS).startswith("Events at x0: touch_down 0.848528, to_tangential 0.5791")


def test_tables_have_words_and_no_empty_columns():
    table = CONTACTS.to_pandas()
    assert list(table["phase"]) == [planar.Phase(code).name.lower() for code in CONTACTS.phase]
    np.testing.assert_array_equal(table["nx"], CONTACTS.normal[:, 0])
    tips = planar.reconstruct(*(column[:20] for column in SWEEP.reactions)).to_pandas()
    assert {"friction", "slope", "nx"} & set(tips.columns) == set()
    assert "friction" in planar.sweep(CIRCLE, base=[]).to_pandas()
    assert list(EVENTS.to_pandas()["kind"]) == ["touch_down", "to_tangential", "to_tip", "snap_off"]


@pytest.mark.parametrize(
    "contour",
    [
        planar.Circle(radius=0.3, center=(0.0, 1.0)),
        planar.Ellipse(semi_axes=(0.4, 0.2), center=(0.1, 1.0), angle=0.5),
        planar.Polygon([[0.0, 0.6], [0.4, 0.7], [0.1, 1.0]]),
        planar.Contours([planar.Circle(0.1, (0.0, 0.7)), planar.Circle(0.1, (0.5, 0.7))]),
    ],
    ids=lambda contour: type(contour).__name__,
)
def test_a_contour_is_drawn_where_it_is(contour):
    lines = contour.plot(axes=Figure().subplots()).lines
    assert len(lines) == len(contour.loops())
    for line in lines:
        assert contour.distance(line.get_xydata()).max() < 1e-12
        assert (line.get_xydata()[0] == line.get_xydata()[-1]).all()


def test_a_notebook_shows_results_short_and_with_a_picture_where_that_can_be_drawn(monkeypatch):
    contour = planar.Polygon([[0.0, 0.6], [0.4, 0.7], [0.1, 1.0]])
    sweep = planar.sweep(contour, samples=20)
    shown = [contour, sweep, planar.reconstruct(*sweep.reactions)]
    for result in shown:
        assert len(repr(result)) < 80
        assert result._repr_html_().startswith(f"<p>{result!r}</p><svg")
    no_pictures = [
        planar.errors(*sweep.reactions[1:], noise=(1e-4, 1e-4)),
        planar.complete(sweep.x0, sweep.f0x, None, sweep.m0z, friction=0.0),
    ]
    assert repr(no_pictures[0]).startswith("Errors of 20 rows, ")
    assert repr(no_pictures[1]).startswith("Completed reactions of 20 rows, ")
    monkeypatch.setitem(sys.modules, "matplotlib.figure", None)
    for result in shown:
        assert result._repr_html_() == f"<p>{result!r}</p>"


@pytest.mark.parametrize("kind", [planar.Rod, planar.Contacts])
def test_help_tells_what_each_field_means(kind):
    told = inspect.getdoc(kind)
    for field in dataclasses.fields(kind):
        assert not field.init or re.search(rf"^{field.name}\n    \S", told, flags=re.MULTILINE)
