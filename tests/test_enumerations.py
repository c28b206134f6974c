"""The numbers of enumerations, which are stored in files and arrays."""

import pytest

import planar
from scan3d.bounds.cells import Gap
from scan3d.cloud import NormalSource

MEMBERS = {
    planar.Phase: ["NONE", "TIP", "TANGENTIAL"],
    planar.Status: [
        "OK",
        "NO_FORCE",
        "WRONG_SIDE",
        "NO_ROD",
        "INFLECTION",
        "BEYOND_TIP",
        "UNDEFINED",
        "SECOND_CONTACT",
    ],
    planar.EventKind: ["TOUCH_DOWN", "TO_TANGENTIAL", "TO_TIP", "SNAP", "SNAP_OFF"],
    planar.SweepStatus: ["FREE", "ONE_CONTACT", "SEVERAL_CONTACTS", "UNRESOLVED"],
    planar.NormalSource: ["NONE", "TANGENTIAL", "FRICTION"],
    NormalSource: ["UNKNOWN", "SLICES", "FIT", "FRICTION", "SLIP", "PATH", "FORCE", "HULL"],
    Gap: ["SLICES", "CONTACTS", "CAPS"],
}


@pytest.mark.parametrize(
    "enumeration", MEMBERS, ids=lambda enumeration: f"{enumeration.__module__}.{enumeration.__name__}"
)
def test_members_are_numbered_from_0(enumeration):
    assert {name: int(member) for name, member in enumeration.__members__.items()} == {
        name: number for number, name in enumerate(MEMBERS[enumeration])
    }
