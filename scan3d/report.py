"""The report of a result: its numbers, and the most important of them in words, for the terminal and for pages.

What was measured of the body is stated as in a certificate of measurement.  Source: JCGM 100:2008, *Guide to the expression of
uncertainty in measurement* (GUM), and JCGM 101:2008 for intervals that are not symmetric about the value.
"""

from __future__ import annotations

import platform
from collections.abc import Iterator, Mapping
from dataclasses import asdict, dataclass, field
from importlib.metadata import version
from typing import TYPE_CHECKING, Any

import numpy as np

import planar
from scan3d.arrays import ROUNDING, Array
from scan3d.bounds import Allowed, Certificate, Enclosure, Premise, allowed, certificate, missing, premises
from scan3d.bounds.reach import Reach
from scan3d.cloud import Cloud, NormalSource
from scan3d.comparison import Comparison
from scan3d.errors import NoBodyError
from scan3d.files.whole import SCHEMA
from scan3d.geometry.hulls import HULL_OF_MESH
from scan3d.reconstruction import LARGEST_SHARE, Contradiction, Diagnosis, radius_errors
from scan3d.recording import LARGEST_OVER_SD, Known, Recording
from scan3d.rigs import RigUncertainty
from scan3d.rods import Rod
from scan3d.shown import Rows
from scan3d.units import is_finite, length, lengths, number, share, volume

if TYPE_CHECKING:
    import trimesh

    from scan3d.surfaces.any_shape import AnyShape


# What a summary says of surfaces by their methods, where the names are no words of the field.
_IN_WORDS = {
    "hull": "hull of the contacts",
    "bracket": "between the bounds",
    "support": "fit of a smooth body",
    "regression": "fit of planes",
    "cut": "between contacts and free space",
}
# The part of simulated probings without an equilibrium beyond which a summary says so.
_MANY_LOST = 0.2
_NO_REACH = "no reach is stated, and the rod has no bead"


@dataclass(frozen=True, repr=False)
class Analysis:
    """Results from contacts: bounds, surface and certificate; with the truth, also the comparison with it."""

    recording: Recording | None
    """What was measured; None for touches of another probe."""
    cloud: Cloud
    bounds: Enclosure
    surface: trimesh.Trimesh
    """A `trimesh.Trimesh` in the cloud's unit; `metadata` has its `method` and the `reason` for it.  Empty, with the reason,
    where the contacts span no body."""
    certificate: Certificate
    truth: trimesh.Trimesh | None = None
    """The true body, a `trimesh.Trimesh`."""
    contact_error: Array | None = None
    """(n,) distance of the contacts from the truth."""
    comparison: Comparison | None = None
    """Comparison of the surface with the truth."""
    reached: Mapping[str, float] = field(default_factory=dict)
    """Of a body that is not convex the `share` of the truth's area near contacts, and `max` and `mean` distance there."""
    mesh_comparison: Comparison | None = None
    """Comparison of the surface with the mesh itself, where the truth is the convex hull of a mesh that is not convex."""
    seconds: Mapping[str, float] = field(default_factory=dict)
    """Time spent on each step."""
    any_shape: AnyShape | None = None
    """What is known of a body that is not convex, and where; None for a convex one."""
    reach: Reach | None = None
    """What a stated finest feature bounds; None without one, for convex bodies, and where nothing is certified."""
    warnings: tuple[Contradiction, ...] = ()
    """Contradictions between the recording and the model; with any of them nothing is certified."""
    diagnosis: Diagnosis | None = None
    """The likeliest fault of a recording that contradicts the model, or whose sweeps differ by what the bounds allow for."""
    source: Mapping[str, Any] = field(default_factory=dict)
    """Where the contacts come from: that of the recording, or of touches."""

    def __repr__(self) -> str:
        return f"Analysis of {len(self.cloud)} contacts: {len(self.surface.faces)} faces"

    @property
    def has_surface(self) -> bool:
        """Whether the contacts span a body."""
        return len(self.surface.faces) > 0

    def checked_surface(self) -> trimesh.Trimesh:
        """The surface.  Raises NoBodyError if the contacts span no body."""
        if not self.has_surface:
            raise NoBodyError(self.surface.metadata["reason"])
        return self.surface


