"""The tool of a part draft: what the pictures choose is written, loads as that rig, and reads back."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from skincal.model.scene import load_scene, resource
from skincal.part.draft_preview import PartPreviewer
from skincal.part.draft_summary import State, can_start, summarize
from skincal.part.part_draft import IDENTITY_POSE, LandmarkDraft, PartDraft, open_draft, save_draft, save_tool, scene_text
from skincal.part.tool_draft import Rig, ToolDraft, changes_by_test, tool_problem

MESH = resource("scenes/icub-forearm/forearm.obj")
TURNED = ((0.0, -1.0, 0.0, 0.0), (1.0, 0.0, 0.0, 0.0), (0.0, 0.0, 1.0, 0.02), (0.0, 0.0, 0.0, 1.0))


def draft_of(rig: Rig, **tool) -> PartDraft:
    return PartDraft(mesh=MESH, name="arm", channels=9, rig=rig, tool=ToolDraft(**tool))


@pytest.mark.parametrize("rig", [Rig.ON_TOOL, Rig.NONE])
def test_a_rig_with_a_tool_is_saved_and_loads_as_that_rig(tmp_path, rig):
    form = {"rotation": "vector", "unit": "mm", "degrees": False}
    draft = draft_of(rig, **form, tip_mm=(1.0, -2.0, 130.5), tip_radius_mm=2.0, tip_sd_mm=0.4, flange=TURNED)
    draft = replace(draft, sensor_pose=IDENTITY_POSE, sign=1)
    saved = save_draft(draft, tmp_path / "arm/scene.toml")
    tool = load_scene(saved.source).tool
    assert tool.has_sensor is (rig is Rig.ON_TOOL)
    assert (tool.form.rotation.value, tool.form.degrees, tool.metres_per_unit) == ("vector", False, 1e-3)
    assert tool.tip.tolist() == [0.001, -0.002, 0.1305]
    assert (tool.tip_radius, tool.tip_sd) == pytest.approx((0.002, 0.0004))
    expected = np.array(TURNED) if rig is Rig.ON_TOOL else np.block([[np.eye(3), tool.tip[:, None]], [np.zeros((1, 3)), 1.0]])
    assert tool.tool_from_sensor.tolist() == expected.tolist()
    assert (saved.rig, saved.tool.tip_mm, saved.sensor_pose) == (rig, (1.0, -2.0, 130.5), None)
    assert save_draft(saved, saved.source) == saved


def test_back_to_a_sensor_below_the_part_nothing_of_the_tool_is_left(tmp_path):
    saved = save_draft(draft_of(Rig.ON_TOOL, rotation="xyzw", unit="m", flange=TURNED), tmp_path / "arm/scene.toml")
    back = save_draft(replace(saved, rig=Rig.BELOW, sensor_pose=IDENTITY_POSE), saved.source)
    assert "tool" not in back.text
    assert "flange" not in back.text
    assert back.sensor_pose == IDENTITY_POSE


def test_entries_that_the_page_does_not_know_stay_with_their_comments():
    draft = open_draft(resource("scenes/cobot-forearm/scene.toml"))
    assert draft.rig is Rig.ON_TOOL
    assert draft.tool.base_from_link is not None
    moved = replace(draft, tool=replace(draft.tool, tip_mm=(0.0, 0.0, 99.0), kept=draft.tool.kept))
    text = scene_text(moved, draft.source.parent)
    assert text == draft.text.replace("tip_mm = [1.0, -2.0, 130.0]", "tip_mm = [0, 0, 99]")
    without = scene_text(replace(draft, rig=Rig.NONE), draft.source.parent)
    assert "flange =" not in without
    assert 'sensor = "none"' in without
    assert "base_from_link" in without


def test_a_typed_pose_that_is_cleared_takes_its_error_with_it(tmp_path):
    saved = save_draft(
        draft_of(Rig.ON_TOOL, base_from_link=TURNED, kept=(("base_from_link_sd_mm", 3.0),)), tmp_path / "scene.toml"
    )
    assert "base_from_link_sd_mm = 3" in saved.text
    cleared = save_draft(replace(saved, tool=replace(saved.tool, base_from_link=None)), saved.source)
    assert "base_from_link" not in cleared.text


def test_a_tip_that_was_found_changes_nothing_else_in_a_file_that_differs(tmp_path):
    form = {"rotation": "vector", "unit": "mm", "degrees": False}
    before = ToolDraft(**form, tip_radius_mm=2.0, flange=TURNED)
    saved = save_draft(draft_of(Rig.ON_TOOL, **form, tip_radius_mm=3.0, tip_sd_mm=0.4), tmp_path / "scene.toml")
    for found, keys in (
        (replace(before, tip_mm=(1.0, 2.0, 3.0)), {"tip_mm"}),
        (replace(before, tip_mm=(1.0, 2.0, 4.0), rotation="rpy", degrees=True), {"tip_mm", "rotation", "degrees"}),
    ):
        changed = changes_by_test(before, found)
        assert set(changed) == keys
        save_tool(saved.source, changed)
        assert open_draft(saved.source).tool == replace(saved.tool, **changed)


def test_a_missing_tip_or_form_is_said_before_a_session_starts():
    previewer = PartPreviewer()
    seen = previewer.preview(draft_of(Rig.NONE), {})
    assert "fixed-point test" in seen.problems["sensor"]
    assert not can_start(seen)
    seen = previewer.preview(draft_of(Rig.ON_TOOL), {})
    assert can_start(seen), "the pokes show tip and pose"
    lines = {line.text: line.state for line in summarize(seen)}
    assert any("tip is not given" in text and state is State.OPTIONAL for text, state in lines.items())
    assert any("0 landmarks" in text and "pose" in text for text in lines)
    marks = tuple(LandmarkDraft(f"m{n}", (0.01 * n, 0.0, 0.0)) for n in range(3))
    lines = [line.text for line in summarize(previewer.preview(replace(draft_of(Rig.ON_TOOL), landmarks=marks), {}))]
    assert "3 landmarks" in lines
    assert tool_problem(Rig.ON_TOOL, ToolDraft(), has_arm=True)
