"""Pairing of wrench and skin, and the facade: truth from exact clocks, losses counted, the same items give the same samples."""

import tracemalloc
from collections import Counter

import numpy as np
import pytest

from skincal.devices.decoding import pack, pack_all
from skincal.devices.netft import RECORDS
from skincal.model.errors import InputError
from skincal.model.readings import Batch, Chunk, LinkEvent, LinkState, Loss, Stream
from skincal.streams.expected_readings import ExpectedReadings
from skincal.streams.intake import Intake
from skincal.streams.links import LinkSpec
from skincal.streams.pairing import (
    FRAME_MAX_WAIT_FOR_WRENCH_S,
    MAX_INTERPOLATED_GAP_S,
    MAX_STORED_WRENCHES,
    Pairing,
    WrenchRing,
)
from tests.skincal.streams.maker_records import rdt_packets, rdt_record, skb_skin, skb_wrench

LINKS = (LinkSpec("wrench", "a", (Stream.WRENCH,)), LinkSpec("skin", "b", (Stream.SKIN,)))
SLOPE = np.array([1.0, -2.0, 0.5, 0.1, 0.2, -0.3])
START = 100.0


def ramp(host_s):
    return np.multiply.outer(host_s, SLOPE) + 3.0


def wrench_batch(host_s, wrench=None, saturated=None, invalid=None):
    n = len(host_s)
    none = np.zeros(n, bool)
    wrench = ramp(host_s) if wrench is None else wrench
    return Batch(
        Stream.WRENCH,
        np.full(n, -1),
        np.full(n, np.nan),
        wrench,
        none if saturated is None else saturated,
        none if invalid is None else invalid,
    )


def paired(wrench_s, frame_s, **flags):
    pairing = Pairing()
    pairing.add_wrench(np.asarray(wrench_s), wrench_batch(np.asarray(wrench_s), **flags))
    for t in frame_s:
        pairing.add_frame(t, t, np.array([t]))
    return pairing, pairing.pop_paired(max(wrench_s[-1], frame_s[-1]))


# ------------------------------------------------------------------ the mean over a frame's interval


def test_mean_over_the_interval_that_ends_at_the_frame():
    """Readings at 1 kHz, frames at 50 Hz: 20 readings each, the mean of a ramp is its value at their middle."""
    wrench_s = START + np.arange(2000) * 0.001
    frames = START + 0.1 + np.arange(80) * 0.02
    _, samples = paired(wrench_s, frames)
    assert len(samples) == 80
    for sample, t in zip(samples, frames, strict=True):
        assert sample.readings == 20
        assert sample.host_s == t
        assert sample.skin.tolist() == [t]
        np.testing.assert_allclose(sample.wrench, ramp(t - 0.0095), atol=1e-9)
        assert not sample.saturated


def test_lost_frame_does_not_stretch_the_interval():
    frames = np.delete(START + 0.1 + np.arange(40) * 0.02, [20, 21])
    _, samples = paired(START + np.arange(1000) * 0.001, frames)
    assert [sample.readings for sample in samples] == [20] * 38


def test_slower_wrench_is_interpolated_at_the_middle_of_the_interval():
    wrench_s = START + np.arange(100) * 0.01
    frames = START + 0.1 + np.arange(180) * 0.004 + 0.001
    _, samples = paired(wrench_s, frames)
    lone = [sample for sample in samples if sample.readings == 2]
    assert len(lone) > 50
    for sample in lone[5:]:
        np.testing.assert_allclose(sample.wrench, ramp(sample.host_s - 0.002), atol=1e-9)


@pytest.mark.parametrize(("gap", "found"), [(MAX_INTERPOLATED_GAP_S - 0.002, True), (MAX_INTERPOLATED_GAP_S + 0.002, False)])
def test_wider_gaps_are_not_interpolated(gap, found):
    pairing = Pairing()
    wrench_s = np.array([START, START + gap, START + 0.2])
    pairing.add_wrench(wrench_s, wrench_batch(wrench_s))
    pairing.add_frame(START + 0.03, START + 0.03, np.zeros(1))
    samples = pairing.pop_paired(START + 0.2)
    assert len(samples) == (1 if found else 0)