def report(analysis: Analysis, *, settings: Mapping[str, Any]) -> dict[str, Any]:
    """The numbers of an analysis as they are written to JSON; those that need the true mesh are None without it.

    `settings` are those of the run, which the report repeats.
    """
    recording, cloud, surface, comparison = analysis.recording, analysis.cloud, analysis.surface, analysis.comparison
    unit, packages = cloud.unit, ("scan3d", "numpy", "scipy", "trimesh", "pyvista")
    return {
        "schema": SCHEMA,
        "model": cloud.model,
        "mesh": None if analysis.truth is None else _mesh(analysis.truth, unit),
        "body": {
            "convex": cloud.convex and not (recording and recording.stated_hollow),
            "parts": int(surface.body_count) if analysis.has_surface else None,
        },
        "settings": dict(settings),
        "source": dict(analysis.source),
        "versions": {"python": platform.python_version(), **{name: version(name) for name in packages}},
        "rod": None if recording is None else _rod(recording.rod, cloud),
        "counts": _counts(analysis),
        "contact_error": _contact_error(analysis.contact_error, cloud),
        "friction": _friction(cloud, settings.get("friction"), None if recording is None else recording.completed),
        "hausdorff": _hausdorff(analysis, unit),
        "comparison": None if comparison is None else asdict(comparison),
        "certificate": _certificate(analysis),
        "measurands": measurands(cloud, analysis.bounds, surface, analysis.certificate, _untested(analysis))
        if analysis.has_surface
        else [],
        "warnings": [warning._asdict() for warning in analysis.warnings],
        "diagnosis": None if analysis.diagnosis is None else analysis.diagnosis._asdict(),
        "noise": _noise(recording) | {"independent": cloud.independent, "contact_median": cloud.noise},
        **({} if recording is None else _calibration(recording.rig, cloud)),
        "coverage": coverage(cloud, analysis.bounds, surface, analysis.certificate)
        | ({} if analysis.any_shape is None else analysis.any_shape.coverage),
        "surface": {
            "method": surface.metadata["method"],
            "reason": surface.metadata["reason"],
            "watertight": bool(surface.is_watertight) if analysis.has_surface else None,
            "faces": len(surface.faces),
            "volume": float(surface.volume) if analysis.has_surface else None,
            "volume_error": None if comparison is None else comparison.volume_error,
        },
        "normals": None
        if comparison is None
        else {"of": "surface", "median_deg": comparison.normal_median_deg, "p95_deg": comparison.normal_p95_deg},
        "timings_s": rounded(analysis.seconds),
        "files": [],
    }


def rounded(seconds: Mapping[str, float]) -> dict[str, float]:
    """Time spent on each step, to milliseconds."""
    return {name: round(value, 3) for name, value in seconds.items()}


def _mesh(mesh: Any, unit: str) -> dict[str, Any]:
    return {
        "file": mesh.metadata.get("file"),
        "sha256": mesh.metadata.get("sha256"),
        "faces": mesh.metadata.get("file_faces", len(mesh.faces)),
        "extents": mesh.extents,
        "unit": unit,
        "dent": mesh.metadata.get("dent"),
        "hull": mesh.metadata.get("hull"),
        "scanned": _scanned(mesh),
        "filled": mesh.metadata.get("filled"),
    }


def _counts(analysis: Analysis) -> dict[str, int | None]:
    recording, cloud = analysis.recording, analysis.cloud
    off = {} if analysis.any_shape is None else {"off_surface": analysis.any_shape.off}
    if recording is None:
        known = int((cloud.normal_source == NormalSource.MEASURED).sum())  # others are estimated of the touches around
        return {"slices": 0, "sweeps": 0, "contacts": len(cloud), "with_normals": known, "light": 0, **off}
    slices = len(np.unique(cloud.slice[cloud.slice >= 0]))
    return {
        "slices": slices,
        "empty_slices": len(cloud.slice_height) - slices,
        "unproven_slices": 0 if cloud.unresolved is None else int(cloud.unresolved.sum()),
        "sweeps": len(np.unique(recording.sweep)),
        **({} if cloud.probed is None else {"probings": len(np.unique(recording.sweep[recording.in_probings]))}),
        "samples": len(recording),
        "contacts": len(cloud),
        "tangential": int((cloud.phase == planar.Phase.TANGENTIAL).sum()),
        "tip": int((cloud.phase == planar.Phase.TIP).sum()),
        "light": cloud.light,
        **({} if cloud.convex else _second(analysis)),
        **off,
        "left_out": 0 if cloud.left_out is None else len(cloud.left_out.rows),
        **({} if cloud.unmeasured is None else {"not_measured": len(cloud.unmeasured.rows)}),
    }


def _second(analysis: Analysis) -> dict[str, int | None]:
    """Rows with a second contact that were found, and, against the truth, contacts that are wrong because one stayed hidden."""
    cloud, hidden = analysis.cloud, None
    if analysis.contact_error is not None:
        noise = np.zeros(len(cloud)) if cloud.place_sd is None else cloud.place_sd
        # farther off than this an exact contact has another cause than rounding
        allowed = 1e-8 * cloud.rod_length + LARGEST_OVER_SD * noise
        hidden = int((analysis.contact_error > allowed).sum())
    unresolved = analysis.source.get("unresolved")
    return {"second_contacts": cloud.second, "hidden_second_contacts": hidden, "unresolved": unresolved}


