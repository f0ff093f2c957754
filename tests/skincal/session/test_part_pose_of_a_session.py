"""A scene with `[tool]` and without the part's pose: pokes show it, and estimates change from the base to the part's frame."""

import json
from dataclasses import replace

import numpy as np
import pytest

from skincal.files.export import calibration_file, json_text
from skincal.files.formats import ExportFormat
from skincal.mesh.load import load_surface
from skincal.model.actions import AtLandmark, Exclude, Undo
from skincal.model.errors import InputError
from skincal.rig.part_pose import PartPoseState
from skincal.session.session import Session
from skincal.session.tool_sentences import session_tool_sentences
from skincal.taxels.result import Cause, Method, State
from skincal.words.part_words import ADD_LANDMARK, part_pose_sentence, tool_rig_sentences
from tests.skincal.session.test_tool_rig import (
    BASE_FROM_PART,
    TAXELS,
    TIP,
    TOOL_FROM_SENSOR,
    calibrate,
    chunks,
    outcomes_of,
    scene_of,
)

CORNERS = (0, 2, 6, 8)
TIP_LINE = f"tip_mm = {(TIP * 1e3).tolist()}\n"
MARKS = "".join(f'[[landmarks]]\nname = "{at}"\nplace = {TAXELS[at].tolist()}\n' for at in CORNERS)


def without_pose(text, more=TIP_LINE):
    kept = "\n".join(line for line in text.splitlines() if not line.startswith("base_from_link"))
    return kept.replace("[surface]", f"{more}[surface]") + "\n" + MARKS


@pytest.fixture(scope="module")
def outcomes(tmp_path_factory):
    """Pokes as the rig reports them, in the base."""
    return tuple(outcomes_of(calibrate(scene_of(tmp_path_factory.mktemp("tool"), change=without_pose), chunks(3, 1))))


def session_of(folder, outcomes, change=without_pose):
    scene = scene_of(folder, change=change)
    session = Session(scene, load_surface(scene.surface)[0])
    for outcome in outcomes:
        session.add(outcome)
    return session


def mark_corners(session, outcomes):
    for row in CORNERS:
        session.act(AtLandmark(outcomes[row].poke, str(row)))


def in_base(points):
    return points @ BASE_FROM_PART[:3, :3].T + BASE_FROM_PART[:3, 3]


def positions_of(snapshot, method):
    return np.array([estimate.position for estimate in snapshot.estimates[method]])


def test_estimates_are_in_the_base_until_landmarks_show_the_parts_pose(tmp_path, outcomes):
    session = session_of(tmp_path, outcomes)
    before = session.snapshot()
    assert before.part_pose.state is PartPoseState.OPEN
    assert not before.is_placed
    np.testing.assert_allclose(positions_of(before, Method.FREE), in_base(TAXELS), atol=0.004)
    assert {each.reason.cause for each in before.estimates[Method.SURFACE]} == {Cause.PART_UNPLACED}
    assert {each.state for each in before.on_part.estimates[Method.FREE]} == {State.BLIND}
    mark_corners(session, outcomes)
    after = session.snapshot()
    assert after.part_pose.state is PartPoseState.KNOWN
    for method in (Method.FREE, Method.SURFACE):
        off = positions_of(after, method) - TAXELS
        assert np.linalg.norm(off, axis=1).mean() < 0.0012
        squares = [x @ np.linalg.pinv(e.covariance) @ x for x, e in zip(off, after.estimates[method], strict=True)]
        assert np.median(squares) < 7.8
    assert after.on_part is after


def test_the_parts_pose_is_an_error_that_all_taxels_share(tmp_path, outcomes):
    session = session_of(tmp_path, outcomes)
    mark_corners(session, outcomes)
    snapshot = session.snapshot()
    for estimate in snapshot.estimates[Method.FREE]:
        own = estimate.covariance - estimate.moved @ estimate.moved.T
        assert np.linalg.eigvalsh(own)[0] > 0.0
        at_centre = snapshot.part_pose.covariance[3:, 3:]
        assert np.trace(estimate.moved @ estimate.moved.T) > 0.5 * np.trace(at_centre)


def test_an_excluded_landmark_poke_takes_the_pose_back_and_undo_restores_it_to_the_last_bit(tmp_path, outcomes):
    session = session_of(tmp_path, outcomes)
    mark_corners(session, outcomes)
    known = session.snapshot()
    for row in (0, 2, 6):
        session.act(Exclude(outcomes[row].poke))
    assert not session.snapshot().is_placed
    for _ in range(3):
        session.act(Undo())
    again = session.snapshot()
    for method in known.estimates:
        assert positions_of(again, method).tobytes() == positions_of(known, method).tobytes()


def test_the_order_of_questions_changes_nothing(tmp_path, outcomes):
    """A replay asks for snapshots at other moments than the window did."""
    one, other = (session_of(tmp_path, ()) for _ in range(2))
    for outcome in outcomes:
        one.add(outcome)
        one.snapshot()
        other.add(outcome)
    for session in (one, other):
        mark_corners(session, outcomes)
    for method in (Method.FREE, Method.SURFACE):
        assert positions_of(one.snapshot(), method).tobytes() == positions_of(other.snapshot(), method).tobytes()


def exported(session):
    return json.loads(json_text(session.calibration()))


def test_files_name_the_base_as_their_frame_until_the_pose_is_known(tmp_path, outcomes):
    session = session_of(tmp_path, outcomes)
    document = exported(session)
    assert document["frame"] == "base"
    assert document["part_pose"]["state"] == "open"
    mark_corners(session, outcomes)
    document = exported(session)
    assert document["frame"] == "plate"
    np.testing.assert_allclose(document["part_pose"]["base_from_link"], BASE_FROM_PART, atol=0.04)


