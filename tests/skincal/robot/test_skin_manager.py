"""Positions to a running skinManager: a simulated one over TCP, that takes them, refuses, lies, falls silent or hangs up."""

import json
import shutil
import time

import numpy as np
import pytest

from skincal.cli import main
from skincal.devices.yarp import read_answer, write_question
from skincal.files.icub import read_icub
from skincal.model.scene import resource
from skincal.simulation.emulated_devices import PlainTalk, SkinManagerTalk
from skincal.simulation.emulated_transports import SkinManagerOutlet, TalkOutlet
from tests.approved import approved
from tests.skincal.robot.robot_support import robot

CHANNELS = 384
TAXELS = 84
QUESTION = bytes.fromhex(
    "59410a00000052500201ffffffffffffffff080000001700000000000000000000007e64000104010000010000000b0000006765744d65746164617461"
)
"""What a real port was asked, and answered."""


@pytest.fixture
def sample(tmp_path):
    """A copy of the session that ships: 84 taxels of the right forearm."""
    return shutil.copytree(resource("sessions/sample"), tmp_path / "sample")


class Stubborn(SkinManagerTalk):
    """Does as `special` says at questions that begin so, `after` others of them."""

    special, after = ("set", "pose"), 10

    def __init__(self, number, poses, instead):
        super().__init__(number, poses)
        self._instead, self._count = instead, 0

    def answer(self, words):
        if tuple(words[: len(self.special)]) == self.special:
            self._count += 1
            if self._count > self.after:
                return self._instead(self, words)
        return super().answer(words)


class StubbornOutlet(SkinManagerOutlet):
    """A skinManager with one talk of that kind."""

    def __init__(self, instead, channels=CHANNELS, kind=Stubborn):
        super().__init__(channels)
        self._talk = lambda: kind(self.port, self.poses, instead)


def apply(capsys, sample, address, *more):
    code = main(["apply", str(sample), "--to", address, *more])
    said = capsys.readouterr()
    return code, said.out, said.err


def test_a_question_has_the_bytes_that_a_real_port_answered():
    assert write_question(["getMetadata"]) == QUESTION
    mixed = write_question(["get", "pose", 5])
    # A list of three kinds has the kind of each: word, word, whole number.
    assert mixed[38:] == bytes.fromhex(
        "0001000003000000" "0400000003000000" "676574" "0400000004000000" "706f7365" "0100000005000000"
    )  # fmt: skip


def test_an_answer_is_read_with_a_port_command_before_it_or_without():
    doubles = bytes.fromhex("0a01000002000000") + np.array([0.5, -2.0]).tobytes()
    assert read_answer(doubles) == [0.5, -2.0]
    assert read_answer(bytes.fromhex("000000007e440001") + doubles) == [0.5, -2.0]
    # 126 values are no port command.
    many = bytes.fromhex("0a0100007e000000") + bytes(8 * 126)
    assert read_answer(many) == [0.0] * 126


def test_positions_arrive_as_the_file_has_them_and_go_back(capsys, sample, tmp_path):
    out = tmp_path / "robot.txt"
    assert main(["export", str(sample), "--format", "icub", "--out", str(out)]) == 0
    capsys.readouterr()
    written = read_icub(out)
    manager = SkinManagerOutlet(CHANNELS)
    had = np.zeros((CHANNELS, 7))
    had[300] = [0.01, 0.02, 0.03, 0.0, 0.0, 1.0, 1.0]  # a taxel of the session, elsewhere
    had[5] = [0.05, 0.02, 0.03, 0.0, 1.0, 0.0, 1.0]  # one that the session does not know
    manager.poses[:] = had
    with robot(manager) as address:
        code, said, told = apply(capsys, sample, address)
        placed = written[:, :3].any(axis=1)
        assert code == 0
        assert placed.sum() == TAXELS
        np.testing.assert_allclose(manager.poses[placed, :6], written[placed], atol=1e-12)
        assert (manager.poses[placed, 6] == 1.0).all()
        assert manager.poses[5].tolist() == had[5].tolist(), "what was not measured stays as it was"
        assert approved("apply.changed", count=TAXELS, part="r_forearm") in said
        assert said.startswith(approved("verdict.not_enough", done=78, count=84))
        assert told.count("set pose 5 ") == TAXELS
        assert told.count("set position 5 ") == TAXELS - 1, "one was known to be there"
        before = sample / "before-r_forearm.txt"
        kept = before.read_bytes()
        code, said, _ = apply(capsys, sample, address)
        assert (code, before.read_bytes()) == (0, kept), "nothing changed: the old file is not written over"
        assert approved("apply.already", count=TAXELS, part="r_forearm") in said
        code, said, _ = apply(capsys, before, address, "--json")
        assert code == 0
        assert json.loads(said)["changed"] == TAXELS
        np.testing.assert_allclose(manager.poses, had, atol=1e-12)