def _friction(cloud: Cloud, friction_set: str | None, known: Known | None) -> dict[str, Any]:
    """What contacts tell of friction: nothing where it stands for a reaction that was not measured."""
    if known is not None and known.friction is not None:
        return {"set": friction_set, "estimated_median": None, "estimated_range": None, "assumed": known.friction}
    friction, law = cloud.friction[cloud.phase == planar.Phase.TANGENTIAL], {}
    if cloud.model == "spatial":
        friction = cloud.friction[np.isfinite(cloud.friction)]
        angle = np.empty(0) if cloud.slip_to_path is None else cloud.slip_to_path[np.isfinite(cloud.slip_to_path)]
        law = {"slip_to_path_deg": float(np.degrees(np.median(angle))) if len(angle) else None}
    return {
        "set": friction_set,
        "estimated_median": float(np.median(friction)) if len(friction) else None,
        "estimated_range": [float(friction.min()), float(friction.max())] if len(friction) else None,
        **law,
    }


def _rod(rod: Rod, cloud: Cloud) -> dict[str, Any]:
    """What is stated of the rod, and what its radius does to the contacts; a planar recording may state no diameter."""
    known = rod.stated() | {"length": cloud.rod_length}
    if cloud.bead_radius:
        known["bead_diameter"] = 2 * cloud.bead_radius
    if cloud.rod_radius or not cloud.in_slices:
        tapered = {"tapered": True} if cloud.tapered else {}
        radius = {**radius_errors(cloud), "unit": cloud.unit}
        known |= {"diameter": 2 * cloud.rod_radius, **tapered, "radius": radius}
    return known


def _noise(recording: Recording | None) -> dict[str, float]:
    """The errors of a recording with those of its digits, and as they are stated."""
    if recording is None:
        return {}
    return {
        "force_N": recording.noise.force_N,
        "moment_Nm": recording.noise.moment_Nm,
        "stated_force_N": recording.noise_force_N,
        "stated_moment_Nm": recording.noise_moment_Nm,
        "stated_pose_m": recording.noise_pose_m,
    }


def _contact_error(errors: Array | None, cloud: Cloud) -> dict[str, Any] | None:
    if errors is None:
        return None
    largest, rms = float(errors.max()), float(np.sqrt(np.mean(errors**2)))
    return {"max": largest, "rms": rms, "unit": cloud.unit, "max_rod_lengths": largest / cloud.rod_length}


def _untested(analysis: Analysis) -> str:
    """Why nothing is certified where nothing contradicts the model."""
    return "" if analysis.recording is None or analysis.warnings else analysis.recording.untested


def _certificate(analysis: Analysis) -> dict[str, Any]:
    """The certified bound and its parts, and the bound relative to the diagonal of the contacts' bounding box."""
    bound, bounds, cloud, recording = analysis.certificate.bound, analysis.bounds, analysis.cloud, analysis.recording
    is_real = recording is not None and recording.source.get("kind") != "simulation"
    grown = (  # what contacts and bounds are those of, in the place of the body
        "the body grown by the rod's radius, which counts as 0: if it is not, state diameter_m under [rod], in the map of an "
        "import or in the TOML file of the recording"
    )
    reached, why, untested = analysis.reach, analysis.surface.metadata["reason"], _untested(analysis)
    if analysis.has_surface:
        why = "" if np.isfinite(bounds.bound) or analysis.warnings or not cloud.convex else untested or missing(cloud)
    untrusted = contradicted(cloud.model) if analysis.warnings else untested
    left, contours = cloud.left_out, None if analysis.any_shape is None else analysis.any_shape.contours_bound
    contours = np.inf if contours is not None and untrusted else contours
    parts = bounds.parts() | _off(cloud, bounds)
    assumed = premises(recording, cloud, {warning.code for warning in analysis.warnings})
    if reached is not None:
        outcome = "contacts and free space do not contradict it, which proves nothing"
        outcome = "contradicted" if reached.refuted else reached.unbounded or outcome
        assumed += (Premise(reached.premise, not reached.unbounded, outcome),)
    return {
        "bound": bound,
        "relative": analysis.certificate.relative(cloud.points),
        "unit": cloud.unit,
        "hull_bound": bounds.bound,
        "confidence": _confidence(cloud, bounds, bound, contours, None if reached is None else reached.outer_volume),
        "premise": "; ".join(premise.assumed for premise in assumed),
        "premises": [premise._asdict() for premise in assumed],
        "relative_error": 0.0 if cloud.calibration is None else cloud.calibration.relative,
        "left_out": left
        and {"rows": len(left.rows), "share": left.share, "largest_share": LARGEST_SHARE, "noise_factor": left.factor},
        **({} if cloud.unmeasured is None else {"not_measured": list(cloud.unmeasured.words)}),
        "table": cloud.table,
        **({} if analysis.any_shape is None else {"contours": {"bound": contours}, **_between(reached, untrusted)}),
        "missing": why,
        "grown": grown if is_real and recording and not recording.rod.diameter_m else None,
        # without a bound neither it nor the volume has parts or ends
        "parts": parts if bounds.confidence else dict.fromkeys(parts),
        "volume": list(bounds.volume) if bounds.confidence else [None, None],
    }


