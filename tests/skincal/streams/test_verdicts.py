"""What is found of a link, from bytes: each verdict, with no window and no port."""

from __future__ import annotations

from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from skincal.model.readings import Batch, Chunk, LinkAnswer, LinkEvent, LinkState, Stream
from skincal.streams.expected_readings import ExpectedReadings
from skincal.streams.intake import LinkIntake
from skincal.streams.link_diagnosis import LinkMonitor
from skincal.streams.links import LinkSpec

MS = 1_000_000
SECOND = 1000 * MS
CHANNELS, JOINTS = 64, 7


def line(values) -> bytes:
    return ",".join(f"{value:.4f}" for value in values).encode() + b"\n"


def noise(width, digits=4):
    return lambda index: line(np.round(np.random.default_rng([5, index]).normal(0, 0.1, width), digits))


def still(width):
    return lambda _: line(np.full(width, 240.0))


class Played:
    """A link whose clock is the test's."""

    def __init__(self, *carries: Stream, format_name: str = "auto", address: str = "socket://127.0.0.1:1") -> None:
        self.link = LinkIntake(ExpectedReadings(CHANNELS, JOINTS), LinkSpec("link", address, carries, format_name))
        self.now_ns = 10 * SECOND
        self.event(LinkState.OPEN)

    def event(self, state: LinkState, text: str = "", **more) -> None:
        self.link.feed(LinkEvent("link", self.now_ns, state, text, **more))

    def send(self, made, seconds: float = 1.5, hz: int = 100) -> Played:
        for index in range(round(seconds * hz)):
            self.now_ns += SECOND // hz
            self.link.feed(Chunk("link", self.now_ns, made(index)))
        return self

    def wait(self, seconds: float) -> Played:
        self.now_ns += round(seconds * SECOND)
        return self

    @property
    def found(self):
        return self.link.health(self.now_ns).verdict

    @property
    def answer(self) -> LinkAnswer:
        return self.found.answer


@pytest.mark.parametrize(
    ("stream", "width"), [(Stream.WRENCH, 6), (Stream.SKIN, CHANNELS), (Stream.JOINTS, JOINTS), (Stream.JOINTS, 16)]
)
def test_what_is_wanted_is_good_once_it_is_sure(stream, width):
    played = Played(stream)
    assert played.answer is LinkAnswer.LISTENING
    assert played.send(noise(width)).answer is LinkAnswer.GOOD
    assert not played.found.unchanged


def test_a_link_that_says_nothing_gives_no_answer_after_two_seconds():
    played = Played(Stream.WRENCH)
    assert played.wait(1.9).answer is LinkAnswer.LISTENING
    assert played.wait(0.2).answer is LinkAnswer.NO_ANSWER
    assert played.send(noise(6)).answer is LinkAnswer.GOOD
    assert played.wait(2.1).answer is LinkAnswer.NO_ANSWER


@pytest.mark.parametrize("state", [LinkState.FAILED, LinkState.LOST])
def test_a_link_that_is_away_gives_no_answer_at_once_and_is_judged_anew_when_it_is_back(state):
    played = Played(Stream.WRENCH).send(noise(6))
    played.event(state, "unplugged")
    assert played.answer is LinkAnswer.NO_ANSWER
    played.event(LinkState.OPEN)
    assert played.answer is LinkAnswer.LISTENING
    assert played.send(noise(6)).answer is LinkAnswer.GOOD


def test_bytes_that_are_no_reading_are_said_with_the_rates_that_were_tried():
    played = Played(Stream.WRENCH, address="/dev/ttyUSB0")
    garbage = lambda index: bytes(np.random.default_rng([5, index]).integers(128, 256, 40, dtype=np.uint8))  # noqa: E731
    assert played.send(garbage, 0.9).answer is LinkAnswer.LISTENING
    assert played.send(garbage, 0.5).answer is LinkAnswer.NO_READING
    assert played.found.tried == ()
    played.event(LinkState.OPEN, tried=(115200, 460800))
    assert played.send(garbage).found.tried == (115200, 460800)
    played.event(LinkState.OPEN, tried=(115200, 460800, 19200))
    assert played.send(noise(6)).answer is LinkAnswer.GOOD
    assert played.found.tried[-1] == 19200


@pytest.mark.parametrize(
    ("stream", "width", "answer", "found", "expected"),
    [
        (Stream.WRENCH, CHANNELS, LinkAnswer.OTHER_STREAM, Stream.SKIN, 0),
        (Stream.WRENCH, 384, LinkAnswer.OTHER_STREAM, Stream.SKIN, 0),
        (Stream.SKIN, 6, LinkAnswer.OTHER_STREAM, Stream.WRENCH, 0),
        (Stream.JOINTS, CHANNELS, LinkAnswer.OTHER_STREAM, Stream.SKIN, 0),
        (Stream.SKIN, 20, LinkAnswer.OTHER_WIDTH, None, CHANNELS),
        (Stream.WRENCH, 3, LinkAnswer.OTHER_WIDTH, None, 6),
        (Stream.JOINTS, 3, LinkAnswer.OTHER_WIDTH, None, JOINTS),
    ],
)
def test_another_stream_or_number_of_values_is_told(stream, width, answer, found, expected):
    verdict = Played(stream).send(noise(width)).found
    assert (verdict.answer, verdict.found, verdict.width, verdict.expected) == (answer, found, width, expected)


