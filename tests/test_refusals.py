"""Arguments and files that can't be used are refused in one sentence; of each its key words are held here.

What a command refuses is held in `test_cli`, what is wrong with a table of a rig in `test_laboratory_errors`.
"""

import dataclasses
import math
from functools import partial

import numpy as np
import pytest
import trimesh
from shapes import box, cube, dimpled_box, without
from small_scans import CUBE

import planar
import scan3d
from scan3d import Gravity, InputError, Rod
from scan3d.comparison import compare
from scan3d.files.recordings import POSE_COLUMNS, read_poses
from scan3d.files.text import parse_rod
from scan3d.pictures.figures import sheet
from scan3d.planning.rig import RigPlan, parse_envelope, plan_poses
from scan3d.rigs import RigUncertainty, accuracy_of
from scan3d.surfaces.open3d_methods import ball_pivoting, poisson
from tests import rigs

HUGE, NAN = 10**400, math.nan
changed = partial(dataclasses.replace, Rod.wire(0.04, 0.25e-3, 210e9))
BEAD = partial(Rod, 0.05, 1e-4)
TWO = ("stiffness_relative", "clamp_x_m")
POINTS = np.eye(4)[:, :3]
NORMALS = trimesh.creation.icosphere(1).vertices.view(np.ndarray)
SIZE = "the size of a picture is WIDTH or WIDTHxHEIGHT with a unit .*such as 85mm or 85x60mm, got '"
LIMITS = "a picture is at least 50 mm wide and 35 mm high, and at most 2540 mm, got "
DPI = "a whole number of dots per inch from 50 to 2400, such as 300, got"
CAMERA = r"a camera is front, back, .* iso, or AZIMUTH,ELEVATION in degrees .*, got '"


def each(make, name, words, *values):
    """A group of arguments of one name that are refused by the same words."""
    return make, [({name: value}, words) for value in values]


def recording(field, change):
    made = scan3d.simulate(box(20, 30, 40), scan3d.Plan(slices=2, sweeps=2, samples=6))
    return dataclasses.replace(made, **{field: change(getattr(made, field))})


def across(row):
    """A recording with one clamp whose z axis lies across the plane of its sweep."""
    return recording("quaternion", lambda a: np.where(np.arange(len(a))[:, None] == row, [0.5**0.5, 0.5**0.5, 0, 0], a))


def compared(mesh):
    """A mesh on either side of a comparison."""
    with pytest.raises(InputError, match="the surface should "):
        compare(mesh, cube())
    compare(cube(), mesh)


def poses(**settings):
    return plan_poses(RigPlan(parse_envelope("cylinder:80x90"), **{**dict(slices=6, samples=9), **settings}))


def calibrated(**given):
    return scan3d.calibrate(rigs.recorded(samples=60), **given)


def by_open3d(points, normals):
    with pytest.raises(InputError):
        ball_pivoting(points, normals)
    poisson(points, normals)


def mesh(vertices, faces=((0, 1, 2),)):
    return {"mesh": trimesh.Trimesh(vertices, faces, process=False)}