# ------------------------------------------------------------------ readings that cannot be used


def test_not_finite_and_invalid_readings_are_kept_out_of_the_mean():
    wrench_s = START + np.arange(400) * 0.001
    wrench = ramp(wrench_s)
    bad = np.arange(400) % 4 == 1
    wrench[bad, 2] = np.nan
    invalid = np.arange(400) % 4 == 3
    wrench[invalid] = 1e6
    _, samples = paired(wrench_s, START + 0.1 + np.arange(10) * 0.02, wrench=wrench, invalid=invalid)
    for sample in samples:
        assert sample.readings == 10
        np.testing.assert_allclose(sample.wrench, ramp(sample.host_s - 0.009), atol=1e-9)
        assert sample.saturated  # the device flagged readings of the interval


def test_a_wrench_between_two_readings_is_saturated_where_one_of_them_is():
    wrench_s = START + np.arange(20) * 0.04
    saturated = np.arange(20) == 8
    _, samples = paired(wrench_s, START + 0.1 + np.arange(20) * 0.02 + 0.005, saturated=saturated)
    # One reading in the interval is the wrench; with none, two about its middle are interpolated.
    reach = {1: 0.01, 2: 0.04}
    touched = [abs(sample.host_s - 0.01 - wrench_s[8]) < reach[sample.readings] for sample in samples]
    assert sum(touched) >= 3
    assert [sample.saturated for sample in samples] == touched


def test_saturated_readings_mark_their_frames_and_no_others():
    wrench_s = START + np.arange(400) * 0.001
    saturated = (wrench_s > START + 0.21) & (wrench_s < START + 0.215)
    _, samples = paired(wrench_s, START + 0.1 + np.arange(10) * 0.02, saturated=saturated)
    assert [sample.saturated for sample in samples] == [False] * 6 + [True] + [False] * 3
    np.testing.assert_allclose(samples[6].wrench, ramp(samples[6].host_s - 0.0095), atol=1e-9)


# ------------------------------------------------------------------ waiting, late, unpaired


def test_frame_waits_for_its_wrench():
    pairing = Pairing()
    pairing.add_frame(START, START, np.zeros(1))
    assert pairing.pop_paired(START + 0.2) == []
    wrench_s = START - 0.02 + np.arange(40) * 0.001
    pairing.add_wrench(wrench_s, wrench_batch(wrench_s))
    (sample,) = pairing.pop_paired(START + 0.2)
    np.testing.assert_allclose(sample.wrench, ramp(START - 0.0095), atol=1e-9)
    assert not pairing.counts


def test_frame_without_a_wrench_is_counted_after_its_wait_and_holds_up_none():
    pairing = Pairing()
    pairing.add_frame(START, START, np.zeros(1))
    assert pairing.pop_paired(START + FRAME_MAX_WAIT_FOR_WRENCH_S) == []
    assert not pairing.counts
    assert pairing.pop_paired(START + FRAME_MAX_WAIT_FOR_WRENCH_S + 0.001) == []
    assert pairing.counts == Counter({Loss.UNPAIRED: 1})
    wrench_s = START + 0.3 + np.arange(40) * 0.001
    pairing.add_wrench(wrench_s, wrench_batch(wrench_s))
    pairing.add_frame(START + 0.33, START + 0.33, np.zeros(1))
    assert len(pairing.pop_paired(START + 0.34)) == 1


def test_wait_counts_from_the_arrival_of_a_frame_that_came_late():
    """A stalled program reads both links late: the skin's bytes are not given up before the wrench's are read."""
    pairing = Pairing()
    pairing.add_frame(START, START + 0.4, np.zeros(1))
    assert pairing.pop_paired(START + 0.41) == []
    wrench_s = START - 0.02 + np.arange(40) * 0.001
    pairing.add_wrench(wrench_s, wrench_batch(wrench_s))
    assert len(pairing.pop_paired(START + 0.42)) == 1


