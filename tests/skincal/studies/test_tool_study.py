"""The study of a tool on a still part, on few pokes."""

import numpy as np
import pytest

from skincal.mesh.surface import make_surface
from skincal.rig import part_pose, part_pose_starts
from skincal.session.session import Session
from skincal.simulation.example_parts import forearm
from skincal.studies.tool_simulator import NO_LANDMARK, TOOL_RIGS, simulate_tool_session
from skincal.studies.tool_study import (
    BASE_ALONE,
    LARGE_DRAWING,
    POSE_FOUND,
    POSE_GIVEN,
    THIS_STUDY,
    WIDE_MESH,
    WRONG_LANDMARK,
    Task,
    ToolCase,
    ToolSizes,
    contacts_of,
    run_session,
    scene_of,
    touch_landmarks,
)  # fmt: skip
from tests.skincal.studies.studies_support import small


def by_case(result):
    return {ToolCase(row["rig"], row["known"], row["landmarks"], row["mesh"]): row["methods"] for row in result["tool"]}


def test_a_rig_without_errors_is_calibrated_within_its_prediction():
    result, said = small("tool")
    ideal = by_case(result)[ToolCase("ideal", POSE_FOUND, 6, has_mesh=True)]
    assert ideal["modules"]["mean_mm"][1] < 0.6
    assert ideal["modules"]["inside"][1] > 0.9
    assert any("ideal, part's pose found" in line for line in said)
    assert any("modules:" in line for line in THIS_STUDY.summary(result))


def test_landmarks_give_the_parts_pose_and_nothing_leaves_positions_in_the_base():
    rows = {(row["rig"], row["known"]): row for row in small("tool")[0]["tool"]}
    found, base = rows["good_wrist", POSE_FOUND], rows["good_wrist", BASE_ALONE]
    assert found["placed"] == [1.0, 1.0]
    assert found["methods"]["modules"]["mean_mm"][1] < 0.8
    assert base["placed"] == [0.0, 0.0]
    # Nothing but the tip's places and the force axes: a centimetre, with the errors of the robot's base.
    assert base["methods"]["free"]["mean_mm"][1] < 10.0


def test_the_goals_are_limits_of_the_rig_with_all_imperfections():
    bars = small("tool")[0]["bars"]
    assert {name: bars[f"tool_wrist_{name}_mean_mm"]["limit"] for name in ("modules", "surface", "free")} == {
        "modules": 0.8, "surface": 1.2, "free": 1.6,
    }  # fmt: skip
    assert bars["tool_wrist_modules_inside"]["limit"] == 0.9


def test_contacts_carry_the_sensors_pose_into_the_part():
    part = forearm()
    poked = simulate_tool_session(part.scene, part.surface.vertices, part.surface.triangles, TOOL_RIGS["ideal"], 3, (2, 30))
    contacts = contacts_of(poked, scene_of(ToolCase("ideal", POSE_GIVEN, 2, has_mesh=True), poked))
    true = poked.contact[poked.landmark == NO_LANDMARK]
    for contact, place in zip(contacts, true, strict=True):
        turn, origin = contact.link_from_sensor[:3, :3], contact.link_from_sensor[:3, 3]
        force = turn @ contact.force
        np.testing.assert_allclose(turn @ contact.moment, np.cross(place - origin, force), atol=1e-12)


def test_a_given_tip_places_the_pokes_of_a_sensor_with_cross_talk():
    methods = run_session(Task(ToolCase("wrist", POSE_FOUND, 6, has_mesh=True), 1, ToolSizes(counts=(168,))))[168]["methods"]
    assert methods["modules"]["mean"] < 0.8
    # 28.8 by the force axes, and 1.7 where the skin's face is taken for its taxels.
    assert methods["free"]["mean"] < 1.5
    # The noise of the wrench does not move them, so it is not in their predicted error: with it that is 0.88 mm.
    assert 0.4 < methods["modules"]["predicted"] < 0.75
    assert methods["modules"]["inside"] > 0.9


@pytest.mark.parametrize("rig", ["none", "good_wrist", "wrist"])
def test_the_tip_touches_the_skin_above_the_taxels_and_the_predicted_errors_contain_that(rig):
    methods = run_session(Task(ToolCase(rig, POSE_FOUND, 6, has_mesh=True), 1, ToolSizes(counts=(84,))))[84]["methods"]
    assert {name: each["inside"] for name, each in methods.items() if each["inside"] < 0.9} == {}


@pytest.mark.parametrize("rig", ["none", "wrist"])
def test_a_right_session_is_believed_and_one_with_a_wrong_landmark_is_not(rig):
    sizes = ToolSizes(counts=(168,))
    right = run_session(Task(ToolCase(rig, POSE_FOUND, 6, has_mesh=True), 1, sizes))[168]
    wrong = run_session(Task(ToolCase(rig, POSE_FOUND, 6, True, WRONG_LANDMARK), 1, sizes))[168]
    assert set(right["believed"].values()) == {True}
    assert not right["scale_named"]
    assert set(wrong["believed"].values()) == {False}


@pytest.mark.parametrize("mistake", [LARGE_DRAWING, WIDE_MESH])
def test_a_drawing_of_another_scale_is_named_and_its_error_predicted(mistake):
    wrong = run_session(Task(ToolCase("none", POSE_FOUND, 6, True, mistake), 2, ToolSizes(counts=(168,))))[168]
    assert wrong["scale_named"]
    assert set(wrong["believed"].values()) == {False}
    modules = wrong["methods"]["modules"]
    assert modules["mean"] > 0.9, "the mistake costs more than all other errors"
    assert modules["inside"] > 0.8


@pytest.mark.parametrize(("landmarks", "most"), [(6, 20), (0, 50)])
def test_a_parts_pose_takes_few_steps_so_that_a_snapshot_does_not_stall(monkeypatch, landmarks, most):
    """Each step costs a millisecond: with landmarks one start, and steps that go round at the edges of triangles end."""
    part, calls = forearm(), []
    poked = simulate_tool_session(
        part.scene, part.surface.vertices, part.surface.triangles, TOOL_RIGS["none"], 1, (landmarks, 168)
    )
    scene = scene_of(ToolCase("none", POSE_FOUND, landmarks, has_mesh=True), poked)
    session = Session(scene, make_surface(poked.vertices, part.surface.triangles))
    touch_landmarks(session, poked)
    for contact in contacts_of(poked, scene):
        session.add(contact)
    for room in (part_pose, part_pose_starts):
        made = room.pose_rows
        monkeypatch.setattr(room, "pose_rows", lambda *a, made=made, **k: calls.append(1) or made(*a, **k))
    assert session.snapshot().is_placed
    assert 5 < len(calls) <= most


@pytest.mark.parametrize(("known", "mesh"), [(POSE_GIVEN, True), (BASE_ALONE, False)])
def test_without_a_fit_of_the_parts_pose_the_predicted_errors_contain_tip_and_robot(known, mesh):
    methods = run_session(Task(ToolCase("wrist", known, 0, has_mesh=mesh), 2, ToolSizes(counts=(84,))))[84]["methods"]
    # 2 to 3 mm, of which the pokes' own noise predicts 1 mm for modules.
    assert {name: each["inside"] for name, each in methods.items() if each["inside"] < 0.9} == {}
    assert all(each["predicted"] < 1.5 * each["true_along"] for each in methods.values())