def _between(reached: Reach | None, untrusted: str) -> dict[str, Any]:
    """The volumes of the outer body and between it and the inner one, why there is none, and where they are farthest apart.

    `untrusted` is why nothing is certified of the recording, whatever the reach; empty where something may be.
    """
    found, why = None, untrusted or _NO_REACH
    if reached is not None:
        found, why = reached.volume_between, reached.refuted or reached.unbounded or "the inner body is empty"
    return {
        "outer_volume": None if reached is None else reached.outer_volume,
        "volume_between": found,
        "volume_between_missing": "" if found is not None else why,
        "widest": [] if reached is None else reached.widest,
    }


def _scanned(truth: trimesh.Trimesh) -> str:
    """What the true body is: the mesh, or its convex hull where that differs."""
    return HULL_OF_MESH if "filled" in truth.metadata else "mesh"


def _hausdorff(analysis: Analysis, unit: str) -> dict[str, Any] | None:
    comparison, to_mesh = analysis.comparison, analysis.mesh_comparison
    if comparison is None or analysis.truth is None:
        return None
    return {
        **_distances(comparison),
        "exact": comparison.exact,
        "worst_point": comparison.worst_point,
        "unit": unit,
        "to": _scanned(analysis.truth),
        "mesh_itself": None if to_mesh is None else _distances(to_mesh),
        **({"reached": dict(analysis.reached)} if analysis.reached else {}),
    }


def _distances(comparison: Comparison) -> dict[str, float]:
    names = ("surface_to_mesh", "mesh_to_surface", "relative")
    return {"two_sided": comparison.hausdorff, **{name: getattr(comparison, name) for name in names}}


_DISTANCE = "distance of the surface from the body"


def measurands(
    cloud: Cloud, bounds: Enclosure, surface: Any, certified: Certificate, untested: str = ""
) -> list[dict[str, Any]]:
    """The quantities that are measured of a body, with their uncertainties, as `docs/trust.md` explains them.

    The coverage factor is the number of standard deviations of each contact that the interval allows for: larger than 2,
    because it holds for all contacts at once.  Where the reactions are exact, and the rig's calibration is not, it is that of
    the calibration.  `untested` is why nothing is certified of a recording that nothing contradicts.
    """
    unit, probability = cloud.unit, _confidence(cloud, bounds, certified.bound)
    vertices = np.asarray(surface.vertices)
    allow = _allowed(cloud, bounds)
    factor = None if allow is None else allow.kappa or allow.factor

    if not cloud.convex:
        reason = "the body is not convex"
    elif not bounds.confidence:
        reason = "the rod's radius changes" if cloud.tapered else untested or contradicted(cloud.model)
    else:
        reason = "nothing bounds the body on some side"

    def measured(quantity: str, value: float, low: float, high: float, power: str = "") -> dict[str, Any]:
        known = bool(np.isfinite(high))
        # where both bodies are the true one the ends differ by the rounding of coordinates
        rounding = 0.0 if quantity == _DISTANCE else ROUNDING * max(abs(value), float(np.abs(vertices).max()))
        low, high = max(low - rounding, 0.0), high + rounding
        return {
            "quantity": quantity,
            "of": certified.of,
            "value": value if known else None,
            "unit": unit + power,
            "interval": [low if known or bounds.confidence else -np.inf, high],
            "expanded_uncertainty": max(high - value, value - low) if known else None,
            "coverage_probability": probability if known or bounds.confidence else None,
            "coverage_factor": factor,
            "reason": "" if known else reason,
        }

    directions = np.concatenate([np.eye(3), -np.eye(3)])
    lower, upper = bounds.support(directions)
    size = np.ptp(vertices, axis=0)
    least, largest = np.maximum(lower[:3] + lower[3:], 0.0), upper[:3] + upper[3:]
    columns = zip("xyz", size.tolist(), least.tolist(), largest.tolist(), strict=True)
    low, high = bounds.volume
    return [
        *(measured(f"extent along {axis}", *values) for axis, *values in columns),
        measured("volume", float(surface.volume), float(low), float(high), "³"),
        measured(_DISTANCE, 0.0, 0.0, float(certified.bound)),
    ]