def test_frame_older_than_every_reading_kept_is_late():
    pairing = Pairing()
    for k in range(5):
        wrench_s = START + (k * MAX_STORED_WRENCHES + np.arange(MAX_STORED_WRENCHES)) * 0.001
        pairing.add_wrench(wrench_s, wrench_batch(wrench_s))
    pairing.add_frame(START + 1.0, START + 1.0, np.zeros(1))
    assert pairing.pop_paired(START + 1.0) == []
    assert pairing.counts == Counter({Loss.LATE: 1})


def test_joint_angles_are_the_last_at_or_before_the_frame():
    pairing = Pairing()
    wrench_s = START + np.arange(300) * 0.001
    pairing.add_wrench(wrench_s, wrench_batch(wrench_s))
    for t, angle in ((0.12, 1.0), (0.16, 2.0), (0.17, 3.0), (0.9, 4.0)):
        pairing.add_joints(START + t, np.array([angle]))
    for t in (0.1, 0.12, 0.14, 0.16, 0.18, 0.2):
        pairing.add_frame(START + t, START + t, np.zeros(1))
    angles = [None if s.angles is None else float(s.angles[0]) for s in pairing.pop_paired(START + 0.3)]
    assert angles == [None, 1.0, 1.0, 2.0, 3.0, 3.0]


def test_ring_keeps_the_newest_in_order_however_it_is_filled():
    rng = np.random.default_rng(0)
    ring = WrenchRing(50)
    fed = np.zeros(0)
    for _ in range(200):
        host_s = (fed[-1] if len(fed) else 0.0) + 0.1 + np.arange(rng.integers(1, 70))
        n = len(host_s)
        ring.append(host_s, np.outer(host_s, np.ones(6)), np.ones(n, bool), np.zeros(n, bool))
        fed = np.append(fed, host_s)
        found, wrench = ring.since(-np.inf)
        assert 50 <= len(found) <= 100 or len(found) == len(fed)
        np.testing.assert_array_equal(found, fed[-len(found) :])
        np.testing.assert_array_equal(wrench[:, 3], found)
        assert ring.newest_s == fed[-1]
        assert ring.is_older_than_kept(fed[0] - 1) == (len(found) < len(fed))


# ------------------------------------------------------------------ the facade


def rig(seconds, channels=4, *, broken=False):
    """Items of a wrench sensor at 1 kHz and a skin at 50 Hz, each with its own clock; a press every second."""
    rng = np.random.default_rng(5)
    items = [LinkEvent(name, int(START * 1e9), LinkState.OPEN) for name in ("wrench", "skin")]
    for k in range(0, int(seconds * 1000), 10):
        t_s = (k + np.arange(10)) * 0.001
        data = b"".join(skb_wrench(k + i, 5_000_000 + round(t * 1e6), ramp(t)) for i, t in enumerate(t_s))
        if broken and k % 500 == 100:
            data = data[:50] + b"\x07" + data[51:]
        items.append(Chunk("wrench", int((START + t_s[-1] + 0.001 + rng.exponential(0.002)) * 1e9), data))
    for n in range(int(seconds * 50)):
        t = n * 0.02 + 0.0005
        data = skb_skin(n, 77_000 + round(t * 1e6), [n % 200] * channels)
        if broken and n % 40 == 7:
            data = data[:-3] + data[-2:]
        items.append(Chunk("skin", int((START + t + 0.001 + rng.exponential(0.002)) * 1e9), data))
    return sorted(items, key=lambda item: item.host_ns)


def feed_all(intake, items):
    return [sample for item in items for sample in intake.feed(item)]


def test_two_devices_with_their_own_clocks_are_brought_together():
    intake = Intake(ExpectedReadings(4), LINKS)
    samples = feed_all(intake, rig(8))
    assert len(samples) >= 8 * 50 - 3
    settled = samples[150:]
    for sample in settled:
        made_s = (sample.host_s - START) - 0.001
        # Both least delays are about 1 ms; a difference of 0.5 ms of the two lines is half a reading.
        np.testing.assert_allclose(sample.wrench, ramp(made_s - 0.0095), atol=2.2e-3)
        assert 19 <= sample.readings <= 21
    assert np.diff([s.host_s for s in settled]) == pytest.approx(0.02, abs=1e-3)
    assert samples[-1].skin.tolist() == [199] * 4
    stamps, wrench = intake.recent_wrench()
    assert len(stamps) == len(wrench) == 8000
    assert (np.diff(stamps) > 0).all()