PLANS = [
    ("friction", None, "0.3", 1j, (0.1, None), 1e9), ("noise", None, "1", HUGE), ("clearance", "x", 1e-9), ("tolerance", []),
    ("axis", None, [["x"]], (1, 2, "z"), (HUGE, 0, 0)), ("rod", "steel:0.3x50"), ("spacing", None, []), ("unit", None, []),
    ("sweeps", 1.5), ("slices", None), ("seed", "7"),
]  # fmt: skip
NO_RODS = ["", "steel", "0.3x50", "gold:0.3x50", "steel:x50", "steel:0.3 x 50", "steel:0.3x50 mm"]
NO_BODIES = ["", "egg", "cylinder:80", "sphere:1x2", "box:1x2", "box:1x2x3x4", "ball:3", "sphere:a"]
NO_ACCURACY = [-0.1, 0.5, np.nan, [0.01, 0.02], "0.5 %", None, [[0.01] * 6]]
OF_SCAN3D = [
    *(each(scan3d.Plan, name, name, *values) for name, *values in PLANS),
    (scan3d.Plan, [
        ({"stop_force": "2 furlongs"}, "such as 2mN"),
        ({"stop_force": 0.7}, "far below what buckles"),
        ({"stop_force": 1e-3, "noise": 1e-3}, "stand out of the noise"),
        ({"known": 1.5}, "a share from 0 to 1"),
        ({"known": 0.9, "probing": "off"}, "known says when a probing ends, and probing is off"),
        ({"stop_force": 0.02, "probing": "off"}, "stop_force says when a probing ends, and probing is off"),
        ({"probing": "perhaps"}, "probing must be one of auto, off, only"),
        ({"bead": -1.0}, "diameter >= 0"),
        ({"bead": 1.0}, "choose the spatial model"),
        ({"rod": BEAD(bead_diameter_m=4e-3)}, "choose the spatial model"),
        ({"bead": 1.0, "model": "spatial", "probing": "off"}, "with probing auto or only"),
        ({"rod": Rod(0.04, 1e-4, weight_N=1e-3)}, "gravity must be a scan3d.Gravity, needed with a rod that has a weight"),
    ]),
    (BEAD, [
        ({"bead_diameter_m": -1e-3}, "bead_diameter_m of at least 0"),
        ({"bead_diameter_m": 1e-3, "diameter_m": 2e-3}, "at least its diameter"),
        ({"bead_diameter_m": 1e-3, "diameter_m": 5e-4, "tip_diameter_m": 2e-3}, "at least its diameter"),
        ({"bead_diameter_m": 0.06}, "less than its length"),
        ({"bead_diameter_m": 1e-3, "weight_N": 1e-3}, "straight and without weight"),
        ({"bead_diameter_m": 1e-3, "curvature_per_m": 1.0}, "straight and without weight"),
    ]),
    (changed, [
        ({"tip_diameter_m": -1.0}, "tip_diameter_m in metres above 0"),
        ({"diameter_m": 0.0, "tip_diameter_m": 1e-4}, "needs the diameter_m at its clamp"),
        ({"diameter_m": ((0, 1e-4), (0.04, 1e-4)), "tip_diameter_m": 1e-4}, "has one of tip_diameter_m"),
        ({"bending_stiffness_Nm2": ((0, 1e-5), (0.03, 1e-5))}, "must rise from 0 to the rod's length"),
        ({"bending_stiffness_Nm2": ((0, 1e-5), (0.04, -1e-5))}, "must be positive"),
        ({"bending_stiffness_Nm2": "stiff"}, "a number or a table"),
        ({"curvature_per_m": (1.0, 2.0)}, "a number or three"),
        ({"curvature_per_m": NAN}, "must be finite"),
        ({"weight_N": -1.0}, "weight_N of at least 0"),
    ]),
    (Rod(0.04, 1e-4, weight_N=1e-3).in_plane, [({}, "needs gravity in the frame of its clamp")]),
    each(partial(Rod, bending_stiffness_Nm2=1e-4), "length_m", "positive length", 0.0, -0.05, NAN, math.inf),
    each(partial(Rod, 0.05), "bending_stiffness_Nm2", "positive bending stiffness", 0.0, -0.05, NAN, math.inf),
    each(lambda bad: Rod.wire(0.05, *bad), "bad", "positive diameter and modulus", (0.0, 2e11), (1e-3, NAN), (NAN, 2e11)),
    *(each(parse_rod, "text", rf"steel:0\.3x50.*nitinol.*got {text!r}|{text!r}.*nitinol", text) for text in NO_RODS),
    each(parse_envelope, "text", r"a bounding body is cylinder:DIAMETERxHEIGHT, .* got", *NO_BODIES),
    each(accuracy_of, "stated", r"accuracy must be a number from 0 to 0\.3", *NO_ACCURACY),
    (poses, [
        ({"rod": Rod.wire(0.05, 0.0003, 210e9)}, r"a rod of 50 mm doesn't reach the axis .* at least 57.8 mm"),
        ({"clearance": 0.9}, r"clearance must lie between 1e-06 and 0\.8 rod lengths"),
        ({"clearance": 1e-300}, "clearance must lie between"),
        ({"floor": 90.0}, "floor must be a height from 0 to less than that of the bounding body, 90 mm, got 90"),
        ({"sweeps": 10**130}, r"a plan of 6e\+130 sweeps with 9 poses needs about .* GB, .* choose fewer"),
        ({"slices": 10**9, "samples": 10**4}, r"a plan of 4e\+09 sweeps with 1e\+04 poses needs about .* GB"),
    ]),
    (RigUncertainty, [
        ({"names": "clamp_x_m", "covariance": [[1.0]]}, r"rig: names must be names of quantities, got 'clamp_x_m'"),
        ({"names": ("clamp_u_m",), "covariance": [[1.0]]}, r"rig: unknown quantities clamp_u_m; known are stiffness_rel"),
        ({"names": TWO, "covariance": np.eye(3)}, r"rig: the covariance must be 2 by 2 finite numbers.*\(3, 3\)"),
        ({"names": (), "covariance": [], "sensor": (1.0, 2.0)}, r"rig: the sensor's frame must be 1 by 6 finite numbers"),
        ({"names": TWO, "covariance": [[1.0, 0.5], [0.2, 1.0]]}, r"rig: the covariance must be symmetric"),
        ({"names": TWO, "covariance": [[1.0, 2.0], [2.0, 1.0]]}, r"without negative eigenvalues"),
    ]),
    (calibrated, [
        ({"reference": 0.0}, "needs a diameter above 0"),
        ({"reference": "plain"}, "got 'plain'; the other reference is 'plane'"),
        ({"reference": 1e297}, r"a diameter of 1e\+297 m, and the rod a length of 60 mm; check the unit"),
        ({"reference": 0.03, "tare": "cubic"}, "tare must be one of auto, constant, linear, sweep"),
    ]),
    (scan3d.touches, [
        ({"points": np.zeros((4, 2))}, "must have the shape"),
        ({"points": np.full((4, 3), np.nan)}, "not finite"),
        ({"points": np.eye(3)}, "span no body"),
        ({"points": [[0, 0, 1e300], *np.eye(3)]}, "the points hold 1e"),
        ({"points": POINTS, "normals": np.zeros((3, 3))}, "normals must have the shape"),
        ({"points": POINTS, "place_sd": -1.0}, "place_sd must be finite"),
        ({"points": POINTS, "normal_sd": np.ones(3)}, "normal_sd must be one number"),
        ({"points": POINTS, "covariance": np.eye(3)}, "covariance must be finite, of the shape"),
        ({"points": POINTS, "covariance": np.full((4, 3, 3), np.nan)}, "covariance must be finite"),
        ({"points": POINTS, "covariance": np.tile(np.diag([1, 1, -1]), (4, 1, 1))}, "as 4 of 4 are"),
        ({"points": POINTS, "covariance": np.tile(np.triu(np.full((3, 3), 1e-4)), (4, 1, 1))}, "symmetric, which 4 of 4 are"),
        ({"points": POINTS, "normals": np.ma.masked_array(POINTS)}, "normals is a masked array"),
        ({"points": POINTS, "place_sd": "some"}, "place_sd must be an array of numbers, got some"),
        ({"points": POINTS, "normal_sd": ["some"]}, "normal_sd must be an array of numbers"),
        ({"points": NORMALS * [1, 1, 0]}, "a surface needs contacts that do not all lie in one plane"),
        ({"points": POINTS, "table": NAN}, "the height of the table must be a number"),
        ({"points": POINTS, "unit": "foot"}, "unit must be one of"),
    ]),
    (recording, [
        ({"field": "force_N", "change": lambda a: np.ma.masked_less(a, 0)}, "force_N is a masked array"),
        ({"field": "moment_Nm", "change": lambda a: a.astype(complex)}, "an array of real numbers, got complex128"),
        ({"field": "position_m", "change": lambda _: None}, "position_m must be an array of real numbers, got object None"),
        ({"field": "sweep", "change": lambda a: a + 0.5}, "sweep must be an array of whole numbers, got float64"),
        ({"field": "sweep", "change": lambda _: [[1], [2, 3]]}, "rows differ in length"),
        ({"field": "force_N", "change": lambda a: a[:, :1]}, r"force_N must have the shape"),
        ({"field": "rod", "change": lambda _: None}, "rod must be a scan3d.Rod, got NoneType"),
        ({"field": "noise_moment_Nm", "change": lambda _: 1j}, "must be numbers >= 0"),
        ({"field": "moment_Nm", "change": lambda a: a + 1e70}, r"moment_Nm holds 1e\+70; check its unit"),
        # its square is no number of a computer: a calibration ended in an OverflowError
        ({"field": "noise_moment_Nm", "change": lambda _: 1e300}, r"deviation of the noise is 1e\+300; check its unit"),
    ]),
    (lambda row: scan3d.reconstruct(across(row)), [
        ({"row": 4}, "turned by more than 45° against the rest of its sweep in 1 of 48 rows, first in row 5"),
    ]),
    (lambda mesh=CUBE, **plan: scan3d.simulate(mesh, scan3d.Plan(**{**dict(slices=4, samples=20), **plan})), [
        ({"model": "spatial", "rod": changed(tip_diameter_m=1e-4)}, "with the planar model"),
        ({"rod": changed(curvature_per_m=(0.0, 1.0, 0.0))}, "out of its clamp's xy plane"),
        ({"rod": changed(weight_N=1e-3), "gravity": Gravity((0, -1, 0.1), True)}, "in that"),
        *(({"spacing": "uniform", **plan}, "needs adaptive spacing, got spacing 'uniform'")
          for plan in ({"axis": "free"}, {"tolerance": 1e-3})),
        ({"mesh": "none.stl"}, r"there is no mesh file none\.stl"),
        ({"mesh": 3}, r"the body must be a trimesh\.Trimesh, got int"),
        ({"mesh": trimesh.Scene(box())}, r"got Scene; a scene becomes a mesh by its method to_mesh\(\)"),
        ({"mesh": without(box(20, 30, 40), range(10))}, "the body isn't a closed surface .*give mesh.convex_hull"),
        ({"mesh": dimpled_box(0.01)}, "the body isn't a closed surface whose faces are turned alike"),
        (mesh(np.eye(3), [[0, 1, 5]]), "a face with a vertex that does not exist"),
        ({"mesh": trimesh.Trimesh()}, "at least one triangle"),
        (mesh(np.full((3, 3), np.nan)), "finite coordinates"),
    ]),
    (compared, [
        (mesh([(0, 0, 0), (1, 0, 0)], None), "the mesh should .*at least one triangle, but it has 2 vertices"),
        ({"mesh": trimesh.Trimesh()}, "the mesh should .*at least one triangle, but it has 0 vertices"),
        (mesh([(0, 0, 0), (1, 0, np.nan), (0, 1, 0)]), "the mesh should .*finite coordinates, but 1 of its 3 vertices"),
        (mesh([(0, 0, 0), (1, 0, np.inf), (0, 1, 0)]), "the mesh should .*finite coordinates, but 1 of its 3 vertices"),
        (mesh([(3, 2, 1)] * 3), r"the mesh should .*all its 3 vertices are at \[3"),
    ]),
    (lambda call: call(), [
        ({"call": lambda: scan3d.scan(CUBE, rod={"length_m": 0.04, "tip_diamter_m": 1e-4})}, "unknown names: tip_diamter_m"),
        ({"call": lambda: scan3d.calibrate("none.csv", 0.03)}, r"can't read the recording none\.csv"),
        ({"call": lambda: scan3d.surface("log.csv")}, r"a surface is made from a scan3d\.Cloud, got str; reconstruct"),
        ({"call": lambda: scan3d.Session("sphere:50").tell("log.csv")}, r"got str; scan3d\.read_recording reads a file"),
        # before anything is read
        ({"call": lambda: scan3d.scan("none.stl", method="regression")}, "weights the contacts by the noise.*state --noise"),
    ]),
    each(sheet, "size", SIZE, "85", "85 60", "85x60", "x60mm", "85x60x40mm", "-85mm", "85em", "", "1mm."),
    each(sheet, "size", LIMITS, "10mm", "85x10mm", "0x0mm", "3000mm", "100px"),
    each(sheet, "dpi", DPI, 0, -300, 49, 2401, "fine", "", "300.5", 1e400, NAN, int),
    each(sheet, "dpi", "at most 8192 pixels along a side, and this one would have 16800; choose a smaller size", 2400),
    each(sheet, "camera", CAMERA, "", "above", "30", "30,", "30,91", "361,0", "30,20,0", "30,20,1000", "nan,0", "top,,2"),
    (by_open3d, [
        ({"points": NORMALS[:3], "normals": NORMALS[:3]}, "3 of 3 contacts have a normal.*at least 4"),
        ({"points": NORMALS, "normals": np.full_like(NORMALS, np.nan)}, "0 of 42 contacts have a normal"),
        ({"points": np.empty((0, 3)), "normals": np.empty((0, 3))}, "0 of 0 contacts"),
        *(({"points": NORMALS * part, "normals": NORMALS}, "span no body") for part in ([0, 0, 1], [1, 1, 0], 0)),
        ({"points": NORMALS * [1, 1, 1e-6], "normals": NORMALS}, "lie in one plane"),
        ({"points": NORMALS, "normals": -NORMALS}, "point inwards.*reverse them"),
        ({"points": NORMALS, "normals": NORMALS[:-1]}, r"shape \(n, 3\), got \(42, 3\) and \(41, 3\)"),
        ({"points": NORMALS[:, :2], "normals": NORMALS[:, :2]}, r"shape \(n, 3\)"),
    ]),
]  # fmt: skip