def _confidence(cloud: Cloud, bounds: Enclosure, *stated: float | None) -> float | None:
    """The probability with which what is certified holds; None if neither the enclosure nor what is stated is finite."""
    return bounds.confidence or (allowed(cloud).confidence if any(map(is_finite, stated)) else None)


def _allowed(cloud: Cloud, bounds: Enclosure) -> Allowed | None:
    """What the bounds allow for; None if that is nothing, or if nothing is certified."""
    return allowed(cloud, bounds.confidence) if 0 < bounds.confidence < 1 else None


def _off(cloud: Cloud, bounds: Enclosure) -> dict[str, float]:
    """The largest errors of a contact that the bounds allow for: by noise and digits, and those that are the same in all rows.

    The latter are those of the rig's calibration and of the wrench; without either there are none.
    """
    allow, noise = _allowed(cloud, bounds), bounds.margin
    if cloud.place_sd is not None and allow is not None and allow.kappa is not None:
        noise += allow.kappa * float(cloud.place_sd.max())
    if cloud.calibration is None:
        return {"noise": noise}
    return {"noise": noise, "systematic": 0.0 if allow is None else allow.largest}


def _calibration(rig: RigUncertainty | None, cloud: Cloud) -> dict[str, Any]:
    """The entry on what is not known exactly of the rig that corrected a recording; none without a calibration."""
    if rig is None or (found := cloud.calibration) is None:
        return {}
    known = {
        "standard_deviations": dict(zip(rig.names, np.sqrt(np.diag(rig.covariance)).tolist(), strict=True)),
        "taken_as_exact": list(rig.exact),
        "independent_errors": found.count,
        "contact_median": float(np.median(found.place_sd)),
        "contact_max": float(found.place_sd.max()),
    }
    return {"calibration": known}


def coverage(cloud: Cloud, bounds: Enclosure, surface: Any, certified: Certificate) -> dict[str, Any]:
    """How much of the body the contacts cover.

    `surface` is the fraction of the surface's area where the certified bound is at most 0.1 % of the diagonal, or 0.5 % for
    contacts of the spatial model, as `surface_within` says; None where nothing is certified.
    """
    diagonal = float(np.linalg.norm(np.ptp(cloud.points, axis=0)))
    within = (1e-3 if cloud.in_slices else 5e-3) * diagonal
    if not bounds.confidence:
        return {"surface": None, "surface_within": within}
    bound = certified.at_vertices
    if bounds.slabs is None and len(surface.faces) < 2000:  # contacts lie anywhere, and facets may be large
        surface = surface.subdivide_to_size(float(np.linalg.norm(surface.extents)) / 50, max_iter=100)
        bound = certificate(bounds, surface).at_vertices
    area = np.asarray(surface.area_faces)
    closed = bound[surface.faces].max(axis=1) <= within
    return {"surface": float(area[closed].sum() / area.sum()), "surface_within": within}


# --- in words ---


def summary(data: Mapping[str, Any]) -> tuple[str, Rows]:
    """The most important numbers of a report: what it comes to in a sentence, and the name and value of each quantity."""
    return _in_a_sentence(data), [*_of_contacts(data), *_of_surface(data), *_of_certificate(data)]