def test_same_items_give_the_same_samples_bit_for_bit():
    items = rig(4, broken=True)
    one, two = Intake(ExpectedReadings(4), LINKS), Intake(ExpectedReadings(4), LINKS)
    a, b = feed_all(one, items), feed_all(two, items)
    assert len(a) == len(b) > 150
    for x, y in zip(a, b, strict=True):
        assert (x.host_s, x.readings, x.saturated) == (y.host_s, y.readings, y.saturated)
        assert x.wrench.tobytes() == y.wrench.tobytes()
        assert x.skin.tobytes() == y.skin.tobytes()
    now = items[-1].host_ns
    assert one.health(now) == two.health(now)


def test_health_counts_rates_and_losses():
    intake = Intake(ExpectedReadings(4), LINKS)
    assert [(h.state, h.rate, h.format) for h in intake.health(0)] == [(LinkState.LOST, 0.0, "")] * 2
    items = rig(4, broken=True)
    feed_all(intake, items)
    now = items[-1].host_ns
    wrench, skin = intake.health(now)
    assert (wrench.link, wrench.state, wrench.format, wrench.carries) == ("wrench", LinkState.OPEN, "SKB/1", (Stream.WRENCH,))
    assert wrench.rate == pytest.approx(1000, rel=0.03)
    assert skin.rate == pytest.approx(50, rel=0.06)
    assert wrench.last_host_ns == max(i.host_ns for i in items if i.link == "wrench")
    assert wrench.losses[Loss.BAD_CHECKSUM] + wrench.losses[Loss.UNREADABLE] == 8
    assert wrench.losses[Loss.MISSING] == 8
    assert wrench.readings == 4000 - 8
    assert skin.losses[Loss.MISSING] == 5
    assert skin.readings == 200 - 5
    assert intake.health(now + 1_000_000_000)[0].rate == pytest.approx(500, rel=0.06)
    assert intake.health(now + 10_000_000_000)[0].rate == 0


def test_link_that_went_away_and_came_back_goes_on_with_all_counts():
    items = rig(4, broken=True)
    half = len(items) // 2
    now = items[half].host_ns
    intake = Intake(ExpectedReadings(4), LINKS)
    before = feed_all(intake, items[:half])
    counted = intake.health(now)
    feed_all(intake, [LinkEvent("skin", now, LinkState.LOST, "unplugged")])
    assert (intake.health(now)[1].state, intake.health(now)[1].text) == (LinkState.LOST, "unplugged")
    feed_all(intake, [LinkEvent("skin", now, LinkState.OPEN)])
    after = feed_all(intake, items[half:])
    _, skin = intake.health(now)
    assert (skin.state, skin.text) == (LinkState.OPEN, "")
    assert skin.readings > counted[1].readings
    assert skin.losses[Loss.MISSING] >= counted[1].losses[Loss.MISSING] > 0
    assert after[0].host_s > before[-1].host_s
    assert len(after) > 90


def test_memory_stays_flat():
    items = rig(12)
    half = len(items) // 2
    intake = Intake(ExpectedReadings(4), LINKS)
    for item in items[:half]:
        intake.feed(item)
    tracemalloc.start()
    try:
        for item in items[half:]:
            intake.feed(item)
        grown, _ = tracemalloc.get_traced_memory()
    finally:
        tracemalloc.stop()
    assert grown < 100_000


def test_text_held_back_is_let_through_at_the_end():
    intake = Intake(ExpectedReadings(2), LINKS[1:])
    intake.feed(Chunk("skin", 1_000_000, b"1,1\n2,2\n3,3\n"))
    assert intake.health(0)[0].readings == 0
    intake.feed(LinkEvent("skin", 2_000_000, LinkState.ENDED))
    assert intake.health(0)[0].readings == 2  # the first line may have lost its beginning
    assert intake.health(0)[0].format == "text"


