"""The former module names, kept for one version, hand on the objects of the present ones."""

import importlib

import pytest


@pytest.mark.parametrize(
    ("former", "name", "module", "present"),
    [
        ("bracket", "Bracket", "surfaces.bounds", "Enclosure"),
        ("bracket", "bracket", "surfaces.bounds", "enclosure"),
        ("bracket", "certificate", "surfaces.certificates", "certificate"),
        ("bracket", "Gap", "surfaces.slabs", "Gap"),
        ("layers", "Layer", "reconstruction.slices", "Slice"),
        ("layers", "Layers", "reconstruction.slices", "SliceStack"),
        ("layers", "stacks", "reconstruction.slices", "stacks"),
        ("support", "SupportFit", "geometry.support", "SupportFit"),
        ("support", "fit_support", "geometry.support", "fit_support"),
    ],
)
def test_a_former_name_is_the_present_object(former, name, module, present):
    former_module, present_module = (importlib.import_module(f"scan3d.{path}") for path in (former, module))
    assert getattr(former_module, name) is getattr(present_module, present)


@pytest.mark.parametrize("former", ["bracket", "layers", "support"])
def test_every_former_name_is_tested(former):
    module = importlib.import_module(f"scan3d.{former}")
    counts = {"bracket": 4, "layers": 3, "support": 2}
    assert len(module.__all__) == counts[former]