def _of_contacts(data: Mapping[str, Any]) -> Iterator[tuple[str, str]]:
    """What was scanned and touched, how well contacts are known, and what was left out."""
    counts, certified, rod, errors = data["counts"], data["certificate"], data.get("rod") or {}, data["contact_error"]
    mesh, probings = data.get("mesh") or {}, counts.get("probings", 0)
    swept = counts["slices"] + counts.get("empty_slices", 0)
    if filled := mesh.get("filled"):
        dents = f", which fills dents up to {length(filled['depth'], mesh['unit'])} deep" if filled["depth"] else ""
        part = "" if filled["volume_relative"] is None else f", {share(filled['volume_relative'])} of its volume"
        yield "scanned", f"the {HULL_OF_MESH}{dents}{part}{'; the mesh is open' if filled['open'] else ''}"
    if data.get("model") == "touches":
        yield "touches", f"{counts['contacts']}, {counts['with_normals']} of them with normals"
    else:
        empty = f" ({counts['slices']} with contact)" if swept > counts["slices"] else ""
        where = "space" if data.get("model") == "spatial" else _count(swept, "slice") + empty
        sweeps = f"{_count(counts['sweeps'] - probings, 'sweep')} in {where}" if counts["sweeps"] > probings else ""
        moves = " and ".join(filter(None, [sweeps, _count(probings, "probing") if probings else ""]))
        yield "contacts", f"{counts['contacts']} of {counts['samples']} samples, {moves}"
    if errors:
        yield "contact error", f"{length(errors['max'], errors['unit'])} at most{of_scanned(data, 'from')}"
    most = data["settings"].get("slices", 0)
    if data.get("model") == "planar" and swept < most and not probings:
        yield "slices", f"{swept} of at most {most}: the tolerance is met, or more would not lower the bound"
    if (assumed := data["friction"].get("assumed")) is not None:
        yield "friction", f"{number(assumed)}, assumed: it stands in [known]"
    if (median := data["friction"]["estimated_median"]) is not None:
        given = f"; set: {data['friction']['set']}" if data["friction"]["set"] else ""
        yield "friction", f"{number(median)} (median, estimated from touch{given})"
    if counts["light"]:
        yield "light touches", f"{counts['light']} contacts left out, whose place the noise hides"
    if (left_out := certified.get("left_out")) and left_out["rows"]:
        part = f"{left_out['rows']} rows that contradict their neighbours, {share(left_out['share'])} of those with a force"
        yield "left out", f"{part}; the others count with {number(left_out['noise_factor'])} times the stated noise"
    for words in certified.get("not_measured", ()):
        yield "not measured", words
    if (radius := rod.get("radius", {})).get("moved"):
        left, unit = max(radius["left"] or 0.0, radius["left_unknown"] or 0.0), radius["unit"]
        leaves = f", which leaves errors up to {length(left, unit, digits=1, up=True)}" if left else ""
        yield "rod's radius", f"contacts moved by {length(radius['moved'], unit)} from the rod's centre line{leaves}"
    if (rig := data.get("calibration")) and (systematic := certified["parts"]["systematic"]) is not None:
        exact = ", ".join(rig["taken_as_exact"])
        unknown = f"; not determined by it, and taken as exact: {exact}" if exact else ""
        allowed_for = length(systematic, certified["unit"], up=True)
        yield "calibration", f"allowed for with up to {allowed_for} at a contact{unknown}"


def _of_surface(data: Mapping[str, Any]) -> Iterator[tuple[str, str]]:
    """How the surface was made, how far it is from the true body, and what of a body that is not convex is known."""
    surface, counts, distances = data["surface"], data["counts"], data["hausdorff"]
    closed = "watertight" if surface["watertight"] else "not watertight"
    method = _IN_WORDS.get(surface["method"], surface["method"])
    yield "surface", f"{method}, {closed}" if method else f"none: {surface['reason']}"
    if distances:
        unit = distances["unit"]
        found = "" if distances["exact"] else ", the largest found"
        yield "Hausdorff distance", _distance(distances, unit) + of_scanned(data, "to") + found
        if _refuted(data):
            yield (
                "refuted",
                "the true body is farther away than what is certified: it is another one, in another unit or place, or a "
                "premise does not hold",
            )
        if distances.get("mesh_itself"):
            yield "to the mesh itself", _distance(distances["mesh_itself"], unit)
        if near := distances.get("reached"):
            part = share(near["max"] / data["comparison"]["diagonal"])
            over = f"{length(near['mean'], unit)} in the mean, over {_at_least(near['share']):g} % of the true area"
            if near["in_cavities"]:
                over += f"; {share(near['in_cavities'])} bounds closed cavities, where nothing from outside comes"
            most = f"{length(near['max'], unit, up=True)} at most ({part} of the diagonal), at up to 20,000 places"
            yield "where touched", f"{most}; {over}"
    measured = next((one for one in data.get("measurands", ()) if one["quantity"] == "volume"), None)
    if measured and not data["warnings"] and all(map(is_finite, measured["interval"])):
        low, high = measured["interval"]
        known = volume(measured["value"], low, high, data["certificate"]["unit"])
        yield "volume", f"{known}, certified{of_scanned(data)}"
    if "second_contacts" in counts:
        left_out = counts["second_contacts"]
        words = f"{left_out} samples left out, whose rod touched at another place as well"
        if left_out > counts["contacts"]:
            words += ", or whose force and moment are wrong: check the frame of the sensor, and calibrate"
        yield "second contacts", words
        probings, lost = counts.get("probings", 0), counts["unresolved"] or 0
        if lost > _MANY_LOST * (probings + lost) and probings:
            yield "unresolved", f"{lost} probings left out, whose end slips off; a smaller --stop-force leaves fewer"
        if hidden := counts["hidden_second_contacts"]:
            known = "farther from the true body than their errors explain: a second contact stayed hidden, or errors are larger"
            yield "hidden", f"{_count(hidden, 'contact')} {'is' if hidden == 1 else 'are'} {known} than stated"
    if (off := counts.get("off_surface")) and surface["method"] == "cut":
        found, more = ("touches", "more touches") if data.get("model") == "touches" else ("contacts", "more slices")
        of_all = f"{off} of {counts['contacts']} {found} are farther from the surface than {found} are apart"
        cause = f"they are wrong, or on features finer than what was touched; {more} show them"
        yield "off the surface", f"{of_all}: {cause}"