def test_a_board_that_sends_one_of_two_streams_is_not_good():
    both = Played(Stream.WRENCH, Stream.SKIN)
    assert both.send(noise(6), 3.5).found.stream is Stream.SKIN
    assert both.answer is LinkAnswer.NO_READING
    rows = iter((6, 20) * 1000)
    assert both.send(lambda index: noise(next(rows))(index), 3.5).answer is LinkAnswer.OTHER_WIDTH
    assert (both.found.width, both.found.expected) == (20, CHANNELS)


def test_a_board_with_both_streams_on_a_line_is_no_exchanged_address():
    both = Played(Stream.WRENCH, Stream.SKIN)
    verdict = both.send(noise(6 + CHANNELS)).found
    assert (verdict.answer, verdict.width) == (LinkAnswer.OTHER_WIDTH, 6 + CHANNELS)


def test_a_wrench_that_repeats_itself_after_noise_froze_and_lives_again_with_one_bit():
    played = Played(Stream.WRENCH).send(noise(6))
    assert played.send(still(6), 0.9).answer is LinkAnswer.GOOD
    assert not played.link.monitor.is_frozen
    assert played.send(still(6), 0.3).answer is LinkAnswer.FROZEN
    assert played.link.monitor.is_frozen
    played.send(still(6), 100)
    assert played.link.monitor.is_frozen, "however long it lasts"
    played.send(lambda _: line([240, 240, 240, 240, 240, 240.0001]), 0.02)
    assert played.answer is LinkAnswer.GOOD
    assert not played.link.monitor.is_frozen
    played.send(noise(6), 1)
    assert played.send(still(6), 1.2).link.monitor.is_frozen, "the first freeze is no habit"


def test_a_wrench_that_never_changed_is_said_to_and_breaks_no_poke():
    played = Played(Stream.WRENCH).send(still(6), 1.6)
    assert played.answer is LinkAnswer.FROZEN
    assert played.link.monitor.is_lifeless
    assert not played.link.monitor.is_frozen
    assert not played.send(noise(6), 0.1).link.monitor.is_lifeless


def test_a_coarse_sensor_that_shows_no_noise_at_rest_is_no_frozen_one():
    played = Played(Stream.WRENCH).send(still(6), 1.2)
    for _ in range(4):
        played.send(noise(6), 0.4)
        assert played.send(still(6), 1.4).answer is LinkAnswer.GOOD
        assert not played.link.monitor.is_frozen


@pytest.mark.parametrize(("stream", "width"), [(Stream.SKIN, CHANNELS), (Stream.JOINTS, JOINTS)])
def test_a_skin_behind_a_threshold_and_joints_that_stand_still_are_never_frozen(stream, width):
    played = Played(stream).send(still(width), 5)
    assert played.answer is LinkAnswer.GOOD
    assert played.found.unchanged == (stream is Stream.SKIN)
    played.send(noise(width), 0.5)
    assert not played.send(still(width), 5).found.unchanged
    assert played.answer is LinkAnswer.GOOD


def test_a_slow_sensor_is_not_frozen_by_few_readings():
    played = Played(Stream.WRENCH).send(noise(6), 60, hz=1)
    assert played.send(still(6), 3, hz=1).answer is LinkAnswer.GOOD


def test_the_end_of_a_file_is_judged_as_it_was():
    played = Played(Stream.WRENCH).send(noise(6))
    played.event(LinkState.ENDED)
    assert played.wait(100).answer is LinkAnswer.GOOD


def test_how_the_bytes_are_cut_changes_no_verdict():
    whole, cut = Played(Stream.SKIN), Played(Stream.SKIN)
    text = b"".join(noise(20)(index) for index in range(200))
    for at in range(0, len(text), 1000):
        whole.now_ns = cut.now_ns = whole.now_ns + 30 * MS
        whole.link.feed(Chunk("link", whole.now_ns, text[at : at + 1000]))
        for byte in range(at, min(at + 1000, len(text)), 7):
            cut.link.feed(Chunk("link", cut.now_ns, text[byte : min(byte + 7, at + 1000)]))
    assert whole.found == cut.found
    assert whole.answer is LinkAnswer.OTHER_WIDTH


@given(st.lists(st.tuples(st.booleans(), st.booleans()), min_size=1, max_size=40))
def test_readings_are_compared_together_as_part_by_part(steps):
    """Each differs from the one before it or not, and ends a part or not; parts are half a second apart."""
    values = np.cumsum([differs for differs, _ in steps])[:, None] * np.ones((1, 6))
    ends = sorted({index for index, (_, last) in enumerate(steps, start=1) if last} | {len(steps)})
    batch = Batch(Stream.WRENCH, *np.zeros((2, len(steps))), values, *np.zeros((2, len(steps)), bool))
    together, alone = (LinkMonitor((Stream.WRENCH,), {}, None) for _ in range(2))
    for ear in (together, alone):
        ear.on_data(b"", 5, [replace(batch, seq=np.zeros(1), values=np.zeros((1, 6)))])
    times = [500_000_000 * index for index in range(1, len(ends) + 1)]
    frozen: list[bool] = []
    for (begin, end), at_ns in zip(pairwise([0, *ends]), times, strict=True):
        alone.on_data(b"", at_ns, [batch.rows(begin, end)])
        frozen.append(alone.is_frozen)
    assert together.on_run(batch, ends, times) == frozen
    one, other = (vars(ear._streams[Stream.WRENCH]) for ear in (together, alone))
    assert repr(one) == repr(other)
    assert together.diagnose(times[-1]) == alone.diagnose(times[-1])
    assert together.freezes == alone.freezes