def test_unknown_links_and_formats_are_named():
    with pytest.raises(InputError, match=r"'other'.*wrench, skin"):
        Intake(ExpectedReadings(4), LINKS).feed(Chunk("other", 0, b""))
    with pytest.raises(InputError, match="same name"):
        Intake(ExpectedReadings(4), (LINKS[0], LINKS[0]))
    with pytest.raises(InputError, match="'xml'"):
        Intake(ExpectedReadings(4), (LinkSpec("wrench", "a", (Stream.WRENCH,), "xml"),))


def held_up(ready_s, rng):
    """Return when bytes arrive on a busy machine: half the time it is late for up to a second, by 20 to 200 ms."""
    begins = ready_s[0] + np.cumsum(rng.uniform(0.5, 2.0, 100))
    for begin, length, late in zip(begins, rng.uniform(0.3, 1.0, 100), rng.uniform(0.02, 0.2, 100), strict=True):
        ready_s = np.where((ready_s >= begin) & (ready_s < begin + length), ready_s + late, ready_s)
    # In order, and by the turns of 10 ms that the program gets.
    return np.ceil(np.maximum.accumulate(ready_s) / 0.01) * 0.01


def test_numbered_wrench_is_paired_on_a_machine_that_is_late_for_a_while():
    """RDT records carry numbers and no time: a number tells a late record from a lost one."""
    made = np.arange(40_000) * 0.001
    lost = np.isin(np.arange(40_000), [15_000, 15_001, 22_222])
    arrived = START + held_up(made + 0.001, np.random.default_rng(11))
    items = [*rig(0), Chunk("wrench", int(START * 1e9), rdt_packets([]))]
    for at in np.unique(arrived):
        due = np.flatnonzero((arrived == at) & ~lost)
        records = [rdt_record(k + 1, np.round(ramp(made[k]) * 1e6).astype(int)) for k in due]
        frames = [skb_skin(k // 20, 77_000 + k * 1000, [0] * 4) for k in due if k % 20 == 0]
        items.append(Chunk("wrench", round(at * 1e9), b"".join(pack(RECORDS, record) for record in records)))
        items.append(Chunk("skin", round(at * 1e9), b"".join(frames)))
    intake = Intake(ExpectedReadings(4), (LinkSpec("wrench", "netft://h", (Stream.WRENCH,)), LINKS[1]))
    settled = [sample for sample in feed_all(intake, items) if sample.host_s > START + 10.0]
    assert len(settled) >= 30 * 50 - 5
    error_s = [sample.wrench[0] - ramp(sample.host_s - START - 0.0105)[0] for sample in settled]
    assert np.max(np.abs(error_s)) < 0.01


def test_a_break_of_the_connection_is_counted_with_its_time():
    intake = Intake(ExpectedReadings(4), LINKS)

    def outages(now_s):
        return {link.link: (link.outages.count, link.outages.seconds) for link in intake.health(round(now_s * 1e9))}

    def say(state, at_s):
        intake.feed(LinkEvent("wrench", round(at_s * 1e9), state, "gone" if state is LinkState.LOST else ""))

    def send(at_s):
        intake.feed(Chunk("wrench", round(at_s * 1e9), skb_wrench(round(at_s), round(at_s * 1e6), [0.0] * 6)))

    say(LinkState.LOST, 0.5)
    say(LinkState.OPEN, 1.0)
    send(1.0)
    assert outages(3.0) == {"wrench": (0, 0.0), "skin": (0, 0.0)}, "what never gave a reading is not interrupted"
    say(LinkState.LOST, 4.0)
    say(LinkState.FAILED, 5.0)
    assert outages(7.0)["wrench"] == (1, 6.0), "since the last bytes"
    say(LinkState.OPEN, 15.0)
    send(16.0)
    say(LinkState.LOST, 17.0)
    send(20.0)
    say(LinkState.ENDED, 21.0)
    assert outages(40.0) == {"wrench": (2, 19.0), "skin": (0, 0.0)}


@pytest.mark.parametrize("sizes", [(), (36,), (36, 36, 36), (36, 0, 7)])
def test_messages_are_packed_together_as_one_by_one(sizes):
    payloads = [bytes([at]) * size for at, size in enumerate(sizes)]
    assert pack_all(3, payloads) == b"".join(pack(3, payload) for payload in payloads)