def _of_certificate(data: Mapping[str, Any]) -> Iterator[tuple[str, str]]:
    """What is certified, or why nothing is, and what the certificate assumes, as far as the data could test it."""
    certified = data["certificate"]
    yield "certified", _certified(data)
    if (
        data["surface"]["method"]
        and not data["warnings"]
        and ("contours" in certified or is_finite(certified["bound"]))
    ):
        premises = certified["premises"]
        untested = ", ".join(premise["assumed"] for premise in premises if not premise["tested"])
        outcomes = "; ".join(premise["outcome"] for premise in premises if premise["tested"])
        yield "assumed", certified["premise"]
        yield "tested", "; ".join(filter(None, [outcomes, f"not tested: {untested}" if untested else ""]))
    if certified.get("grown"):
        yield "measured", certified["grown"]


def _certified(data: Mapping[str, Any]) -> str:
    certified, counts = data["certificate"], data["counts"]
    if data["warnings"]:
        return f"nothing, because {contradicted(data.get('model'))}: see the warnings"
    if not data["surface"]["method"]:
        return "nothing, as there is no surface"
    if is_finite(certified["bound"]):
        bound, table = _within(certified), certified.get("table")
        if "contours" in certified:
            return f"{bound}, by the reach"
        on_table = "" if table is None else f", and the table at z = {length(table, certified['unit'], digits=5)}"
        part = f"({share(certified['relative'], up=True)} of the diagonal){of_scanned(data)}"
        return f"{bound} {part}, from touch alone{on_table}{_with_confidence(certified)}"
    if "contours" in certified:
        nothing = "nothing, because the body is not convex"
        if certified.get("outer_volume") is not None:
            gaps = len(certified["widest"])
            left = (
                f"; {gaps} places outside of the surface are narrower than the bead, or not on its way" if gaps else ""
            )
            return f"from outside, by the bead: the body lies in that of outer.ply{left}"
        if (why := certified.get("volume_between_missing")) and why != _NO_REACH:
            nothing = why if why.startswith("nothing") else f"nothing: {why}"
        elif counts.get("probings"):
            nothing += "; --reach states how fine its features are"
        if data.get("model") == "touches":
            exact = not data["noise"]["contact_median"]
            return nothing + ("; if the touches have errors, state them by --place-sd and --normal-sd" if exact else "")
        # of probed bodies only few slices are swept, whose contours say little
        if counts.get("probings") or not is_finite(contours := certified["contours"]["bound"]):
            return nothing
        within = length(contours, certified["unit"], up=True)
        return f"outer contours within {within} in the planes of the slices; between them {nothing}"
    if (data.get("rod") or {}).get("tapered"):
        return (
            "nothing, because the rod's radius changes along it, and no one radius grows the body to what its centre line "
            "touches"
        )
    if certified.get("missing"):
        return f"nothing: {certified['missing']}"
    unproven, words = counts.get("unproven_slices", 0), "nothing, because no contact bounds the body on some side of it"
    if unproven:
        words += f"; {unproven} slices without contact prove no end, because their sweeps miss places that it may reach"
    may_stand = certified.get("table") is None and "slices" not in data["settings"]  # those of a scan
    return words + ("; if it stands on a table, state the height by --table" if may_stand else "")


