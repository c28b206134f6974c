"""What touches determine, in sentences."""

from __future__ import annotations

from collections.abc import Iterable

from scan3d.laboratory.calibration_reference import Reference

MORE_SWEEPS = (
    "sweep it in more directions of the rod, with the clamp turned about the rod's axis, and bend the rod more"
)
PLANE = (
    "The sweeps lie in one plane, which is taken to pass through the sphere's centre; sweep planes at several heights."
)
# What follows from systematic deviations, and from large ones.
_FITS_NOT = {
    False: "what such deviations may have shifted beyond the limit is not called well determined",
    True: (
        "the model does not fit these touches, no quantity of the rig is called well determined, and the uncertainties are "
        "those of deviations that are alike in all rows"
    ),
}
# What a group of quantities is called, by the beginning of their names.
_TITLES = {
    "bending_stiffness": "the bending stiffness",
    "length": "the free length",
    "clamp_turn": "the clamp's turn",
    "clamp_y": "the clamp's offset along the rod",
    "clamp": "the clamp's offset across the rod",
    "sensor_turn": "the sensor's turn",
    "sensor": "the sensor's place",
    "sphere": "the sphere's place",
    "plane": "the plane's place",
    "mesh": "the body's place and turn",
    "tare": "the tare",
    "drift": "the drift",
}
_TIP = "tip contacts: sweeps whose clamp is farther from the {noun}, so that the rod leaves it over its tip"
# Which touches determine a group of quantities, whatever the reference, and for each of them.
_TOUCHES = {
    "clamp": "sweeps with the clamp turned about the rod's axis by 90 degrees and more",
    "sensor_turn": "sweeps that bend the rod more, and a {noun} with more friction",
    "sensor": "sweeps that bend the rod more, and to several sides of the clamp",
    "clamp_turn": "sweeps that touch the {noun} near the clamp and near the tip, with the clamp turned about the rod's axis",
    "tare": "more rows in the air, before and after each touch",
    "drift": "more rows in the air at the beginning and the end of the recording",
}
_TOUCHES_OF = {
    "sphere": {
        "bending_stiffness": "sweeps that bend the rod more, past the middle of the sphere",
        "length": _TIP,
        "clamp_y": "sweeps with the rod in other directions, such as from the opposite side",
        "sphere": "sweeps with the rod in more directions",
    },
    "plane": {
        "bending_stiffness": "sweeps that press the rod on until it lies along the plane",
        "length": "tip contacts: sweeps that press the rod less, so that its tip slides on the plane",
        "clamp_y": "sweeps with the rod at several inclinations to the plane",
        "plane": "sweeps with the rod in more directions, and all over the plane",
    },
    "mesh": {
        "bending_stiffness": "sweeps that bend the rod more, over edges of the body",
        "length": _TIP,
        "clamp_y": "sweeps with the rod in other directions, such as from the opposite side",
        "mesh": "sweeps over more of its sides. A body of revolution has no turn about its axis, and no other quantity depends "
        "on it",
    },
}
_NOUNS = {"sphere": "sphere", "plane": "plane", "mesh": "body"}


def sentences(poor: Iterable[tuple[str, str]], fixed: Iterable[str], kind: str) -> tuple[str, ...]:
    """One sentence for each group of quantities that are poorly determined, with their uncertainties, or not determined.

    `kind` is that of the reference.
    """
    result = []
    noun, needed = _NOUNS[kind], _TOUCHES | _TOUCHES_OF[kind]
    fixed_groups: dict[str, list[str]] = {}
    poor_groups: dict[str, list[str]] = {}
    for name in fixed:
        fixed_groups.setdefault(_group(name), []).append(name)
    for name, uncertainty in poor:
        poor_groups.setdefault(_group(name), []).append(f"{name} to {uncertainty}")
    if "sensor_turn" in fixed_groups:
        names = fixed_groups.pop("sensor_turn") + fixed_groups.pop("sensor", [])
        result.append(
            f"These touches do not determine the sensor's turn about the rod: {', '.join(names)} are a first estimate, which "
            f"may be wrong by some degrees. It needs a {noun} with more friction, because without friction contacts stay on "
            f"the {noun} when they turn about the rod; and sweeps that bend the rod more."
        )
    for group, names in fixed_groups.items():
        title, touches = _TITLES[group], needed[group].format(noun=noun)
        if group == kind:
            result.append(
                f"These touches do not determine {title}: {', '.join(names)} are estimates. It needs {touches}."
            )
            continue
        stays = "stays at its nominal value" if len(names) == 1 else "stay at their nominal values"
        result.append(f"These touches do not determine {title}: {', '.join(names)} {stays}. It needs {touches}.")
    for group, names in poor_groups.items():
        title, touches = _TITLES[group], needed[group].format(noun=noun)
        result.append(f"These touches determine {title} poorly ({', '.join(names)}). It needs {touches}.")
    return tuple(result)


