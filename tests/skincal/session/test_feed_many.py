"""Items that are fed together leave the session, and the journal, that they leave one by one, to the last bit."""

from __future__ import annotations

import contextlib
import dataclasses
import itertools
import struct
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from skincal.contacts.detector import ContactDetector
from skincal.devices.decoding import pack
from skincal.devices.netft import PAGE, RECORDS
from skincal.devices.netft_page import given_page
from skincal.geometry import Arm, DhLink
from skincal.journal import writer
from skincal.journal.reader import SessionLog
from skincal.model.readings import Chunk, LinkEvent, LinkState, Stream, Tick
from skincal.model.scene import ArmSpec
from skincal.session import pipeline as pipeline_module
from skincal.session.pipeline import Pipeline
from skincal.session.replay import replay
from skincal.simulation.board_formats import SkbEncoder, make_encoder
from skincal.simulation.emulated_devices import X25, BotaEncoder, RdtEncoder, RobotiqEncoder, YarpEncoder, _crc
from skincal.streams.decoders.skb import SkbDecoder
from skincal.streams.links import LinkSpec
from tests.skincal.poke_script import ANSWERS, PERIOD_S, SPOTS, outcome_key, same_estimates, some_pokes, write_scene

STREAMS = (Stream.WRENCH, Stream.SKIN, Stream.JOINTS)


def links_of(*formats):
    """Links of the three streams with these formats."""
    every = zip(STREAMS, formats, strict=True)
    return tuple(LinkSpec(stream.value, "simulated:x", (stream,), name) for stream, name in every)


WIDTHS = {Stream.WRENCH: 6, Stream.SKIN: 24, Stream.JOINTS: 1}
LINKS = links_of("skb", "skb", "skb")
MAKER_LINKS = links_of("rdt", "yarp-port", "yarp-port")
WRENCHES_PER_CHUNK, CHUNKS_PER_FRAME = 3, 2
START_NS = 5_000_000_000
MS = 1_000_000


def an_arm(scene):
    """The scene with an arm of one joint."""
    return dataclasses.replace(scene, arm=ArmSpec(Arm((0,), (DhLink(0.0, 0.1, 0.0, 0.0),), np.eye(4)), {}))


def as_items(script, *, clock_jump_at=-1, frozen=range(0)):
    """Bytes of three boards in SKB/1: two chunks of wrenches, one of skin and one of joints for each sample, and ticks.

    At the sample `clock_jump_at` the clock of the wrench's board starts again; in the `frozen` samples its values stay.
    """
    boards = {link.name: SkbEncoder("f32") for link in LINKS}
    items: list[Chunk | LinkEvent | Tick] = [LinkEvent(link.name, START_NS - MS, LinkState.OPEN) for link in LINKS]
    rng, held, count = np.random.default_rng(3), np.zeros(6), WRENCHES_PER_CHUNK * CHUNKS_PER_FRAME
    first_s = script.samples[0].host_s
    for k, sample in enumerate(script.samples):
        now_us = round((sample.host_s - first_s) * 1e6) + 1_000_000
        host_ns = START_NS + now_us * 1000
        restart_us = 70_000_000 if 0 <= clock_jump_at <= k else 0
        for part in range(CHUNKS_PER_FRAME):
            records = []
            for j in range(WRENCHES_PER_CHUNK):
                back_us = round(PERIOD_S * 1e6) // count * (count - 1 - part * WRENCHES_PER_CHUNK - j)
                held = held if k in frozen else sample.wrench + rng.normal(0.0, 0.01, 6)
                records.append(boards["wrench"].record(Stream.WRENCH, now_us - back_us + restart_us, held.tolist()))
            items.append(Chunk("wrench", host_ns + (part - 1) * 10 * MS + int(rng.integers(0, MS)), b"".join(records)))
        items.append(Chunk("skin", host_ns + 2 * MS, boards["skin"].record(Stream.SKIN, now_us, sample.skin.tolist())))
        angle = [0.0 if sample.angles is None else float(np.degrees(sample.angles[0]))]
        items.append(Chunk("joints", host_ns + 3 * MS, boards["joints"].record(Stream.JOINTS, now_us, angle)))
        # Before the bytes of the next sample: after a pause they come when the journal's buffers are due.
        next_s = script.samples[min(k + 1, len(script.samples) - 1)].host_s
        items.append(Tick(host_ns + max(4 * MS, round((next_s - sample.host_s) * 1e9) - 15 * MS)))
    return items


