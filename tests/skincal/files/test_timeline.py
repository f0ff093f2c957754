import tracemalloc
from collections import Counter
from unittest.mock import patch

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from skincal.files.importers.timeline import (
    CHUNK_MAX_LINES,
    SESSION_START_TIME_NS,
    Timeline,
    check_overlap,
    merged_chunks,
    share_clock_jumps,
)
from skincal.model.errors import InputError
from tests.approved import approved, approved_pattern

BLOCK = 7


def timed(name, stamps):
    return Timeline(name, (np.array(stamps[at : at + BLOCK]) for at in range(0, len(stamps), BLOCK)))


def lines(stamps):
    data = [f"{index}\n".encode() for index in range(len(stamps))]
    return lambda: (data[at : at + BLOCK] for at in range(0, len(stamps), BLOCK))


def play(**files):
    """Every line alone."""
    with patch("skincal.files.importers.timeline.CHUNK_MAX_LINES", 1):
        return together(alone=files, **files)


def together(alone=(), **files):
    timelines = [timed(name, stamps) for name, stamps in files.items()]
    return list(merged_chunks(timelines, [lines(stamps) for stamps in files.values()], alone))


def test_files_are_merged_by_time_and_the_first_wins_a_tie():
    chunks = play(wrench=[10.0, 10.02, 10.04], skin=[9.99, 10.02])
    assert [(chunk.link, (chunk.host_ns - SESSION_START_TIME_NS) // 1000) for chunk in chunks] == [
        ("skin", 0), ("wrench", 10_000), ("wrench", 30_000), ("skin", 30_000), ("wrench", 50_000),
    ]  # fmt: skip


def test_stamps_since_1970_keep_their_microseconds():
    stamps = [1_700_000_000.000001 + k * 0.001 for k in range(1000)]
    times = [chunk.host_ns - SESSION_START_TIME_NS for chunk in play(wrench=stamps)]
    assert times == [k * 1_000_000 for k in range(1000)]


def test_a_clock_set_back_goes_on_one_interval_later():
    stamps = [5.0 + k * 0.01 for k in range(50)] + [1.0 + k * 0.01 for k in range(50)]
    times = np.array([chunk.host_ns - SESSION_START_TIME_NS for chunk in play(wrench=stamps)]) * 1e-9
    np.testing.assert_allclose(times, np.arange(100) * 0.01, atol=2e-6)


def test_one_clock_set_back_is_one_shift_though_each_file_saw_it_at_another_instant():
    wrench, skin = [5.0, 5.01, 5.02, 1.05, 1.06], [5.0, 5.02, 1.08, 1.1]
    chunks = play(wrench=wrench, skin=skin)
    after = {chunk.link: chunk.host_ns for chunk in chunks}
    assert after["skin"] - after["wrench"] == pytest.approx(40_000_000, abs=2000)


def test_two_clocks_set_back_by_other_amounts_keep_their_own_shift():
    wrench = [5.0, 5.01, 5.02, 1.0, 1.01]
    skin = [5.0, 5.02, 4.0, 4.02]
    timelines = [timed("a", wrench), timed("b", skin)]
    share_clock_jumps(timelines)
    shifts = [back for timeline in timelines for back in timeline.jumps.values()]
    assert shifts == pytest.approx([4.03, 1.04])


def test_a_slow_stream_has_no_gaps_and_a_fast_one_has_those_that_are_there():
    assert timed("joints", [k * 0.2 for k in range(700)]).gaps == 0
    early_and_late = [k * 0.01 + (0.3 if k > 20 else 0) + (0.5 if k > 650 else 0) for k in range(700)]
    found = timed("wrench", early_and_late)
    assert (found.gaps, round(found.longest_gap, 6), found.interval) == (2, 0.51, pytest.approx(0.01))


STAMPS = st.lists(st.floats(-1e6, 1e6, allow_nan=False).map(lambda x: round(x, 6)), min_size=1, max_size=30)


@given(st.lists(STAMPS, min_size=1, max_size=3))
def test_whatever_the_stamps_every_line_comes_once_in_its_files_order_and_time_never_runs_back(files):
    chunks = play(**{f"f{index}": stamps for index, stamps in enumerate(files)})
    times = [chunk.host_ns for chunk in chunks]
    assert times == sorted(times)
    assert times[0] >= SESSION_START_TIME_NS
    for index, stamps in enumerate(files):
        assert [int(chunk.data) for chunk in chunks if chunk.link == f"f{index}"] == list(range(len(stamps)))


def test_recordings_of_different_times_are_refused():
    first, second = timed("wrench", [1.0, 2.0]), timed("skin", [3.0, 4.0])
    with pytest.raises(
        InputError,
        match=approved_pattern(
            "recording.times_apart", wrench_from="1.000", wrench_to="2.000", skin_from="3.000", skin_to="4.000"
        ),
    ):
        check_overlap([first, second])
    check_overlap([first, timed("skin", [1.5, 4.0])])


@given(st.lists(STAMPS, min_size=1, max_size=3))
def test_lines_that_travel_together_are_all_there_in_order_and_time_never_runs_back(files):
    chunks = together(**{f"f{index}": stamps for index, stamps in enumerate(files)})
    times = [chunk.host_ns for chunk in chunks]
    assert times == sorted(times)
    for index, stamps in enumerate(files):
        data = b"".join(chunk.data for chunk in chunks if chunk.link == f"f{index}")
        assert [int(line) for line in data.split()] == list(range(len(stamps)))


def test_neighbouring_lines_travel_at_the_time_of_the_last_and_a_clock_starts_with_one_line():
    wrench = [k * 0.01 for k in range(20)] + [3.0, 3.01, 3.02]
    chunks = together(wrench=wrench, joints=[0.0, 0.015, 0.025], alone=["joints"])
    seen = [
        (chunk.link, round(chunk.host_ns - SESSION_START_TIME_NS, -3) // 1_000_000, len(chunk.data.split())) for chunk in chunks
    ]
    assert seen == [
        ("wrench", 0, 1), ("joints", 0, 1), ("joints", 25, 2), ("wrench", 90, 9), ("wrench", 190, 10),
        ("wrench", 3000, 1), ("wrench", 3020, 2),
    ]  # fmt: skip


def test_stamps_that_do_not_move_do_not_gather_without_end():
    assert max(len(chunk.data.split()) for chunk in together(wrench=[1.0] * 1000)) == CHUNK_MAX_LINES


@pytest.mark.parametrize("wrong", [9_420_000_900.5, 3.0, -1e9, 12.0])
@pytest.mark.parametrize("lines_wrong", [1, 3])
def test_stamps_written_wrong_shift_nothing(wrong, lines_wrong):
    stamps = [5.0 + k * 0.01 for k in range(100)]
    broken = [wrong + k * 0.01 if 40 <= k < 40 + lines_wrong else stamp for k, stamp in enumerate(stamps)]
    found = timed("wrench", broken)
    assert (found.outliers, found.jumps, found.gaps) == (set(range(40, 40 + lines_wrong)), {}, 0)
    assert (found.first, found.last) == (stamps[0], stamps[-1])
    assert any(f"{lines_wrong} stamp" in sentence for sentence in found.sentences())
    times = np.array([chunk.host_ns - SESSION_START_TIME_NS for chunk in play(wrench=broken)]) * 1e-9
    expected = np.arange(100) * 0.01
    expected[40 : 40 + lines_wrong] = 0.39
    np.testing.assert_allclose(times, expected, atol=2e-6)


def test_a_last_stamp_years_later_is_wrong_and_a_clock_that_stays_years_later_is_refused():
    found = timed("wrench", [1.0, 1.01, 1.02, 9e8])
    assert (found.last, found.outliers, found.gaps) == (1.02, {3}, 0)
    with pytest.raises(
        InputError, match=approved_pattern("recording.over_years", link="wrench", first="1.000", last="900000000.050")
    ):
        check_overlap([timed("wrench", [1.0, *(9e8 + k * 0.01 for k in range(6))])])


@pytest.mark.parametrize("off", [5.0, -5.0])
def test_a_clock_that_is_wrong_for_a_second_shifts_nothing_after_it(off):
    """Both signs, in one of two files: the other one goes on meanwhile, and they stay paired."""
    true = [10.0 + 0.02 * k for k in range(400)]
    wrong = [stamp + off * (100 <= k < 150) for k, stamp in enumerate(true)]
    found = timed("skin", wrong)
    assert (found.gaps, found.last) == (0, pytest.approx(true[-1]))
    assert approved("recording.wrong_meanwhile", link="skin", off=f"{off:+.3f}", seconds="1.0") in found.sentences()
    times = (
        np.array([chunk.host_ns - SESSION_START_TIME_NS for chunk in play(wrench=true, skin=wrong) if chunk.link == "skin"])
        * 1e-9
    )
    np.testing.assert_allclose(times, np.array(true) - 10.0, atol=2e-6)


@pytest.mark.parametrize("step", [0.01, 1.0])
def test_times_that_run_backwards_are_refused(step):
    stamps = [100.0 - step * k for k in range(90)]
    with pytest.raises(InputError, match=approved_pattern("recording.backwards", link="skin", earlier=89, lines=90)):
        check_overlap([timed("wrench", sorted(stamps)), timed("skin", stamps)])
    # A clock that was set back, and messages that overtook each other, are no such recording.
    often = [100.0 + step * (k - 20 * (k > 50) + 1.5 * (k % 2)) for k in range(90)]
    check_overlap([timed("wrench", sorted(stamps)), timed("skin", often)])


@pytest.mark.parametrize("off", [5.0, -5.0])
def test_a_clock_that_is_wrong_again_and_again_is_said_in_few_sentences(off):
    stamps = [k * 0.01 + off * (k % 400 >= 300) for k in range(4000)]
    found = [sentence for sentence in timed("skin", stamps).sentences() if "the clock was wrong" in sentence]
    assert found[:3] == [approved("recording.wrong_meanwhile", link="skin", off=f"{off:+.3f}", seconds="1.0")] * 3
    assert found[3:] == [approved("recording.wrong_more", link="skin", times=len(range(300, 4000, 400)) - 4, seconds="6.0")]


def test_rows_of_a_slow_stream_are_no_clock_that_was_wrong():
    assert len(timed("skin", [float(k) for k in range(100)]).sentences()) == 1


def test_a_clock_that_is_set_again_much_later_or_by_another_amount_was_set_twice():
    later = [0.02 * k - 5.0 * (100 <= k < 3300) for k in range(4000)]
    assert sorted(timed("skin", later).jumps) == [100]
    other = [0.02 * k + 5.0 * (100 <= k < 150) - 2.0 * (k >= 150) for k in range(300)]
    assert timed("skin", other).jumps == {150: pytest.approx(7.0)}


@pytest.mark.parametrize("size", [1, 2, 5, 64])
def test_blocks_of_lines_do_not_change_the_chunks(size):
    random = np.random.default_rng(2)
    stamps = np.cumsum(random.choice([0.0001, 0.001, 0.3], 700))
    stamps[200:] -= 3.0  # set back
    stamps[[400, 401, 650]] += 1e3  # wrong for a moment
    stamps[500:550] += 2.0  # set, and set back
    files = {"wrench": stamps.tolist(), "joints": stamps[::7].tolist()}
    expected = together(("joints",), **files)
    with (
        patch("skincal.files.importers.timeline.BLOCK_NUMBERS", size),
        patch("skincal.files.importers.tape.BLOCK_NUMBERS", size),
    ):
        assert together(("joints",), **files) == expected


def test_lines_of_twenty_minutes_take_no_memory():
    """At 1 kHz and at 50 Hz: all times at once are 10 MB, and were in memory several times."""
    seconds, hz = 1200, {"wrench": 1000, "skin": 50}
    tracemalloc.start()
    try:
        timelines = [Timeline(name, (at + np.arange(rate) / rate for at in range(seconds))) for name, rate in hz.items()]
        sources = [lambda rate=rate: ([b"1"] * rate for _ in range(seconds)) for rate in hz.values()]
        lines = Counter(chunk.link for chunk in merged_chunks(timelines, sources) for _ in chunk.data)
        peak = tracemalloc.get_traced_memory()[1]
    finally:
        tracemalloc.stop()
    assert lines == {name: seconds * rate for name, rate in hz.items()}
    assert peak < 12e6