def _group(name: str) -> str:
    return max((group for group in _TITLES if name.startswith(group)), key=len)


def rough_poses(deviation_mm: float, reference: Reference) -> str:
    """The sentence for an estimated noise of the poses that is larger than that of robots."""
    return (
        f"The contacts deviate from the {reference.noun} as if the poses scattered by {deviation_mm:.2g} mm, which is more "
        f"than those of a robot do: check {reference.sizes}, and that the {reference.noun} did not move."
    )


def premises(
    contacts: tuple[float, float], air: tuple[float, float], consistency: tuple[float, float], reference: Reference
) -> tuple[str, ...]:
    """One sentence for each test of the premises that fails: mean squares in variances, each with its largest value."""
    result = []
    if air[0] > air[1]:
        result.append(
            f"In the air the reactions scatter by {air[0] ** 0.5:.2f} times the stated noise: the sensor drifts otherwise than "
            "the tare assumes, or the noise is larger than stated; what is found in the air was used instead."
        )
    if consistency[0] > consistency[1]:
        result.append(
            f"In contact the moments about the rod and along the force scatter by {consistency[0] ** 0.5:.2f} times what the "
            "noise explains: a second contact, friction across a thick rod, a sensor whose channels mix, or noise larger "
            "than stated."
        )
    if contacts[0] > contacts[1]:
        result.append(
            f"The contacts deviate from the {reference.noun} by {contacts[0] ** 0.5:.2f} times what the noise explains: check "
            f"{reference.sizes}, the noise of the poses, and that the {reference.noun} did not move."
        )
    return tuple(result)


def alike_in_contact(
    size_mm: float, rows: float, cause: str, diameter_mm: float, spoiled: bool, reference: Reference
) -> str:
    """The sentence on contacts that deviate from the reference systematically, and the likeliest cause."""
    causes = {
        "diameter": f"The likeliest cause is the diameter: one of {diameter_mm:.4g} mm would fit better.",
        "planar": (
            "The likeliest cause is a log whose forces lie in one plane, of a planar model or of a sensor with three channels; "
            f"a rod that slides sideways over a {reference.noun} has none such."
        ),
        "shape": (
            f"The likeliest causes are {reference.unlike}, a second contact, a rod that "
            f"sticks, and poses that deviate from the clamp's path{reference.excluded}."
        ),
    }
    return (
        f"The contacts deviate from the {reference.noun}, or the rod from its tangent, as by {size_mm:.2g} mm{_rows(rows)}, "
        f"which noise does not explain: {_FITS_NOT[spoiled]}. {causes[cause]}"
    )


def alike_in_wrench(rows: float, spoiled: bool) -> str:
    """The sentence on moments in contact that contradict a single force systematically."""
    return (
        f"In contact the moments about the rod and along the force deviate from zero{_rows(rows)}, which "
        f"noise does not explain: {_FITS_NOT[spoiled]}. The likeliest causes are friction across a thick rod, a second "
        "contact, a sensor whose channels mix, and a tare that changes within a sweep."
    )


def _rows(rows: float) -> str:
    return f", alike over {rows:.0f} rows" if rows >= 2 else ", alike in neighbouring rows" if rows else ""