def noisy_script(scene):
    return some_pokes(scene, 0)


def pressed(script, k=0, **how):
    script.press(np.array([0.3, -0.2, -8.0]), SPOTS[k % 3], ANSWERS[k % 3], **how)
    return script


def turned(scene):
    """The arm turns between two pokes, and in a third one."""
    script = noisy_script(scene)
    for k, angle in enumerate((0.0, 0.5, 0.5)):
        script.angles = np.array([angle])
        pressed(script.quiet(), k, hold_s=0.5).quiet()
    script.angles = np.array([0.9])
    return pressed(script, hold_s=0.5).quiet()


def in_gaps(scene):
    """Pauses of all boards before, in and after a poke, and one of eleven seconds in quiet."""
    script = pressed(noisy_script(scene).gap(0.4).quiet(), hold_s=0.3)
    script.gap(0.3)
    pressed(script, hold_s=0.3).gap(0.5).quiet()
    return pressed(script.gap(11.0).quiet(), 1, hold_s=0.5).quiet()


class PacketsOfRecords(RdtEncoder):
    """A Net F/T's records as its link gives them: packets, after its page."""

    def header(self, *_about):  # pyright: ignore[reportIncompatibleMethodOverride]
        return pack(PAGE, given_page(1e6, 1e6, "Net F/T"))

    def record(self, stream, t_us, values):
        return pack(RECORDS, super().record(stream, t_us, values))


class PortMessages(YarpEncoder):
    """Messages of a YARP port, after its number."""

    def header(self, *_about):  # pyright: ignore[reportIncompatibleMethodOverride]
        return bytes.fromhex("5941062900005250")


class WarmingSensor(BotaEncoder):
    """A sensor whose temperature rises with every record; its journal has it twice a second."""

    def record(self, stream, t_us, values):
        frame = super().record(stream, t_us, values)
        data = frame[1:-6] + struct.pack("<f", 20.0 + 1e-6 * (t_us % 10_000_000))
        return frame[:1] + data + struct.pack("<H", _crc(X25, data) ^ 0xFFFF)


def in_formats(items, *encoders):
    """The recording of boards in SKB/1 by devices of other formats; each begins with its header."""
    of_link = dict(zip([link.name for link in LINKS], encoders, strict=True))
    readers = {link.name: SkbDecoder(None, link.carries) for link in LINKS}
    begun, found = set(), []
    for item in items:
        if isinstance(item, Chunk):
            encoder, stream = of_link[item.link], Stream(item.link)
            records = []
            for batch in readers[item.link].feed(item.data):
                values = np.degrees(batch.values) if stream is Stream.JOINTS else batch.values
                records += encoder.encode(stream, np.round(batch.device_s * 1e6).astype(np.int64), values)
            header = b"" if item.link in begun else encoder.header(0, "", WIDTHS[stream])
            begun.add(item.link)
            item = dataclasses.replace(item, data=header + b"".join(records))
        found.append(item)
    return found


def by_makers(items):
    return in_formats(items, PacketsOfRecords(), PortMessages(), PortMessages())


def by_boards(items, name):
    return in_formats(items, *(make_encoder(name, 1e6, 0) for _ in STREAMS))


def with_header_in_the_middle(items, header):
    """Add a board's header to a chunk of the skin in the quiet before the first poke."""
    at = [number for number, item in enumerate(items) if isinstance(item, Chunk) and item.link == "skin"][3]
    return [dataclasses.replace(item, data=header + item.data) if number == at else item for number, item in enumerate(items)]


def status_in_the_middle(items):
    """The Net F/T says in some records that it is saturated, and one record repeats a sample."""
    found, number = [], 0
    for item in items:
        if isinstance(item, Chunk) and item.link == "wrench":
            number += 1
            data = bytearray(item.data)
            if number in (30, 31):
                data[-28:-24] = bytes.fromhex("80020000")
            if number == 60:
                data[-32:-28] = data[-41 - 32 : -41 - 28]
            item = dataclasses.replace(item, data=bytes(data))
        found.append(item)
    return found


