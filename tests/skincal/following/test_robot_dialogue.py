"""What a robot is asked, and what its answers mean: numbers, verdicts, what crosses, faults, and lies."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from skincal.contacts.outcome import Contact, Reason, Rejection
from skincal.following.guided_session import GuidedSession
from skincal.following.robot_dialogue import POKE_DETECTION_TIMEOUT_S, RobotDialogue
from skincal.guide.guidance import Guidance, GuidePhase, Target
from skincal.model.scene import load_scene, resource
from skincal.part.part import load_part
from skincal.rig.part_pose import NO_PART_POSE, PartPoseState
from skincal.robot.target_lines import Answer, AnswerKind, GuidedByHand, Held, Judged, NoTarget, PartPlace, PokeTarget
from skincal.robot.target_server import RobotChange
from skincal.session.decisions import Decisions
from skincal.session.snapshot import PokeRecord
from skincal.taxels.result import Method
from skincal.words.robot_words import silent_robot_sentence
from tests.approved import approved

REACHED, SKIP, FAULT = AnswerKind
DOWN = np.array([0.0, 0.0, -1.0])


def wants(channel, **changes):
    """The guide asks for a taxel; `channel` None for enough."""
    target = None if channel is None else Target(channel, np.array([0.01 * channel, 0.0, 0.0]), -DOWN, DOWN, 0.0, 1.0, 1.0)
    phase = GuidePhase.ENOUGH if channel is None else GuidePhase.SWEEP
    none, empty = np.zeros(0), np.zeros(0, dtype=np.int64)
    found = Guidance(Method.FREE, phase, target, empty, none.reshape(0, 3), none, none, empty, (), {}, 0.5, 3, None)
    return replace(found, **changes)


def poke(number, start_s, reason=None, *, final=True):
    """The record of one poke, held for 0.3 s."""
    times = number, start_s, start_s + 0.3
    if reason is not None:
        outcome = Rejection(*times, reason, 2.5, 4.0, "N", np.zeros(0, dtype=np.int64), final)
    else:
        empty = np.zeros(0)
        outcome = Contact(*times, DOWN, DOWN, empty.astype(np.int64), empty, np.eye(4), "", 0.0, final)
    return PokeRecord(outcome, False)


class Course:
    """A session as the dialogue sees it, at times that the test gives."""

    def __init__(self, *pokes):
        scene = load_scene(resource("scenes/flat-patch/scene.toml"))
        self.robot, self.thresholds = RobotDialogue(scene), scene.contacts
        self.pokes, self.missed, self.landmarks = list(pokes), {}, {}
        self.part = None

    def at(self, now_s, guidance, *, measuring=True, held=False):
        decisions = Decisions(thresholds=self.thresholds, missed_landmarks=self.missed)
        snapshot = SimpleNamespace(pokes=tuple(self.pokes), at_landmarks=self.landmarks, decisions=decisions)
        snapshot.part_pose = self.part
        return self.robot.lines_to_send(guidance, snapshot, "", now_s, measuring=measuring, held=held)

    def asked(self, now_s, guidance):
        """The one target that is said now."""
        (line,) = self.at(now_s, guidance)
        assert isinstance(line, PokeTarget)
        return line


def test_a_target_says_what_the_guide_shows_once_and_all_that_a_robot_needs():
    course = Course()
    line = course.asked(1.0, wants(3))
    assert (line.number, line.channel, line.known, line.frame, line.pose) == (1, 3, False, "patch", "")
    assert line.place.tolist() == [0.03, 0.0, 0.0]
    assert line.push.tolist() == DOWN.tolist()
    assert (line.force, line.hold) == (9.5, 0.6), "the middle of the force window, and twice the still window"
    assert course.at(1.1, wants(3)) == []
    assert course.asked(1.2, wants(4)).number == 2, "what changed takes its place"
    course.thresholds = replace(course.thresholds, force_min=4.0, force_max=6.0, still_s=0.5)
    line = course.asked(1.3, wants(4))
    assert (line.number, line.force, line.hold) == (3, 5.0, 1.0)


def test_the_pose_of_the_part_is_sent_once_it_is_known_and_again_to_another_robot():
    course = Course()
    course.part = NO_PART_POSE
    course.asked(1.0, wants(3))
    pose = np.eye(4)
    pose[:3, 3] = 0.4, 0.1, 0.2
    course.part = replace(NO_PART_POSE, state=PartPoseState.KNOWN, link_from_base=np.linalg.inv(pose))
    place, line = course.at(1.1, wants(4))
    assert isinstance(place, PartPlace)
    assert (place.frame, line.number) == ("patch", 2)
    np.testing.assert_allclose(place.base_from_link, pose, atol=1e-12)
    assert course.at(1.2, wants(4)) == []
    course.robot.robot_connected()
    (again,) = course.at(1.3, wants(4))
    assert isinstance(again, PartPlace)


def test_the_pose_of_the_part_is_sent_after_the_landmarks_since_an_arm_that_drives_to_them_by_it_measures_nothing():
    course = Course()
    course.part = replace(NO_PART_POSE, state=PartPoseState.KNOWN, link_from_base=np.eye(4))
    screw = replace(wants(3).target, channel=None, landmark="screw")
    at_landmark = wants(3, target=screw)
    assert not any(isinstance(line, PartPlace) for line in course.at(1.0, at_landmark))
    assert any(isinstance(line, PartPlace) for line in course.at(1.1, wants(4)))
    course.part = replace(course.part, link_from_base=np.diag([1.0, -1.0, -1.0, 1.0]))
    lines = course.at(1.2, at_landmark)
    assert any(isinstance(line, PartPlace) for line in lines), "a robot that knows it is told of a better one"


def test_a_known_point_and_what_is_said_where_there_is_no_target():
    course = Course()
    head = replace(wants(3).target, channel=None, landmark="wrist, top")
    line = course.asked(1.0, wants(3, target=head))
    assert (line.channel, line.known) == (None, True)
    assert course.at(1.1, None) == [NoTarget.ANY]
    assert course.at(1.2, wants(3), measuring=False) == [NoTarget.WAIT]
    assert course.at(1.3, wants(3), measuring=False) == []
    assert course.at(1.4, wants(None)) == [NoTarget.ENOUGH]
    assert course.asked(1.5, wants(3)).number == 2


def test_a_poke_is_judged_when_it_is_final_and_the_next_target_waits_for_that():
    course = Course(poke(1, 0.0))
    course.asked(1.0, wants(3))
    course.pokes.append(poke(2, 2.0, final=False))
    for later in (wants(4), wants(None), None):
        assert course.at(2.4, later) == []
    course.pokes[-1] = poke(2, 2.0)
    verdict, line = course.at(2.6, wants(4))
    assert verdict == Judged(1)
    assert (line.number, line.channel) == (2, 4)
    assert course.at(2.7, wants(4)) == []


def test_a_rejected_poke_says_why_and_the_same_is_asked_for_under_another_number():
    course = Course()
    course.asked(1.0, wants(3))
    course.pokes.append(poke(1, 2.0, Reason.TOO_SOFT))
    verdict, line = course.at(2.6, wants(3))
    assert verdict == Judged(1, "too soft: 2.5 N (needs 4.0 N)")
    assert (line.number, line.channel) == (2, 3)
    # At a landmark no taxel has to answer.
    course.pokes.append(poke(2, 3.0, Reason.NO_TAXEL))
    course.landmarks[2] = "wrist"
    assert course.at(3.6, wants(4))[0] == Judged(2)


def test_a_poke_that_began_before_is_of_the_target_before_or_of_nobody():
    course = Course()
    course.pokes.append(poke(1, 0.5))
    course.asked(1.0, wants(3))
    course.pokes.append(poke(2, 0.9))
    assert course.at(1.3, wants(3)) == [], "somebody's own poke, before anything was asked for"
    course.asked(2.0, wants(4))
    course.pokes.append(poke(3, 1.9))
    assert course.at(2.3, wants(4)) == [Judged(1)]
    course.pokes.append(poke(4, 2.2))
    assert course.at(2.6, wants(5))[0] == Judged(2)


@pytest.mark.parametrize("by", ["reached before the verdict", "reached after it", "tip"])
@pytest.mark.parametrize("by_hand", [False, True])
def test_a_robot_that_drives_to_a_landmark_is_known_by_its_lines_unless_a_hand_guides_it(by, by_hand):
    course = Course()
    screw = replace(wants(3).target, channel=None, landmark="screw")
    course.robot.note_tip()
    course.asked(1.0, wants(3, target=screw))
    if by_hand:
        # The last place of the tip before the robot read the request.
        course.robot.note_tip()
        course.robot.note_hand(GuidedByHand(1))
    if by == "reached before the verdict":
        course.robot.handle_answer(Answer(REACHED, 1), 2.4)
    elif by == "tip":
        course.robot.note_tip()
    course.pokes.append(poke(1, 2.0, Reason.NO_TAXEL))
    course.landmarks[1] = "screw"
    assert course.at(2.6, wants(4))[0] == Judged(1)
    if by == "reached after it":
        course.robot.handle_answer(Answer(REACHED, 1), 2.7)
    assert course.robot.take_driven() == ([] if by_hand else ["screw"])
    assert course.robot.take_driven() == []
    # A taxel is no landmark.
    course.robot.note_tip()
    course.robot.handle_answer(Answer(REACHED, 2), 3.0)
    course.pokes.append(poke(2, 2.9))
    course.at(3.6, wants(5))
    assert course.robot.take_driven() == []


def test_a_hand_that_touches_a_landmark_while_the_robot_waits_in_silence_drove_nowhere():
    course = Course()
    course.asked(1.0, wants(3, target=replace(wants(3).target, channel=None, landmark="screw")))
    course.pokes.append(poke(1, 2.0, Reason.NO_TAXEL))
    course.landmarks[1] = "screw"
    course.at(2.6, wants(4))
    assert course.robot.take_driven() == []


@pytest.mark.parametrize("says", ["nothing", "hand", "reached", "tip", "reached late"])
def test_a_connected_robot_that_says_nothing_about_a_landmark_is_reported_once(says):
    course = Course()
    course.robot.robot_connected()
    course.asked(1.0, wants(3, target=replace(wants(3).target, channel=None, landmark="screw")))
    if says == "hand":
        course.robot.note_hand(GuidedByHand(1))
    elif says == "tip":
        course.robot.note_tip()
    elif says == "reached":
        course.robot.handle_answer(Answer(REACHED, 1), 2.2)
    course.pokes.append(poke(1, 2.0, Reason.NO_TAXEL))
    course.landmarks[1] = "screw"
    course.at(2.6, wants(4))
    assert course.robot.take_silent(2.6 + POKE_DETECTION_TIMEOUT_S) == "", "its line may be on the way"
    if says == "reached late":
        course.robot.handle_answer(Answer(REACHED, 1), 2.8)
    later_s = 2.7 + POKE_DETECTION_TIMEOUT_S
    assert course.robot.take_silent(later_s) == ("screw" if says == "nothing" else "")
    assert course.robot.take_silent(later_s) == ""
    course.robot.robot_connected()
    assert course.robot.take_silent(later_s) == "", "the touch was before this robot came"


@pytest.mark.parametrize("is_there", [True, False])
def test_a_robot_that_left_is_not_expected_to_speak(is_there):
    course = Course()
    course.asked(1.0, wants(3, target=replace(wants(3).target, channel=None, landmark="screw")))
    course.robot.robot_connected()
    course.pokes.append(poke(1, 2.0, Reason.NO_TAXEL))
    course.landmarks[1] = "screw"
    course.at(2.6, wants(4))
    if not is_there:
        course.robot.robot_left()
    assert course.robot.take_silent(9.0) == ("screw" if is_there else "")


@pytest.mark.parametrize(("scene", "says"), [("cobot-tip", True), ("flat-patch", False)])
@pytest.mark.parametrize(
    "news", [[RobotChange.CAME], [RobotChange.CAME, GuidedByHand(1)], [RobotChange.CAME, RobotChange.LEFT], []]
)
def test_the_operator_reads_of_a_silent_robot_where_the_part_of_a_tool_is_touched(scene, says, news):
    course, guided = Course(), GuidedSession(load_part(resource(f"scenes/{scene}/scene.toml")))
    guided._robot = course.robot
    course.asked(1.0, wants(3, target=replace(wants(3).target, channel=None, landmark="screw")))
    answers = [news, []]
    server = SimpleNamespace(read_answers=lambda: answers.pop(0))
    pipeline = SimpleNamespace(scene=guided.part.scene)
    assert guided.handle_answers(pipeline, server, 1_500_000_000) == []
    course.pokes.append(poke(1, 2.0, Reason.NO_TAXEL))
    course.landmarks[1] = "screw"
    course.at(2.6, wants(4))
    expected = [silent_robot_sentence("screw")] if says and news == [RobotChange.CAME] else []
    assert guided.handle_answers(pipeline, server, 9_000_000_000) == expected


def test_silence_about_a_taxel_or_without_a_robot_is_usual():
    course = Course()
    course.asked(1.0, wants(3))
    course.robot.robot_connected()
    course.pokes.append(poke(1, 2.0))
    course.at(2.6, wants(4))
    assert course.robot.take_silent(9.0) == ""


def test_what_is_reached_and_not_felt_is_rejected_in_the_end():
    course = Course()
    course.asked(1.0, wants(3))
    assert course.robot.handle_answer(Answer(REACHED, 1), 2.0).protocol_error == ""
    assert course.at(2.0 + POKE_DETECTION_TIMEOUT_S - 0.1, wants(3)) == []
    verdict, line = course.at(2.0 + POKE_DETECTION_TIMEOUT_S + 0.1, wants(3))
    assert verdict == Judged(1, approved("targets.not_felt"))
    assert line.number == 2


def test_links_that_stop_hold_nothing_up_for_ever():
    course = Course()
    course.asked(1.0, wants(3))
    course.pokes.append(poke(1, 2.0, final=False))
    assert course.at(3.0, wants(4)) == []
    assert [type(line) for line in course.at(9.0, wants(4))] == [Judged, PokeTarget]


def test_skip_asks_for_another_and_what_crosses_it_is_passed_over():
    course = Course()
    course.asked(1.0, wants(3))
    assert course.robot.handle_answer(Answer(SKIP, 1), 1.1).wants_other_target
    assert not course.robot.handle_answer(Answer(SKIP, 1), 1.2).wants_other_target, "once"
    assert course.asked(1.3, wants(4)).number == 2
    for late in (Answer(REACHED, 1), Answer(SKIP, 1), Answer(FAULT, 1, "late")):
        meaning = course.robot.handle_answer(late, 1.4)
        assert (meaning.wants_other_target, meaning.warning, meaning.protocol_error) == (False, "", "")


@pytest.mark.parametrize("on", ["again", "another"])
def test_after_a_fault_nothing_is_asked_for_until_the_robot_comes_again_or_wants_another(on):
    course = Course()
    course.asked(1.0, wants(3))
    trouble = course.robot.handle_answer(Answer(FAULT, 1, "protective stop"), 1.1).warning
    assert approved("targets.stopped", number=1, why="protective stop") in trouble
    assert course.at(1.2, wants(3)) == [NoTarget.WAIT]
    assert course.at(9.0, wants(4)) == []
    if on == "again":
        course.robot.robot_connected()
    else:
        assert course.robot.handle_answer(Answer(SKIP, 1), 9.1).wants_other_target
    assert course.asked(9.2, wants(4)).number == 2


@pytest.mark.parametrize("number", [0, 2, 999_999_999])
def test_a_number_that_was_never_asked_for_is_a_lie(number):
    course = Course()
    assert course.robot.handle_answer(Answer(REACHED, 1), 0.5).protocol_error, "before anything was asked for"
    course.asked(1.0, wants(3))
    assert approved("targets.was_asked", most=1) in course.robot.handle_answer(Answer(REACHED, number), 1.1).protocol_error


def test_held_is_said_once_for_the_target_that_is_open():
    course = Course()
    assert course.at(0.9, None, held=True) == [NoTarget.ANY]
    course.asked(1.0, wants(3))
    assert course.at(1.5, wants(3), held=True) == [Held(1)]
    assert course.at(1.6, wants(3), held=True) == []
    (line,) = course.at(1.7, wants(4), held=False)
    assert course.at(1.8, wants(4), held=True) == [Held(line.number)]


def test_a_halted_robot_gets_verdicts_and_no_target_until_it_may_go_on():
    course = Course()
    course.asked(1.0, wants(3))
    assert course.robot.halt() == [NoTarget.WAIT, NoTarget.STOP]
    course.pokes.append(poke(1, 2.0))
    assert course.at(2.6, wants(4)) == [Judged(1)]
    for guidance in (wants(5), None, wants(None)):
        assert course.at(2.7, guidance) == []
    course.robot.go_on()
    assert course.asked(3.0, wants(4)).number == 2


def test_an_impossible_target_is_told_to_the_operator_once_for_each_reason():
    course, meanings = Course(), []
    for number, reason in enumerate(["out of reach", "out of reach", "", "the part is in the way"], 1):
        course.asked(float(number), wants(number))
        meanings.append(course.robot.handle_answer(Answer(SKIP, number, reason), number + 0.5))
    assert all(meaning.wants_other_target for meaning in meanings)
    assert [meaning.impossible for meaning in meanings] == ["out of reach", "out of reach", "", "the part is in the way"]
    assert [bool(meaning.warning) for meaning in meanings] == [True, False, False, True]
