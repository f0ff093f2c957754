"""Offset of the skin's times against those of the wrench: two logs whose clocks differ."""

import json
import math

import numpy as np
import pytest

from skincal.contacts import stream_offset
from skincal.contacts.skin_condition import SkinCondition
from skincal.contacts.stream_offset import REMEMBERED_S, STEP_S, StreamOffsetWatch, find_offset
from skincal.model.codec import from_json, to_json
from tests.skincal.soldered_board import Board, import_board, poke


def watched(offset_s, *, polarity=1.0, every_s=None, seconds=120.0, rate=50.0, rest_s=0.0, watch=None, begin_s=0.0):
    """Offset that the watch finds of presses at uneven times, or `every_s`, with noise and drift of the skin.

    `rest_s` without a press follow.
    """
    rng = np.random.default_rng(3)
    starts = np.arange(2.0, seconds, every_s) if every_s else np.cumsum(rng.uniform(2.5, 5.5, round(seconds / 4.0)))
    times = np.arange(0.0, seconds + rest_s, 1.0 / rate)

    def press(at):
        return np.clip(np.minimum(at[:, None] - starts, starts + 1.2 - at[:, None]) / 0.2, 0.0, 1.0)

    force, answer = 8.0 * press(times).sum(axis=1), press(times - offset_s)
    taxels = np.zeros((len(times), 6))
    for number in range(len(starts)):
        taxels[:, number % 6] += 300.0 * answer[:, number]
    skin = np.round(200.0 + polarity * taxels + 0.3 * times[:, None] + rng.normal(0.0, 1.0, taxels.shape))
    wrench = np.column_stack([np.zeros((len(times), 2)), force]) + rng.normal(0.0, 0.05, (len(times), 3))
    watch = watch or StreamOffsetWatch()
    for row in zip((begin_s + times).tolist(), wrench, skin, strict=True):
        watch.add(*row)
    return watch.offset_s


@pytest.mark.parametrize("polarity", [1.0, -1.0])
@pytest.mark.parametrize("offset_s", [0.0, 0.2, -0.2])
def test_streams_of_one_clock_have_no_offset_whatever_their_polarity(offset_s, polarity):
    assert watched(offset_s, polarity=polarity) is None


@pytest.mark.parametrize("rate", [20.0, 50.0, 100.0])
@pytest.mark.parametrize("offset_s", [0.5, -0.7, 1.4, -2.5])
def test_an_offset_is_found(offset_s, rate):
    assert watched(offset_s, rate=rate) == pytest.approx(offset_s, abs=0.1)


def test_evenly_spaced_pokes_leave_the_number_open():
    offset_s = watched(1.5, every_s=3.0)
    assert offset_s == math.inf
    # A session that is opened again says the same.
    stored = json.loads(json.dumps(to_json(SkinCondition(offset_s=offset_s)), allow_nan=False))
    assert from_json(SkinCondition, stored).offset_s == math.inf


def test_an_offset_stays_while_nobody_presses():
    assert watched(0.5, rest_s=2.0 * REMEMBERED_S) == pytest.approx(0.5, abs=0.1)


def test_a_pause_of_a_month_costs_no_more_than_a_short_one(monkeypatch):
    spans = []

    def noted(times, *changes):
        spans.append(times[-1] - times[0])
        return find_offset(times, *changes)

    monkeypatch.setattr(stream_offset, "find_offset", noted)
    watch = StreamOffsetWatch()
    watched(0.5, watch=watch)
    assert watched(0.5, watch=watch, begin_s=2.6e6) == pytest.approx(0.5, abs=0.1)
    assert max(spans) <= REMEMBERED_S


def test_a_wrench_that_changes_at_the_beginning_alone_shows_none():
    """At offsets of 3 s nothing of it can be compared."""
    times, rng = np.arange(0.0, 25.0, STEP_S), np.random.default_rng(1)
    wrench = np.where(times < 2.7, rng.uniform(1.0, 5.0, len(times)), 0.0)
    assert find_offset(times, wrench, np.where(rng.random(len(times)) < 0.2, 1.0, 0.0)) is None


def test_few_presses_and_a_skin_that_nobody_touches_show_none():
    assert watched(1.0, seconds=15.0) is None
    watch, rng = StreamOffsetWatch(), np.random.default_rng(1)
    for row in range(3000):
        watch.add(0.02 * row, rng.normal(0.0, 0.05, 3), np.full(4, 7.0))
    assert watch.offset_s is None


@pytest.mark.parametrize(("shift_s", "is_named"), [(0.0, False), (0.5, True), (-0.5, True)])
def test_logs_of_two_clocks_are_named_and_no_polarity(tmp_path, capsys, shift_s, is_named):
    frames = poke(Board(rows=4, columns=4, pokes_each=2))
    late = np.clip(np.arange(len(frames.times)) - round(shift_s / np.diff(frames.times).mean()), 0, len(frames.times) - 1)
    import_board(tmp_path, frames, frames.plain[late])
    said = capsys.readouterr().out
    assert ("and a poke needs both at once: their clocks differ" in said) == is_named
    assert "polarity" not in said