def _in_a_sentence(data: Mapping[str, Any]) -> str:
    """What a report comes to: how far the surface can be from the body, or how much of it is known."""
    certified, coverage = data["certificate"], data["coverage"]
    if not data["surface"]["method"]:
        return "contacts, and neither surface nor certificate"
    if data["warnings"]:
        return f"nothing certified: {contradicted(data.get('model'))}"
    # what is known is told of the surface between contacts and free space, and not of one by another method
    is_cut = "known" in coverage and data["surface"]["method"] == "cut"
    if is_cut and (data["counts"].get("probings") or data.get("model") == "touches"):
        off, found = data["counts"].get("off_surface"), "touches" if data.get("model") == "touches" else "contacts"
        of_all = f"{off} of {data['counts']['contacts']} {found}"
        missing = f"; {of_all} lie off this surface, which may lack parts of the body" if off else ""
        return touched(coverage, certified["unit"]) + missing
    if is_finite(certified["bound"]):
        body = of_scanned(data) or " of the body"
        if _refuted(data):
            most = length(certified["bound"], certified["unit"], up=True)
            return f"refuted: the true mesh is farther away than the {most} that touch certifies"
        return f"{_within(certified)}{body}, certified from touch{_with_confidence(certified)}"
    if is_cut:
        known, estimated, _ = _shares(coverage)
        found = f"{known} of the surface known, {estimated} estimated between slices"
        return f"{found}, {_unknown(coverage, certified['unit'])}"
    return "nothing certified: the summary says what is missing"


def _refuted(data: Mapping[str, Any]) -> bool:
    """Whether the true body is farther away than what is certified."""
    distances, bound = data["hausdorff"], data["certificate"]["bound"]
    return bool(distances) and is_finite(bound) and distances["two_sided"] > bound * (1 + ROUNDING)


def _within(certified: Mapping[str, Any]) -> str:
    return f"within {length(certified['bound'], certified['unit'], up=True)}"


def _with_confidence(certified: Mapping[str, Any]) -> str:
    return f" with {100 * certified['confidence']:g} % confidence" if certified["confidence"] < 1 else ""


def contradicted(model: str | None) -> str:
    return "the touches contradict each other" if model == "touches" else "the recording contradicts the model"


def _count(number: int, noun: str) -> str:
    return f"{number} {noun}" if number == 1 else f"{number} {noun}s"


def _distance(part: Mapping[str, Any], unit: str) -> str:
    return f"{length(part['two_sided'], unit)} ({share(part['relative'])} of the diagonal)"


def of_scanned(data: Mapping[str, Any], word: str = "of") -> str:
    """What a report's bounds are of, where that is not the mesh itself: `` of the convex hull of the mesh``; else empty."""
    return f" {word} the {HULL_OF_MESH}" if (data.get("mesh") or {}).get("scanned", "mesh") != "mesh" else ""


def touched(coverage: Mapping[str, Any], unit: str) -> str:
    """How much of the surface of a body was touched, and what remains, where and why."""
    known, estimated, _ = _shares(coverage)
    between = f", {estimated} estimated" if coverage["estimated"] else ""
    return f"{known} of the surface touched{between}, {_unknown(coverage, unit)}"


def _shares(coverage: Mapping[str, Any]) -> list[str]:
    """What is known of a surface, rounded down, estimated, and unknown, rounded up, in per cent which add up to 100."""
    known, told = (_at_least(part) for part in (coverage["known"], coverage["known"] + coverage["estimated"]))
    return [f"{percent:g} %" for percent in (known, told - known, 100 - told)]


def _at_least(part: float) -> float:
    """Tenths of a per cent, in per cent, never more than a part is."""
    return float(np.floor(round(1000 * part, 6)) / 10)


def _unknown(coverage: Mapping[str, Any], unit: str) -> str:
    """What is unknown of the surface, in words."""
    unknown = coverage["unknown"]
    if not unknown:
        return "nothing unknown"
    extent, center = unknown[0]["extent"], unknown[0]["center"]
    # far from the origin a place has the digits that tell it from others as far away as the patch is wide
    away = int(np.log10(max(map(abs, center)) / extent)) if extent and any(center) else 0
    (wide, *place), symbol = lengths([extent, *center], unit, digits=max(4, away + 2))
    left = _shares(coverage)[2]
    patches = "in one patch" if len(unknown) == 1 else f"in {len(unknown)} patches, the largest"
    where = f"{patches} {wide} {symbol} wide at ({', '.join(place)})"
    reason = unknown[0].get("reason")
    return f"{left} unknown, {where}" + (f": {reason}" if reason else "")


def key_figures(data: Mapping[str, Any]) -> tuple[tuple[str, str], ...]:
    """The summary of a report for pages and pictures, with the size of the body and the likeliest fault."""
    heading, rows = summary(data)
    figures = [("scan", heading)]
    if mesh := data["mesh"]:
        size, symbol = lengths(mesh["extents"], data["certificate"]["unit"])
        figures.append(("size", f"{' × '.join(size)} {symbol}"))
    figures += rows
    if data["warnings"]:
        figures.append(("warnings", "; ".join(warning["message"] for warning in data["warnings"])))
    if diagnosis := data.get("diagnosis"):
        figures.append(("diagnosis", diagnosis["message"]))
    return tuple(figures)