CIRCLE = planar.Circle(radius=0.9, center=(0.0, 1.3))
SWEEP = planar.sweep(CIRCLE, 0.2, samples=5)
SQUARE = np.array([[0.0, 0.5], [0.4, 0.5], [0.4, 0.9], [0.0, 0.9]])
PENTAGRAM = np.array([[np.sin(4 * np.pi * k / 5), 0.9 + 0.5 * np.cos(4 * np.pi * k / 5)] for k in range(5)])
CONE = planar.Rod(tip_diameter=0.5)
X0, F0X, F0Y, M0Z = SWEEP.reactions
HEIGHTS = {
    r"above the base line y = 0, its lowest point is at y = -?\d": (0.0, -0.1, -1e-12),
    "out of the rod's reach: its lowest point is at y = 1": (1.0, 1 - 1e-14, 1.2),
}


def at_height(lowest):
    """A circle and a square whose lowest points are at a height."""
    circle, square = planar.Circle(0.5, (0, 0.5 + lowest)), planar.Polygon(SQUARE - [0, 0.5 - lowest])
    for call in (lambda: planar.sweep(circle, samples=3), lambda: planar.events(circle)):
        with pytest.raises(ValueError, match="its lowest point is at y"):
            call()
    planar.sweep(square, samples=3)


