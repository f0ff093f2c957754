"""The lines between skincal and a robot: every kind there and back, cut anywhere, garbage, and how long they may be."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from skincal.geometry import rotation_by
from skincal.model.errors import InputError
from skincal.model.scene import MAX_TIME_SETTING_S, SETTING_MAX
from skincal.robot.target_client import read_line
from skincal.robot.target_lines import (
    GREETING,
    LINE_MAX_BYTES,
    Answer,
    AnswerKind,
    GuidedByHand,
    Held,
    Judged,
    LineCutter,
    NoTarget,
    PartPlace,
    PokeTarget,
    Refused,
    RobotPace,
    TipPose,
    read_answer_line,
    write_answer,
    write_line,
)
from tests.approved import approved_pattern

PUSH = np.array([0.28, -0.31, -0.91])
SHOWN = PokeTarget(
    7, 204, np.array([0.0123456, -0.06, 0.1]), PUSH / np.linalg.norm(PUSH), False, "r_forearm", "94 deg, -0 deg/é", 9.5, 0.6
)


@pytest.mark.parametrize(
    "line",
    [*NoTarget, Held(3), Judged(3), Judged(3, "too soft (2.1, limit 4 N)"), Refused("another robot is connected")],
    ids=str,
)
def test_lines_without_a_target_are_read_back(line):
    assert read_line(write_line(line) + "\n") == line


@pytest.mark.parametrize(
    "answer",
    [
        *(Answer(AnswerKind.REACHED, 3), Answer(AnswerKind.SKIP, 3), Answer(AnswerKind.SKIP, 3, "joint 3 at its end")),
        *(Answer(AnswerKind.FAULT, 9, "joint 3 at its end"), RobotPace(0.05, 2.5)),
    ],
    ids=str,
)
def test_answers_are_read_back(answer):
    assert read_answer_line(write_answer(answer) + "\r") == answer


def test_a_tip_survives_its_line():
    read = read_answer_line(write_answer(TipPose(SHOWN.place, PUSH)))
    np.testing.assert_allclose(read.place, SHOWN.place, atol=6e-7)
    np.testing.assert_allclose(read.push, SHOWN.push, atol=1e-6)


def test_a_touch_by_hand_survives_its_line():
    assert write_answer(GuidedByHand(7)) == "hand 7"
    assert read_answer_line("hand 7") == GuidedByHand(7)
    for wrong in ("hand", "hand x", "hand 7 8", "reached 7 hand"):
        with pytest.raises(InputError):
            read_answer_line(wrong)


def test_the_pose_of_the_part_survives_its_line():
    pose = np.eye(4)
    pose[:3, :3], pose[:3, 3] = rotation_by(np.array([0.3, -2.0, 1.0])), (0.4, -0.123456, 0.2)
    line = write_line(PartPlace("left arm", pose))
    assert line.startswith("part left%20arm 0.400000 -0.123456 0.200000 ")
    read = read_line(line)
    assert read.frame == "left arm"
    np.testing.assert_allclose(read.base_from_link, pose, atol=2e-6)
    for wrong in ("part a 0 0 0 0 0 0 0", "part a 0 0 0 1 0 0", "part"):
        with pytest.raises(InputError, match="is no target"):
            read_line(wrong)


def test_a_target_survives_its_line():
    line = write_line(SHOWN)
    assert line.startswith("target 7 204 r_forearm 94%20deg%2C%20-0%20deg%2F%C3%A9 0.012346 -0.060000 0.100000 ")
    read = read_line(line)
    assert (read.number, read.channel, read.frame, read.pose, read.force, read.hold, read.known) == (
        7, 204, "r_forearm", "94 deg, -0 deg/é", 9.5, 0.6, False,
    )  # fmt: skip
    np.testing.assert_allclose(read.place, SHOWN.place, atol=6e-7)
    np.testing.assert_allclose(read.push, SHOWN.push, atol=1e-5)
    assert np.linalg.norm(read.push) == pytest.approx(1.0, abs=1e-12)
    for known, start in ((False, "target 7 - "), (True, "target 7 + ")):
        line = write_line(replace(SHOWN, channel=None, known=known, frame="", pose=""))
        assert line.startswith(start + "- - ")
        read = read_line(line)
        assert (read.channel, read.known, read.frame, read.pose) == (None, known, "", "")


def test_what_thresholds_allow_survives_its_line():
    # A still window of a minute, held twice; the middle of the widest force window.
    read = read_line(write_line(replace(SHOWN, hold=2.0 * MAX_TIME_SETTING_S, force=SETTING_MAX / 2.0)))
    assert (read.hold, read.force) == (120.0, 500_000.0)
    read = read_line(write_line(replace(SHOWN, hold=2e-5, force=0.0012345)))
    assert (read.hold, read.force) == (2e-5, 0.0012345)


def test_a_line_is_bounded_whatever_the_names():
    link = "腕" * 60
    line = write_line(replace(SHOWN, number=999_999_999, channel=99_999, place=-SHOWN.place, frame=link, pose="é" * 100))
    assert len(line.encode()) <= LINE_MAX_BYTES
    read = read_line(line)
    assert read.frame == link[: len(read.frame)] != ""
    assert read.pose == "é" * len(read.pose) != ""
    for words in (Judged(3, "腕" * 300), Refused("腕" * 300)):
        assert len(write_line(words).encode()) <= LINE_MAX_BYTES


GOOD = "target 7 204 r 1 0.1 0.2 0.3 0 0 -1 9.5 0.6"


@pytest.mark.parametrize(
    "line",
    [
        "target", "target 7", GOOD + " 1", GOOD.replace("204", "x"), GOOD.replace("204", "++"), GOOD.replace("204", "20.5"),
        GOOD.replace("0.1", "nan"), GOOD.replace("0.1", "inf"), GOOD.replace("0.1", "20"), GOOD.replace("-1", "0"),
        GOOD.replace("-1", "-9"), GOOD.replace("9.5", "-9"), GOOD.replace("0.6", "inf"), GOOD.replace("7", "-7"),
        "accepted", "rejected x y", "accepted " + "9" * 5000,
    ],
)  # fmt: skip
def test_a_line_that_is_none_is_named(line):
    with pytest.raises(InputError, match="is no target"):
        read_line(line)


def test_lines_of_later_versions_are_passed_over():
    assert read_line(GOOD).channel == 204
    for line in (GREETING, "", "wait 3", "pause for tea"):
        assert read_line(line) is None


@pytest.mark.parametrize(
    "line",
    [
        *("reached", "reached x", "reached 7 8", "skip -1", "skip", "fault", "REACHED 7", "accepted 7", "reached \uff17"),
        *("robot 0 1", "robot 1", "robot nan 1", "robot 1 inf", "robot 1 2 3", "tip 0 0 0 0 0 0", "tip 0 0 0 0 0 1 1"),
        *("tip nan 0 0 0 0 1", "tip 11 0 0 0 0 1", "tip 0 0 0 0 1", "reached " + "9" * 400, "GET / HTTP/1.1", "\x00\xff"),
    ],
)
def test_what_no_robot_says_is_refused(line):
    with pytest.raises(InputError, match=approved_pattern("targets.expected")):
        read_answer_line(line)


def test_a_fault_is_one_plain_line_of_bounded_length():
    answer = read_answer_line("fault 3 \x1b[2Jstop\ttwice  " + "x" * 480)
    assert "\x1b" not in answer.text
    assert answer.text.startswith("?[2Jstop twice x")
    assert len(answer.text) <= 200


@given(st.lists(st.text(st.characters(codec="utf-8", exclude_characters="\n"), max_size=80)), st.integers(1, 40))
def test_lines_are_the_same_however_they_are_cut(texts, size):
    data = "".join(f"{text}\n" for text in texts).encode()
    lines = LineCutter()
    found = [line for at in range(0, len(data), size) for line in lines.feed(data[at : at + size])]
    assert found == texts


@given(st.binary(max_size=2000))
def test_garbage_ends_in_an_answer_or_in_the_one_exception(data):
    try:
        for line in LineCutter().feed(data):
            assert read_answer_line(line) is None or line.split()[0] in {kind.value for kind in AnswerKind}
            read_line(line)
    except InputError:
        pass


@pytest.mark.parametrize("end", [b"", b"\n"])
def test_a_line_is_bounded_whether_or_not_it_ends(end):
    LineCutter().feed(b"x" * LINE_MAX_BYTES)
    with pytest.raises(InputError, match=approved_pattern("targets.more_than", most=LINE_MAX_BYTES)):
        LineCutter().feed(b"x" * (LINE_MAX_BYTES + 1) + end)