def without(items, link, share, seed=7):
    """Leave out some chunks of a link by chance."""
    rng = np.random.default_rng(seed)
    return [item for item in items if not (isinstance(item, Chunk) and item.link == link and rng.random() < share)]


def in_pairs(items, link):
    """Let each two chunks of a link arrive as one, with the second."""
    found, kept = [], None
    for item in items:
        if not (isinstance(item, Chunk) and item.link == link):
            found.append(item)
        elif kept is None:
            kept = item
        else:
            found.append(dataclasses.replace(item, data=kept.data + item.data))
            kept = None
    return found


def delayed(items, link, by_ns):
    """Let all chunks of a link arrive later, in the order of arrival."""
    moved = [
        dataclasses.replace(item, host_ns=item.host_ns + by_ns) if isinstance(item, Chunk) and item.link == link else item
        for item in items
    ]
    return sorted(moved, key=lambda item: item.host_ns)


def cut_anywhere(items):
    """Cut the bytes of the wrench within its records."""
    found, rest = [], b""
    for item in items:
        if isinstance(item, Chunk) and item.link == "wrench":
            data = rest + item.data
            found.append(dataclasses.replace(item, data=data[:-7]))
            rest = data[-7:]
        else:
            found.append(item)
    return found


def damaged(items):
    """Turn a bit in every forty-first item: by turns in a chunk of each link."""
    return [
        dataclasses.replace(item, data=item.data[:9] + bytes([item.data[9] ^ 4]) + item.data[10:])
        if isinstance(item, Chunk) and at % 41 == 11
        else item
        for at, item in enumerate(items)
    ]


def lost_and_back(items):
    """The skin's link is lost in the middle and comes back two seconds later."""
    half = len(items) // 2
    at_ns = items[half].host_ns
    back_ns = at_ns + 2_000_000_000
    events = [LinkEvent("skin", at_ns, LinkState.LOST, "unplugged"), LinkEvent("skin", back_ns, LinkState.OPEN)]
    others = [
        item for item in items if not (isinstance(item, Chunk) and item.link == "skin" and at_ns <= item.host_ns < back_ns)
    ]
    return sorted([*others, *events], key=lambda item: item.host_ns)


def plain(scene):
    return some_pokes(scene, 3)


RECORDINGS: dict[str, Callable] = {
    "pokes": lambda scene: as_items(plain(scene)),
    "arm turns": lambda scene: as_items(turned(scene)),
    "pauses": lambda scene: as_items(in_gaps(scene)),
    "lost wrenches": lambda scene: without(as_items(plain(scene)), "wrench", 0.2),
    "lost frames": lambda scene: without(as_items(plain(scene)), "skin", 0.2),
    "late wrench": lambda scene: delayed(as_items(plain(scene)), "wrench", 120 * MS),
    "far too late wrench": lambda scene: delayed(as_items(plain(scene)), "wrench", 300 * MS),
    "late joints": lambda scene: delayed(as_items(turned(scene)), "joints", 900 * MS),
    "clock starts again": lambda scene: as_items(plain(scene), clock_jump_at=80),
    "frozen sensor": lambda scene: as_items(plain(scene), frozen=range(60, 140)),
    "cut records": lambda scene: cut_anywhere(as_items(plain(scene))),
    "damaged records": lambda scene: damaged(as_items(plain(scene))),
    "lost link": lambda scene: lost_and_back(as_items(plain(scene))),
}