def refused_at(capsys, sample, manager, *more):
    """Return the one sentence of a refusal, and what the robot has then."""
    with robot(manager) as address:
        code, said, told = apply(capsys, sample, address, *more)
    assert code == 2
    assert said == ""
    *earlier, sentence = told.splitlines()
    # A command to copy stands whole before the sentence, where there is something to bring back.
    back = f"`skincal apply {sample / 'before-r_forearm.txt'} --to {address}`"
    assert any(back in line for line in earlier) or "brings the old" not in sentence
    return sentence, manager.poses


def test_a_refusal_half_way_says_how_far_it_came_and_what_brings_the_old_ones_again(capsys, sample):
    manager = StubbornOutlet(lambda *_: [1, "ERROR: pose was not set"])
    sentence, poses = refused_at(capsys, sample, manager)
    assert "'1 ERROR: pose was not set'" in sentence
    assert approved("apply.half_way", changed=10, due=TAXELS) in sentence
    assert sentence.endswith(approved("apply.file_back", file="before-r_forearm.txt"))
    assert poses[:, :3].any(axis=1).sum() == 10
    assert not read_icub(sample / "before-r_forearm.txt").any()


def test_going_back_goes_on_where_it_was_refused(capsys, sample):
    class Once(Stubborn):
        refused = False

        def refuse(self, words):
            if Once.refused:
                return SkinManagerTalk.answer(self, words)
            Once.refused = True
            return [1, "ERROR: pose was not set"]

    calibrated = SkinManagerOutlet(CHANNELS)
    with robot(calibrated) as address:
        assert apply(capsys, sample, address)[0] == 0
    before = sample / "before-r_forearm.txt"
    old = before.read_bytes()
    manager = StubbornOutlet(Once.refuse, kind=Once)
    manager.poses[:] = calibrated.poses
    with robot(manager) as address:
        assert apply(capsys, before, address)[0] == 2
        assert manager.poses[:, :3].any(), "half way"
        assert apply(capsys, before, address)[0] == 0
    assert not manager.poses[:, :3].any(), "all back"
    assert before.read_bytes() == old
    assert read_icub(sample / "before-r_forearm-undone.txt")[:, :3].any()


@pytest.mark.parametrize("answer", [["Unknown command."], [], [2], [1]])
def test_any_other_answer_to_a_change_is_a_refusal(capsys, sample, answer):
    manager = StubbornOutlet(lambda *_: answer)
    manager._talk = lambda: type("First", (Stubborn,), {"after": 0})(manager.port, manager.poses, lambda *_: answer)
    sentence, poses = refused_at(capsys, sample, manager)
    assert sentence.endswith(approved("apply.unchanged"))
    assert not poses.any()


def test_a_robot_that_falls_silent_or_hangs_up_half_way(capsys, sample):
    class Dumb(Stubborn):
        def on_request(self, data):
            out = super().on_request(data)
            return b"" if self._count > self.after else out

    begun = time.monotonic()
    sentence, _ = refused_at(capsys, sample, StubbornOutlet(SkinManagerTalk.answer, kind=Dumb), "--timeout", "0.3")
    assert time.monotonic() - begun < 20
    assert "no answer within 0.3 s" in sentence
    assert approved("apply.half_way", changed=10, due=TAXELS) + ", whether it did 'set pose 5 " in sentence

    class Leaving(Dumb):
        @property
        def over(self):
            return self._count > self.after

        @over.setter
        def over(self, _value):
            pass

    sentence, _ = refused_at(capsys, sample, StubbornOutlet(SkinManagerTalk.answer, kind=Leaving))
    assert approved("apply.half_way", changed=10, due=TAXELS) in sentence


def test_a_robot_that_says_yes_and_does_nothing_is_found_out(capsys, sample):
    sentence, _ = refused_at(capsys, sample, StubbornOutlet(lambda *_: [0]))
    assert "has others at channels" in sentence
    assert sentence.endswith(approved("apply.file_back", file="before-r_forearm.txt"))


class Elsewhere(SkinManagerTalk):
    """Runs another part."""

    PART, NUMBER = "r_hand", 4


