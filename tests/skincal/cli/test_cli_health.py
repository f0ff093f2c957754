"""`solve` says whether the modules lie as the layout plans them, and how far neighbours lie apart."""

from __future__ import annotations

import re

import pytest

from skincal.model.scene import resource
from skincal.modules.distances import DistanceUse
from tests.approved import approved
from tests.skincal.sim_support import sample_with

LAYOUT = resource("sessions/sample") / "scene" / "scene.toml"


def test_a_known_distance_that_pokes_contradict_is_said(tmp_path, run, answered):
    told = "[[distances]]\nmodules = [17, 28]\nmm = {}\nsd_mm = 0.3\n\n[surface]"
    (plain,) = answered("solve", sample_with(tmp_path / "a", "scene.toml", ("[surface]", told.format(60))))["distances"]
    assert plain["modules"] == [17, 28]
    assert plain["told_mm"] == pytest.approx(60.0)
    assert plain["use"] == DistanceUse.OFF.value
    right = sample_with(tmp_path / "b", "scene.toml", ("[surface]", told.format(plain["found_mm"])))
    assert answered("solve", right)["distances"][0]["use"] == DistanceUse.USED.value
    assert approved("distances.used", used=1, count="1 known distance") in run("solve", right)[1]


def test_modules_that_lie_as_planned_are_left_alone(answered):
    said = answered("solve", resource("sessions/sample"))
    assert said["misfits"] == []
    assert said["distances"] == []
    ratios = {name: method["spacing_ratio"] for name, method in said["methods"].items()}
    assert ratios["modules"] == pytest.approx(1.0, abs=0.02)
    assert 0.9 < ratios["surface"] < 1.3 < ratios["free"]


def test_without_a_layout_nothing_is_said_of_modules(tmp_path, answered):
    layout = re.search(r"\[skin.anchor\].*?(?=\[surface\])", LAYOUT.read_text(encoding="utf-8"), re.DOTALL)[0]
    folder = sample_with(tmp_path, "scene.toml", ('modules = "modules.toml"\n', ""), (layout, ""))
    said = answered("solve", folder)
    assert said["misfits"] == []
    assert set(said["methods"]) == {"free", "surface"}
    assert [method["spacing_ratio"] for method in said["methods"].values()] == [None, None]