def test_the_sentence_names_the_open_directions_and_the_landmark_that_closes_them(tmp_path, outcomes):
    said = part_pose_sentence(session_of(tmp_path, outcomes).snapshot().part_pose)
    assert said.startswith("Part: its pose in the base is not known yet, so positions are in the base. The part may")
    assert said.endswith("touch one landmark.")


def test_a_direction_that_touched_landmarks_leave_open_needs_a_push_from_another_side(tmp_path, outcomes):
    """The axes of pushes onto one face of the part measure nothing along them."""
    pose = session_of(tmp_path, outcomes).snapshot().part_pose
    said = part_pose_sentence(replace(pose, landmarks=4, landmark_places=4))
    assert said.endswith("touch one more landmark, from another side.")


@pytest.mark.parametrize("has_landmarks", [True, False])
def test_a_scene_without_landmarks_is_told_to_add_one(tmp_path, outcomes, has_landmarks):
    session = session_of(tmp_path, outcomes, lambda text: without_pose(text).replace("" if has_landmarks else MARKS, ""))
    said = session_tool_sentences(session.snapshot(), session.scene)
    assert any(each.endswith("touch one landmark.") for each in said)
    assert (ADD_LANDMARK in said) != has_landmarks


def test_a_typed_pose_that_the_touches_contradict_is_named(tmp_path, outcomes):
    shift = np.eye(4)
    shift[:3, 3] = [0.012, 0.0, 0.0]

    def typed(pose):
        line = f"base_from_link = {np.round(pose, 12).tolist()}\n"
        return lambda text: without_pose(text, TIP_LINE + line)

    for pose, says in ((BASE_FROM_PART, False), (BASE_FROM_PART @ shift, True)):
        placed = []
        for outcome in outcomes:
            carried = np.linalg.inv(pose) @ outcome.link_from_sensor
            placed.append(replace_pose(outcome, carried))
        session = session_of(tmp_path, placed, typed(pose))
        mark_corners(session, placed)
        snapshot = session.snapshot()
        assert snapshot.part_pose is None
        assert (snapshot.typed_pose_error is not None) == says
        if says:
            (said,) = [each for each in sentences(snapshot) if "base_from_link" in each]
            assert "moved by (\N{MINUS SIGN}12" in said or "moved by (\N{MINUS SIGN}11" in said


@pytest.mark.parametrize("is_marked", [False, True])
def test_the_error_of_a_typed_pose_is_in_the_predicted_errors(tmp_path, outcomes, is_marked):
    wrong = BASE_FROM_PART.copy()
    wrong[:3, 3] += BASE_FROM_PART[:3, :3] @ [0.0025, 0.0, 0.0]
    squares = []
    for sd in (2.0, 0.0):
        line = f"base_from_link = {np.round(wrong, 12).tolist()}\nbase_from_link_sd_mm = {sd}\n"
        placed = [replace_pose(outcome, np.linalg.inv(wrong) @ outcome.link_from_sensor) for outcome in outcomes]
        session = session_of(tmp_path, placed, lambda text, line=line: without_pose(text, TIP_LINE + line))
        if is_marked:
            mark_corners(session, placed)
        snapshot = session.snapshot()
        assert snapshot.typed_pose_error is None, "a contradiction of 2.5 mm is not named"
        off = (positions_of(snapshot, Method.FREE) - TAXELS)[:, 0].mean()
        assert off == pytest.approx(-0.0025, abs=0.0008)
        shared = np.mean([each.moved for each in snapshot.estimates[Method.FREE]], axis=0)[0]
        squares.append(off**2 / (shared @ shared))
    assert squares[0] < 3.84 < squares[1] or is_marked
    assert squares[0] < 3.84


def test_the_error_of_a_pose_that_is_not_typed_is_refused(tmp_path):
    with pytest.raises(InputError, match="base_from_link_sd_mm is the error of base_from_link, and that is not given"):
        scene_of(tmp_path, change=lambda text: without_pose(text, TIP_LINE + "base_from_link_sd_mm = 1.0\n"))


def replace_pose(outcome, link_from_sensor):
    tip = (link_from_sensor @ np.linalg.inv(TOOL_FROM_SENSOR))[:3] @ np.append(TIP, 1.0)
    return replace(outcome, link_from_sensor=link_from_sensor, tip=tip)


def sentences(snapshot):
    return tool_rig_sentences(snapshot.tip_frame, snapshot.part_pose, snapshot.typed_pose_error, snapshot.at_landmarks)


def test_every_file_says_that_the_scenes_tip_is_not_used(tmp_path, outcomes):
    wrong = f"tip_mm = {((TIP + 0.03) * 1e3).tolist()}\n"
    session = session_of(tmp_path, outcomes, lambda text: without_pose(text, wrong))
    mark_corners(session, outcomes)
    calibration = session.calibration()
    tip, part, *_ = calibration.tool
    assert "from tip_mm of the scene. The tip is not used" in tip
    assert part.startswith("Part: ")
    for format_ in (ExportFormat.ICUB, ExportFormat.PLY, ExportFormat.URDF, ExportFormat.SDF, ExportFormat.MJCF):
        content, said = calibration_file(calibration, format_, Method.FREE)
        assert {tip, part} <= set(said), format_
        assert tip.removesuffix(".") in content.decode(), format_
    content, said = calibration_file(calibration, ExportFormat.JSON, Method.FREE)
    assert json.loads(content)["tool"] == list(calibration.tool)