OF_PLANAR = [
    (planar.Rod, [
        ({"tip_diameter": 0}, "tip_diameter must be a positive number"),
        *(({"curvature": value}, "curvature must be a number") for value in (NAN, "0.1", (0.1,))),
        ({"weight": -1}, "weight must be a number of at least 0"),
        ({"weight": 1}, "a rod with weight needs the direction"),
        ({"weight": 1, "gravity": (0, 0)}, "a rod with weight needs the direction"),
        *(({"compliance": value}, "compliance must be a number of at least 0") for value in (np.inf, "1", [1])),
        ({"stiffness": [1, 2]}, "stiffness must have rows"),
        ({"stiffness": [[0, 1], [0.5, 1]]}, "must rise from 0 to 1"),
        ({"stiffness": [[0, 2], [1, 1]]}, "1 at the clamp"),
        ({"stiffness": [[0, 1], [1, 1]], "tip_diameter": 0.5}, "either a tip_diameter or a table"),
    ]),
    (partial(planar.sweep, CIRCLE), [
        ({"samples": 3, "base": [0.5]}, "either its base positions .* and not both"),
        ({"samples": 0}, "whole number of at least 1, got 0"),
        ({"base": 0.5}, r"finite numbers of shape \(n,\), got 0.5"),
        ({"base": [0.4, 0.5]}, "must follow the sweep: fall"),
        ({"base": [0.5, 0.4], "direction": 1}, "must follow the sweep: .* rise in .x"),
        ({"samples": 3, "direction": 0}, "direction must be -1 or 1.*got 0"),
        ({"samples": 3, "friction": NAN}, "friction .* got nan"),
        ({"samples": 3, "friction": "0.2"}, "friction .* got '0.2'"),
        ({"samples": 3, "friction": [0.1, 0.2]}, "one for each of the 3 base positions, got 2"),
    ]),
    (partial(planar.reconstruct, X0[:1], F0X[:1], F0Y[:1], M0Z[:1]), [
        ({"method": "newton"}, "closed-form, scholz-rahn, will, got 'newton'"),
        ({"method": "will", "rod": CONE}, "'will' is for straight"),
        ({"tolerance": 1.0}, "tolerance must lie between 0 and 1, got 1.0"),
        ({"tolerance": np.full(2, 0.1)}, "tolerance.*array of the shape"),
        ({"tolerance": NAN}, "tolerance must lie between 0 and 1, got nan"),
        *(({"friction": value}, f"friction must be one number >= 0 .*, got '?{value}") for value in (np.inf, "a")),
        ({"friction": [0.1, 0.2]}, "friction must be one number >= 0 or one for each"),
    ]),
    (partial(planar.complete, X0), [
        ({"f0x": None, "f0y": F0Y, "m0z": M0Z}, "one of friction, slope and tip must be given"),
        ({"f0x": None, "f0y": F0Y, "m0z": M0Z, "friction": 0.2, "tip": True}, "one of friction, slope and tip must be given"),
        ({"f0x": F0X, "f0y": F0Y, "m0z": M0Z, "tip": True}, "exactly one of f0x, f0y and m0z must be None, got 0"),
        ({"f0x": None, "f0y": None, "m0z": M0Z, "tip": True}, "exactly one of .* got 2"),
        ({"f0x": F0X, "f0y": None, "m0z": M0Z, "friction": -1}, "friction must be one number >= 0"),
        ({"f0x": F0X, "f0y": None, "m0z": M0Z, "tip": True, "direction": 0}, "direction must be -1 or 1"),
        ({"f0x": None, "f0y": F0Y, "m0z": M0Z, "friction": 0.0}, "do not locate a contact without friction on a uniform rod"),
    ]),
    (planar.Polygon, [
        ({"vertices": PENTAGRAM}, "must not cross itself: it turns 2 times"),
        ({"vertices": SQUARE[:2]}, r"vertices of shape \(n >= 3, 2\), got \(2, 2\)"),
        ({"vertices": [[0, 0.5], [np.nan, 0.5], [0, np.inf], [1, 1]]}, "finite vertices, got 2 that are not"),
        ({"vertices": [[0, 0.5], [1, 0.5], [1, 0.5], [0, 0.5]]}, "at least three distinct vertices, got 2"),
        ({"vertices": [[0, 0.5], [1, 0.6], [2, 0.7], [1.5, 0.65]]}, "needs an area"),
        ({"vertices": [[0, 0.5], [1, 0.5], [0.4, 0.5], [0.4, 0.9]]}, "must not cross or touch itself"),
    ]),
    (planar.Curve.from_points, [
        ({"x": [0, 1], "y": [0, 1]}, r"points of shape \(n >= 3, 2\)"),
        ({"x": [0, 1, NAN], "y": [0, 1, 2]}, "finite points, got 1"),
        ({"x": [0, 1, 1, 1], "y": [0, 0, 0, 1]}, "differ from their neighbours"),
        ({"x": [0, 1, 1, 0], "y": [0.5, 1.2, 0.5, 1]}, "must not cross"),
    ]),
    (planar.Circle, [({"radius": radius, "center": (0, 1)}, "positive radius") for radius in (0.0, (0, 1), "0.9")]),
    each(lambda bad: planar.Ellipse(*bad), "bad", "an ellipse needs two positive semi-axes, a center and an angle, all finite",
         ((0.5, 0.3), 0.2), (0.5, (0, 1)), ((0, 1), (0.2, 0.1)), ((0.5, 0.3), (0, 1), (1, 2)), ((1, 1), (0, 1), "x")),
    (partial(planar.events, CIRCLE), [({"friction": value}, "friction must be one number >= 0") for value in ("x", None)]),
    *(each(at_height, "lowest", words, *heights) for words, heights in HEIGHTS.items()),
    (lambda call: call(), [
        ({"call": lambda: planar.Contours([])}, "at least one"),
        ({"call": lambda: planar.Contours([planar.Circle(0.3, (x, 0.8)) for x in (0, 0.1)])}, "must not overlap"),
        ({"call": lambda: planar.errors(F0X, F0Y, M0Z, noise=(1e-3, 1e-3), missing="fz")}, "missing must be one of"),
        *(({"call": lambda noise=noise: planar.errors(F0X, F0Y, M0Z, noise=noise)}, "noise must be two numbers >= 0")
          for noise in ((-1e-3, 1e-3), (NAN, 1), 1e-3, (1, 1, 1), ("a", 1))),
        ({"call": lambda: planar.errors(F0X, F0Y, M0Z, noise=(1, 1), covariance=np.eye(3))}, r"covariance .* \(n, 3, 3\)"),
        ({"call": lambda: planar.elastic_lines(X0, F0X, F0Y, M0Z, points=10.5)}, "whole number of at least 2 points, got 10.5"),
        ({"call": lambda: planar.free_reactions(planar.Rod(weight=20.0, gravity=(0, -1)))}, "more than one shape under its"),
        ({"call": lambda: planar.touched_at(3.0, rod=planar.Rod(curvature=0.1))}, "straight rod without weight"),
        ({"call": lambda: planar.complete_by_moment([0.0], [0.1], 1.2)}, "start must be an arc length"),
        ({"call": lambda: planar.events(CIRCLE, rod=planar.Rod(curvature=0.1))}, "straight at rest and weightless"),
    ]),
]  # fmt: skip
NO_PLANAR_ROD = [each(lambda call: call(), "call", r"rod must be a planar\.Rod, or None for the straight and uniform one, got",
    lambda: planar.sweep(CIRCLE, rod="steel"), lambda: planar.sweep(CIRCLE, rod=0.3, direction=1),
    lambda: planar.events(CIRCLE, rod=0.3), lambda: planar.reconstruct(*SWEEP.reactions, rod="steel"),
    lambda: planar.free_reactions(3))]  # fmt: skip
