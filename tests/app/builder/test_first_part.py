"""The tutorial `docs/first-part.md` in the real window: from the public iCub's URDF to a calibration file, in simulation."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from skincal.files.reference import find_truth, read_reference
from skincal.model.scene import load_scene
from tests.app.whole_window import OPEN_MS, POKE_MS
from tools.first_part import FRAME, LANDMARK_CLICKS, POKE_COUNT, SENSOR, find_icub, walk_tutorial

TUTORIAL = Path(__file__).resolve().parents[3] / "docs" / "first-part.md"


@pytest.mark.timeout(600)
def test_the_tutorial_leads_from_a_urdf_to_a_calibration_file(bench, tmp_path):
    pytest.importorskip("icub_models")
    file, names = tmp_path / "forearm.json", []
    steps = walk_tutorial(bench.window, find_icub(), lambda what: bench.until(what, 2 * POKE_MS + OPEN_MS), file)
    for name in steps:
        names.append(name)
        if name == "check":
            assert not any(line.startswith("\N{BALLOT X}") for line in bench.window.builder.check.summary())
        if name == "poke":
            part = bench.window.session_view.workspace.part
            truth = find_truth(bench.controller.folder, part.scene.link, part.channels.tolist())
    scene = load_scene(part.scene.path)
    assert (scene.link, scene.robot.sensor, scene.robot.columns) == (FRAME, SENSOR, ("l_elbow", "l_wrist_prosup"))
    assert [mark.name for mark in scene.landmarks] == list(LANDMARK_CLICKS)
    assert len(bench.accepted()) > POKE_COUNT // 2
    found = read_reference(file)
    errors = [np.linalg.norm(place - truth.places[channel]) for channel, place in found.items()]
    assert len(errors) > 24
    assert np.median(errors) < 0.015
    text = TUTORIAL.read_text(encoding="utf-8")
    for picture in names:
        assert f"pictures/part-{picture}.png" in text
        assert (TUTORIAL.parent / f"pictures/part-{picture}.png").is_file()