def test_another_part_or_width_changes_nothing(capsys, sample):
    other = SkinManagerOutlet(CHANNELS)
    other._talk = lambda: Elsewhere(other.port, other.poses)
    assert "this skinManager has r_hand, and not r_forearm" in refused_at(capsys, sample, other)[0]
    sentence, poses = refused_at(capsys, sample, SkinManagerOutlet(192))
    assert "'1344 values' to the request for its poses; expected the 2688 numbers" in sentence
    assert sentence.endswith(approved("apply.unchanged"))
    assert not poses.any()
    assert not (sample / "before-r_forearm.txt").exists()


class Raw(PlainTalk):
    """Greets as a port, then says `lie`."""

    def __init__(self, lie):
        super().__init__()
        self._lie = lie

    def on_request(self, data):
        if b"skincal\0" in data:
            return b"YA\x06\x29\0\0RP"
        return self._lie


LIES = {
    "2 GB": b"YA\x0a\0\0\0RP\x01\x01" + b"\xff" * 8 + b"\xff\xff\xff\x7f\0\0\0\0",
    "negative": b"YA\x0a\0\0\0RP\x01\x01" + b"\xff" * 8 + b"\xff\xff\xff\xff\0\0\0\0",
    "count": b"YA\x0a\0\0\0RP\x01\x01" + b"\xff" * 8 + b"\x08\0\0\0\0\0\0\0" + b"\0\x01\0\0\xff\xff\xff\x7f",
    "empty": b"YA\x0a\0\0\0RP\x01\x01" + b"\xff" * 8 + bytes(8),
    "no message": b"HTTP/1.0 400 Bad Request\r\n\r\n",
}


@pytest.mark.parametrize("lie", LIES)
def test_a_port_that_lies_costs_one_sentence(capsys, sample, lie):
    with robot(TalkOutlet(lambda: Raw(LIES[lie]), "{}")) as address:
        code, _, told = apply(capsys, sample, address)
    assert code == 2
    (sentence,) = told.splitlines()
    assert sentence.endswith(approved("apply.unchanged"))


def test_a_dry_run_opens_nothing_and_prints_what_would_be_sent(capsys, sample):
    code, said, told = apply(capsys, sample, "yarp://192.0.2.1:1/nobody", "--dry-run")
    assert (code, told) == (0, "")
    asked = [line for line in said.splitlines() if line.startswith("set pose 5 ")]
    assert len(asked) == TAXELS
    assert approved("apply.dry") in said
    manager = SkinManagerOutlet(CHANNELS)
    with robot(manager) as address:
        _, _, sent = apply(capsys, sample, address)
    really = [line.partition(": ")[0] for line in sent.splitlines() if line.startswith("set ")]
    assert really == [line for line in said.splitlines() if line.startswith("set ")], "the robot had nothing"
    words = asked[0].split()
    assert words[3] == "204"
    assert all("." in word for word in words[4:]), "a whole number would be taken for a taxel"


def test_orders_that_cannot_be_right_are_refused(capsys, sample, tmp_path):
    file = tmp_path / "robot.txt"
    assert main(["export", str(sample), "--format", "icub", "--out", str(file)]) == 0
    capsys.readouterr()
    for source, address, more, words in (
        (file, "yarp:/x", ("--correct",), "since only a session is solved"),
        (sample, "yarp:/x", ("--method", "free", "--part", "left_ear"), "expected one of l_hand"),
        (sample, "/dev/ttyUSB0", (), "is not a YARP port. Example: yarp:"),
        (sample, "netft://192.0.2.1", ("--dry-run",), "is not a YARP port. Example: yarp:"),
    ):
        code, _, told = apply(capsys, source, address, *more)
        assert code == 2
        assert words in told


def test_zeros_of_an_exported_file_erase_nothing(capsys, sample, tmp_path):
    file = tmp_path / "robot.txt"
    assert main(["export", str(sample), "--format", "icub", "--method", "free", "--out", str(file)]) == 0
    blind = np.flatnonzero(~read_icub(file)[:, :3].any(axis=1)).tolist()
    manager = SkinManagerOutlet(CHANNELS)
    manager.poses[:] = [0.01, 0.02, 0.03, 0.0, 0.0, 1.0, 1.0]
    had = manager.poses.copy()
    with robot(manager) as address:
        code, said, _ = apply(capsys, file, address)
        assert code == 0
        assert approved("apply.changed", count=TAXELS - 5, part="r_forearm") in said
        np.testing.assert_array_equal(manager.poses[blind], had[blind])
        assert apply(capsys, tmp_path / "before-r_forearm.txt", address)[0] == 0
    np.testing.assert_allclose(manager.poses, had, atol=1e-12)