CASES = [
    pytest.param(kind, make, given, words, id=f"{words[:30]} {k}")
    for kind, groups in ((InputError, OF_SCAN3D), (ValueError, OF_PLANAR), (TypeError, NO_PLANAR_ROD))
    for make, cases in groups
    for k, (given, words) in enumerate(cases)
]


@pytest.mark.slow
@pytest.mark.parametrize(("kind", "make", "given", "words"), CASES)
def test_arguments_that_can_not_be_used(kind, make, given, words):
    with pytest.raises(kind, match=words) as error:
        make(**given)
    assert "\n" not in str(error.value)
    assert len(str(error.value)) < 600


HEADER = "sweep,x_m,y_m,z_m,qw,qx,qy,qz,fx_N,fy_N,mz_Nm"
ROW = "0,0.1,0.2,0.3,1,0,0,0,-0.01,0.02,0.0005"
RIGHT = f"{HEADER}\n{ROW}\n"
TOML = "[rod]\nlength_m = 0.05\nbending_stiffness_Nm2 = 8.35e-5\n"
POSES = "0,0,0,0,1,0,0,0,sweep\n0,-1,0,0,1,0,0,0,sweep\n"
BENT = '[quantities]\na_mm = 1\n[covariance]\nquantities = ["a_mm"]\nmatrix = [["x"]]\n'


