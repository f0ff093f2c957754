"""Whole sessions over makers' devices: each simulated device speaks its protocol over the real transport to the real reader."""

import os
import queue
import threading
import time
from collections import Counter
from contextlib import closing, contextmanager
from dataclasses import replace

import numpy as np
import pytest

from skincal.contacts.outcome import Contact
from skincal.model.errors import InputError
from skincal.model.readings import Chunk, LinkEvent, LinkState, Loss, Stream
from skincal.session.pipeline import Pipeline
from skincal.simulate.device import Clock, DeviceSettings, DeviceTimeline, LossyLink, SimulatedDevice
from skincal.simulate.faults import RigErrors
from skincal.simulate.maker_outlets import MakerOutlets, RdtOutlet, TalkOutlet
from skincal.simulate.makers import MAKERS, assign
from skincal.simulate.operator import Auto, Habits
from skincal.simulate.serve import Server
from skincal.streams.intake import Intake
from skincal.streams.links import LinkSpec, Reader
from tests.skincal.sim_support import make_rig

PTYS = hasattr(os, "openpty")
WRENCHES = ("netft", "bota", "robotiq", "robotiq-text", "rtde", "yarp")
SKINS = ("xela", "papillarray", "yarp")
SERIAL = ("bota", "robotiq", "papillarray")
PATIENCE_S = 10.0
POKES = 2


def make_line(name="flat-patch", speakers=None, pokes=None):
    rig = make_rig(RigErrors.none(), 1, name)
    rng = np.random.default_rng(1)
    habits = Habits.careful().at_pace(4.0)
    return DeviceTimeline(rig, Auto(rig, habits, rng, pokes), rng, DeviceSettings(speakers=speakers or {}))


@contextmanager
def serving(line, *, tcp=False):
    stop = threading.Event()
    with closing(Server(line, tcp=tcp)) as server:
        thread = threading.Thread(target=server.run, args=(stop,))
        thread.start()
        try:
            yield server
        finally:
            stop.set()
            thread.join(PATIENCE_S)
            assert not thread.is_alive()


@contextmanager
def reading(links, items=None):
    items = queue.SimpleQueue() if items is None else items
    readers = [Reader(link, items) for link in links]
    for reader in readers:
        reader.start()
    try:
        yield items
    finally:
        for reader in readers:
            reader.stop()


def readings_of(intake, items, want, seconds=PATIENCE_S):
    """Feed an intake until each link has so many readings; return the health of each link."""
    end = time.monotonic() + seconds
    while time.monotonic() < end:
        item = items.get(timeout=seconds)
        assert not isinstance(item, LinkEvent) or item.state is LinkState.OPEN, item
        intake.feed(item)
        health = intake.health(time.monotonic_ns())
        if all(link.readings >= want for link in health):
            return health
    raise AssertionError(intake.health(time.monotonic_ns()))


@pytest.mark.parametrize("maker", MAKERS)
@pytest.mark.parametrize("tcp", [True, False])
def test_each_device_is_read_over_its_transport(maker, tcp):
    if maker in SERIAL and not tcp and not PTYS:
        pytest.skip("this platform has no pseudo-terminals")
    name = "icub-forearm" if Stream.JOINTS in MAKERS[maker].carries else "flat-patch"
    streams = tuple(Stream) if name == "icub-forearm" else (Stream.WRENCH, Stream.SKIN)
    line = make_line(name, assign((maker,), streams))
    with serving(line, tcp=tcp) as server:
        links = [link for link in server.links if link.carries[0] in MAKERS[maker].carries]
        channels = line.rig.scene.skin.channels
        with reading(links) as items:
            health = readings_of(Intake(channels, links), items, 50)
    assert [lost_on_the_way(link) for link in health] == [{}] * len(links)
    assert all(link.format for link in health)


def lost_on_the_way(health):
    """Losses but those of frames that were there before the wrench."""
    return {loss: count for loss, count in health.losses.items() if count and loss not in (Loss.UNPAIRED, Loss.LATE)}