OTHER_DEVICES: dict[str, tuple[tuple[LinkSpec, ...], Callable]] = {
    "makers": (MAKER_LINKS, lambda scene: by_makers(as_items(turned(scene)))),
    "makers, lost wrenches": (MAKER_LINKS, lambda scene: without(by_makers(as_items(plain(scene))), "wrench", 0.05)),
    "makers, lost frames": (MAKER_LINKS, lambda scene: without(by_makers(as_items(plain(scene))), "skin", 0.1)),
    "makers, frames in pairs": (MAKER_LINKS, lambda scene: in_pairs(by_makers(as_items(plain(scene))), "skin")),
    "makers, cut records": (MAKER_LINKS, lambda scene: cut_anywhere(by_makers(as_items(plain(scene))))),
    "makers, frozen": (MAKER_LINKS, lambda scene: by_makers(as_items(plain(scene), frozen=range(60, 140)))),
    "makers, status": (MAKER_LINKS, lambda scene: status_in_the_middle(by_makers(as_items(plain(scene))))),
    "text": (links_of("text", "text", "text"), lambda scene: by_boards(as_items(plain(scene)), "text")),
    "records as text, damaged": (
        links_of("skt", "skt", "skt"),
        lambda scene: damaged(by_boards(as_items(plain(scene)), "skt")),
    ),
    "a unit, as text": (
        links_of("skt", "skt", "skt"),
        lambda scene: with_header_in_the_middle(
            by_boards(as_items(plain(scene)), "skt"), make_encoder("skt", 1e6, 0).header(0, "kind=taxel,n=24,unit=N", 24)
        ),
    ),
    "a unit": (
        LINKS,
        lambda scene: with_header_in_the_middle(
            as_items(plain(scene)), make_encoder("skb", 1e6, 0).header(0, "kind=taxel,n=24,unit=N", 24)
        ),
    ),
    "no clock and no numbers, damaged": (
        links_of("robotiq", "skb", "skb"),
        lambda scene: damaged(in_formats(as_items(plain(scene)), RobotiqEncoder(), SkbEncoder("f32"), SkbEncoder("f32"))),
    ),
    "temperature": (
        links_of("bota", "skb", "skb"),
        lambda scene: in_formats(as_items(plain(scene)), WarmingSensor(), SkbEncoder("f32"), SkbEncoder("f32")),
    ),
    "formats to be found": (links_of("auto", "auto", "auto"), lambda scene: by_boards(as_items(plain(scene)), "skt")),
}
RECORDINGS_AND_LINKS = {name: (LINKS, make) for name, make in RECORDINGS.items()} | OTHER_DEVICES


@pytest.fixture
def _fixed_clock(monkeypatch):
    """Journals that begin at the same time of day."""

    class Clock:
        monotonic_ns = staticmethod(lambda: START_NS)
        time_ns = staticmethod(lambda: 1_700_000_000_000_000_000)

    monkeypatch.setattr(writer, "time", Clock)


class Observed(Pipeline):
    """A pipeline that notes when each outcome came, and the events of the journal."""

    def __init__(self, *args) -> None:
        super().__init__(*args)
        self.seen: list[tuple[object, ...]] = []

    def _commit(self, item, outcomes):
        self.seen += [(item, outcome_key(outcome)) for outcome in outcomes]
        super()._commit(item, outcomes)


def fed(scene, items, folder: Path | None, blocks=None, links=LINKS):
    """Feed items one by one, or in blocks of so many; return the pipeline."""
    journal = None if folder is None else writer.create_session(folder, scene, links)
    pipeline = Observed(scene, links, None, journal)
    if blocks is None:
        for item in items:
            if isinstance(item, Tick):
                pipeline.tick(item.host_ns)
            else:
                pipeline.feed(item)
    else:
        at = 0
        while at < len(items):
            count = next(blocks)
            pipeline.feed_many(items[at : at + count])
            at += count
    return pipeline


def assert_same(many, alone):
    assert many.seen == alone.seen
    assert repr(many.totals()) == repr(alone.totals())
    now_ns = alone._now_ns
    assert many._now_ns == now_ns
    one, other = many.live(now_ns), alone.live(now_ns)
    assert one.links == other.links
    assert (one.losses_unpaired, one.pose, one.progress.phase) == (other.losses_unpaired, other.pose, other.progress.phase)
    assert one.wrench.tobytes() == other.wrench.tobytes()
    assert one.wrench_s.tobytes() == other.wrench_s.tobytes()
    assert one.skin.tobytes() == other.skin.tobytes()
    assert many.before_pokes == alone.before_pokes
    assert many.freeze_findings() == alone.freeze_findings()
    assert same_estimates(many.snapshot(), alone.snapshot())