def log(table, toml=TOML):
    return {"log.csv": table, **({} if toml is None else {"log.toml": toml})}


def with_cell(column, value):
    values = ROW.split(",")
    values[HEADER.split(",").index(column)] = value
    return log(f"{HEADER}\n{ROW}\n{','.join(values)}\n")


def of_six(*given):
    return log(f"{HEADER},{','.join(given)}\n{ROW}{',1' * len(given)}\n")


SIX = r"log\.csv: six-axis data need fz_N, mx_Nm, my_Nm, but the header lacks "
FILES = [
    (scan3d.read_recording, [
        (log(""), "log.csv is empty; expected a table with one row per sample"),
        (log(f"{HEADER}\n"), "log.csv: the recording has no samples: expected at least one row"),
        (log("mz_Nm\n1\n"), "its header lacks sweep, x_m, y_m, z_m, qw, qx, qy, qz, fx_N, fy_N; expected"),
        (log(f"{HEADER}\n{ROW}\n".replace(",", ";")), "is not a recording: its header lacks"),
        (log(f"{HEADER},fx_N\n{ROW},3\n"), "its header has fx_N more than once; keep one column of each name"),
        (of_six("fz_N"), f"{SIX}mx_Nm, my_Nm;"),
        (of_six("fz_N", "mx_Nm"), f"{SIX}my_Nm;"),
        (with_cell("x_m", "nan"), r"log\.csv: line 3 has no value in column 'x_m', .* 1 of 2 rows; complete the table$"),
        (with_cell("qx", "1"), r"that of row 2 has the length 1\.414$"),
        (with_cell("sweep", "0.5"), r"log\.csv: line 3 has 0\.5 in column 'sweep', where a whole number is expected"),
        (log(RIGHT, None), r"log\.csv needs log\.toml beside it, with the rod's length_m and bending_stiffness_Nm2"),
        (log(RIGHT, ""), r"log\.toml: \[rod\] needs length_m and bending_stiffness_Nm2, or length_m, diameter_m and modul"),
        (log(RIGHT, TOML.replace("0.05", "-0.05")), r"log\.toml: \[rod\] a rod needs a positive length in metres"),
        (log(RIGHT, "unit = 'furlong'\n" + TOML), r"log\.toml: unit must be one of m, cm, mm, um, in; got 'furlong'"),
        (log(RIGHT, TOML + "[noise]\nforce_N = -1\n"), r"\[noise\] force_N must be a finite number of at least 0, got -1"),
    ]),
    (scan3d.touches, [
        ({"a.stl": ""}, "expected a file ending in"),
        ({"a.csv": "x,y\n1,2\n"}, "no column z"),
        ({"a.csv": "1,2,3,4\n5,6,7,8\n"}, "name them in the first line"),
        ({"a.csv": "x_mm,y_mm,z_m\n1,2,3\n"}, "give all of them in one unit"),
        ({"a.csv": "x,y,z,sd,sigma\n1,2,3,1,1\n"}, "two columns of place_sd"),
        ({"a.csv": "x,y,z,x\n1,2,3,1\n"}, "its header has x more than once"),
        ({"a.pcd": "FIELDS x y z\nDATA ascii\n1 2 3\n"}, "not a PCD file"),
        ({"a.pcd": "nothing\n"}, "no line that begins with DATA"),
    ]),
    (scan3d.read_rig, [
        ({"rig.toml": ""}, r"rig.toml: \[rod\] needs length_m and bending_stiffness_Nm2"),
        ({"rig.toml": TOML + "[sensr]\n"}, "unknown names: sensr.*did you mean sensor"),
        ({"rig.toml": TOML.replace("8.35e-5", "-1")}, "positive bending stiffness"),
        ({"rig.toml": TOML + BENT}, r"\[covariance\]"),
    ]),
    (read_poses, [
        ({"p.csv": POSES + "0,1,2\n"}, "p.csv: line 4 has 3 values, expected 9; it ends in column 3: is it cut off"),
        ({"p.csv": POSES.replace("sweep", "fly", 1)}, "'fly' in column 'move', where one of approach, sweep, retract, probe"),
        ({"p.csv": POSES + "1,0,0,0,1,0,0,0,sweep\n"}, "sweep 1 has 1 rows of the move sweep"),
    ]),
]  # fmt: skip


@pytest.mark.parametrize(
    ("read", "files", "words"), [(read, files, words) for read, cases in FILES for files, words in cases]
)
def test_files_that_can_not_be_used(tmp_path, read, files, words):
    head = ",".join(POSE_COLUMNS) + "\n" if "p.csv" in files else ""
    for name, text in files.items():
        (tmp_path / name).write_text(head + text, encoding="utf-8")
    with pytest.raises(InputError, match=words) as error:
        read(tmp_path / next(iter(files)))
    assert "\n" not in str(error.value)