class Orchestra:
    """One rig whose wrench and skin every kind of device sends at once, each over its own transport."""

    def __init__(self, wrenches, skins):
        self.line = make_line(pokes=POKES)
        self.outlets = {}
        makers = MakerOutlets(self.line.rig.scene.skin.channels)
        errors, rng = RigErrors.none(), np.random.default_rng(2)
        boards = []
        for stream, names in ((Stream.WRENCH, wrenches), (Stream.SKIN, skins)):
            for name in names:
                maker = MAKERS[name]
                link = f"{stream.value} {name}"
                way = LossyLink(0.001, errors, rng)
                hz = maker.hz or (500.0 if stream is Stream.WRENCH else 50.0)
                boards.append(SimulatedDevice(link, stream, hz, Clock(errors, rng), maker.encoder(), way, "", 0))
                self.outlets[link] = makers.open(name, stream, tcp=not PTYS)
        self.line._boards = boards
        self.links = {name: LinkSpec(name, outlet.address, (self.line.links[name],)) for name, outlet in self.outlets.items()}

    def play(self, brought):
        """Play to the end, and a little longer."""
        while not self.line.finished:
            self._step(brought)
        for _ in range(30):
            self._step(brought)

    def _step(self, brought):
        self._talk(brought)
        for at_ns, link, data in self.line.step():
            brought.now_ns, wanted = at_ns, brought.sizes[link] + len(data)
            self.outlets[link].write(data)
            end = time.monotonic() + PATIENCE_S
            while brought.sizes[link] < wanted:
                assert time.monotonic() < end, f"{link}: bytes were lost"
                brought.wait(0.1)

    def _talk(self, brought):
        """Let the devices answer until all are asked for readings."""
        while True:
            for outlet in self.outlets.values():
                outlet.poll()
            if brought.opened >= self.links.keys() and all(map(is_asked, self.outlets.values())):
                return
            brought.wait(0.01)

    def close(self):
        for outlet in self.outlets.values():
            outlet.close()


def is_asked(outlet):
    """Return whether a host gets what the device sends."""
    if isinstance(outlet, TalkOutlet):
        return any(talk.ready for talk in outlet._talks.values())
    return outlet._host is not None if isinstance(outlet, RdtOutlet) else getattr(outlet, "_streams", True)


class Brought:
    """What readers bring, stamped by the rig's clock. It stands while bytes travel: a busy machine changes nothing."""

    def __init__(self):
        self.items, self.opened, self.sizes, self.now_ns = [], set(), Counter(), 0
        self._came = threading.Event()

    def put(self, item):
        self.items.append(replace(item, host_ns=self.now_ns))
        if isinstance(item, Chunk):
            self.sizes[item.link] += len(item.data)
        elif item.state is LinkState.OPEN:
            self.opened.add(item.link)
        self._came.set()

    def wait(self, seconds):
        """Wait until something comes, so many seconds at most."""
        self._came.wait(seconds)
        self._came.clear()


@pytest.fixture(scope="module")
def played():
    """What all links brought while the operator poked, and the rig."""
    orchestra, brought = Orchestra(WRENCHES, SKINS), Brought()
    with closing(orchestra), reading(orchestra.links.values(), brought):
        orchestra.play(brought)
    return orchestra, brought.items


@pytest.mark.parametrize("skin", SKINS)
@pytest.mark.parametrize("wrench", WRENCHES)
def test_a_session_over_each_pair_finds_the_pokes(played, wrench, skin):
    orchestra, brought = played
    links = (orchestra.links[f"wrench {wrench}"], orchestra.links[f"skin {skin}"])
    pipeline = Pipeline(orchestra.line.rig.scene, links, None, None)
    for item in brought:
        if item.link in {link.name for link in links}:
            pipeline.feed(item)
            pipeline.tick(item.host_ns)
    outcomes = [record.outcome for record in pipeline.snapshot().pokes]
    assert len(outcomes) == POKES, pipeline.live(0).links
    assert all(isinstance(outcome, Contact) for outcome in outcomes), outcomes
    for link in pipeline.live(0).links:
        assert link.state is LinkState.OPEN
        assert lost_on_the_way(link) == {}


def test_events_and_bytes_alone_make_the_same_readings_again(played):
    """What is journalled, chunks and events, plays to the same samples: no talk, no port."""
    orchestra, brought = played
    links = (orchestra.links["wrench netft"], orchestra.links["skin yarp"])
    kept = [item for item in brought if item.link in {link.name for link in links}]
    assert any(isinstance(item, Chunk) for item in kept)
    first, second = (Intake(orchestra.line.rig.scene.skin.channels, links) for _ in range(2))
    samples = [[s for item in kept for s in intake.feed(item)] for intake in (first, second)]
    assert len(samples[0]) > 50
    made = [[(each.host_s, each.wrench.tolist(), each.skin.tolist()) for each in course] for course in samples]
    assert made[0] == made[1]


def test_who_sends_what():
    streams = tuple(Stream)
    assert assign(("rtde", "xela"), streams) == {Stream.WRENCH: "rtde", Stream.JOINTS: "rtde", Stream.SKIN: "xela"}
    assert assign(("netft", "yarp"), streams) == {Stream.WRENCH: "netft", Stream.SKIN: "yarp", Stream.JOINTS: "yarp"}
    with pytest.raises(InputError, match="expected some of netft"):
        assign(("optoforce",), streams)
    with pytest.raises(InputError, match="none that no other"):
        assign(("netft", "bota"), streams)