@pytest.mark.parametrize("name", RECORDINGS_AND_LINKS)
@pytest.mark.usefixtures("_fixed_clock")
def test_hard_recordings_fed_in_blocks_leave_the_same_session_and_bytes(name, tmp_path):
    scene = write_scene(tmp_path / "scene")
    with_arm = an_arm(scene)
    links, make = RECORDINGS_AND_LINKS[name]
    items = make(with_arm)
    alone = fed(with_arm, items, tmp_path / "a" / "s", links=links)
    assert alone.seen
    sizes = (2, 61, 100_000) if name in RECORDINGS else (61,)
    with contextlib.closing(alone):
        for size in sizes:
            with contextlib.closing(fed(with_arm, items, tmp_path / str(size) / "s", itertools.repeat(size), links)) as many:
                assert_same(many, alone)
    for size, kind in itertools.product(sizes, ("mcap", "jsonl")):
        path = f"s/segment-0001.{kind}"
        assert (tmp_path / str(size) / path).read_bytes() == (tmp_path / "a" / path).read_bytes(), (size, kind)


@given(st.data())
@settings(max_examples=6, deadline=None, suppress_health_check=[HealthCheck.too_slow])
def test_random_cuts_change_nothing(tmp_path_factory, data):
    scene = an_arm(write_scene(tmp_path_factory.mktemp("scene")))
    links, make = RECORDINGS_AND_LINKS[data.draw(st.sampled_from(list(RECORDINGS_AND_LINKS)))]
    items = make(scene)
    rng = np.random.default_rng(data.draw(st.integers(0, 2**32)))
    longest = data.draw(st.sampled_from([3, 20, 200]))
    alone = fed(scene, items, None, links=links)
    assert_same(fed(scene, items, None, (int(count) for count in rng.integers(1, longest, len(items))), links), alone)


def test_blocks_are_decoded_together_and_not_chunk_by_chunk(tmp_path, monkeypatch):
    """Without a journal nothing is due, so only events are fed alone."""
    scene = an_arm(write_scene(tmp_path / "scene"))
    items, single = as_items(plain(scene)), []
    feed = Pipeline.feed
    monkeypatch.setattr(pipeline_module.Pipeline, "feed", lambda self, item: (single.append(item), feed(self, item))[1])
    fed(scene, items, None, itertools.repeat(100))
    assert all(isinstance(item, LinkEvent) for item in single)
    assert len(single) == len(LINKS)


def test_a_fault_in_the_middle_of_a_block_loses_no_bytes(tmp_path, monkeypatch):
    scene = write_scene(tmp_path / "scene")
    items, calls = as_items(plain(scene))[:60], itertools.count()
    feed = ContactDetector.feed

    def fail_once(self, *sample):
        if next(calls) == 4:
            raise ZeroDivisionError
        return feed(self, *sample)

    monkeypatch.setattr(ContactDetector, "feed", fail_once)
    pipeline = Pipeline(scene, LINKS, None, writer.create_session(tmp_path / "s", scene, LINKS))
    with pytest.raises(ZeroDivisionError):
        pipeline.feed_many(items)
    pipeline.close()
    kept = [item for item in SessionLog(tmp_path / "s").items() if isinstance(item, Chunk)]
    assert kept == [item for item in items if isinstance(item, Chunk)]


def test_a_recorded_session_in_blocks_is_replayed(tmp_path):
    scene = write_scene(tmp_path / "scene")
    many = fed(scene, as_items(plain(scene)), tmp_path / "s", itertools.repeat(97))
    many.close()
    assert same_estimates(replay(tmp_path / "s").snapshot(), many.snapshot())


def test_items_of_an_unknown_link_are_refused_after_those_before_them(tmp_path):
    scene = write_scene(tmp_path / "scene")
    items = as_items(plain(scene))
    pipeline = Pipeline(scene, LINKS, None)
    with pytest.raises(pipeline_module.InputError, match="other"):
        pipeline.feed_many([*items[:50], Chunk("other", START_NS, b"")])
    assert repr(pipeline.totals()) == repr(fed(scene, items[:50], None).totals())


def test_ticks_alone_are_no_items(tmp_path):
    """All boards are silent for a block."""
    scene = write_scene(tmp_path / "scene")
    items = as_items(plain(scene))
    ticks: list[Chunk | LinkEvent | Tick] = [Tick(START_NS + number * MS) for number in range(3)]
    silent = Pipeline(scene, LINKS, None)
    silent.feed_many([*ticks, *items, *ticks])
    silent.feed_many(ticks)
    alone = fed(scene, items, None)
    assert silent.freeze_findings() == alone.freeze_findings()
    assert (silent._begin_ns, silent._now_ns) == (alone._begin_ns, alone._now_ns)
    assert same_estimates(silent.snapshot(), alone.snapshot())
