"""Whole sessions over makers' devices: each simulated device speaks its protocol over the real transport to the real reader."""

import os
import select
import time
from contextlib import closing, contextmanager

import numpy as np
import pytest

from skincal.contacts.outcome import Contact
from skincal.model.errors import InputError
from skincal.model.readings import Chunk, LinkEvent, LinkState, Loss, Stream
from skincal.session.pipeline import Pipeline
from skincal.simulation.device import DeviceSettings, DeviceTimeline
from skincal.simulation.emulated_devices import MAKERS, assign_devices
from skincal.simulation.operator import AutoOperator, Habits
from skincal.simulation.outlets import PtyOutlet
from skincal.simulation.rig_errors import RigErrors
from skincal.simulation.serve import Server
from skincal.streams.expected_readings import ExpectedReadings
from skincal.streams.intake import Intake
from tests.skincal.meanwhile import meanwhile
from tests.skincal.sim_support import make_rig
from tests.skincal.simulation.orchestra_support import (
    FINGERS,
    NARROW_SKINS,
    PATIENCE_S,
    PTYS,
    SKINS,
    WRENCHES,
    Brought,
    Orchestra,
    pairs_of_each,
    reading,
)

SERIAL = tuple(name for name, maker in MAKERS.items() if maker.serial)
POKES = 2


def make_line(name="flat-patch", emulated=None, pokes=None):
    rig = make_rig(RigErrors.none(), 1, name)
    rng = np.random.default_rng(1)
    habits = Habits.careful().at_pace(4.0)
    return DeviceTimeline(rig, AutoOperator(rig, habits, rng, pokes), rng, DeviceSettings(emulated=emulated or {}))


@contextmanager
def serving(line, *, tcp=False):
    with closing(Server(line, tcp=tcp)) as server, meanwhile(server.run):
        yield server


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


@pytest.fixture
def _patient_ptys(monkeypatch):
    """Let pseudo-terminals wait for a reader whom a busy machine holds up: by themselves they lose bytes, as serial ports."""

    def write(outlet, data):
        poller = select.poll()
        poller.register(outlet._master, select.POLLOUT)
        while data and outlet._was_open:
            state = dict(poller.poll(100)).get(outlet._master, 0)
            if state & select.POLLHUP:
                return
            if state & select.POLLOUT:
                data = data[os.write(outlet._master, data) :]

    monkeypatch.setattr(PtyOutlet, "write", write)


@pytest.mark.usefixtures("_patient_ptys")
@pytest.mark.parametrize("maker", MAKERS)
@pytest.mark.parametrize("tcp", [True, False])
def test_each_device_is_read_over_its_transport(maker, tcp):
    if maker in SERIAL and not tcp and not PTYS:
        pytest.skip("this platform has no pseudo-terminals")
    if maker == "ros2":
        pytest.importorskip("cyclonedds", reason="the extra ros2 is not installed")
    if maker in FINGERS:
        pytest.skip("no shipped scene is as small: tests/skincal/simulation/test_guided_protocols.py reads it")
    name, streams = "flat-patch", (Stream.WRENCH, Stream.SKIN)
    if MAKERS[maker].carries == (Stream.TOOL,):
        name, streams = "cobot-wrist", (*streams, Stream.TOOL)
    elif Stream.JOINTS in MAKERS[maker].carries or maker in NARROW_SKINS:
        name, streams = "icub-forearm", tuple(Stream)
    line = make_line(name, assign_devices((maker,), streams))
    line.advance()  # the first block is slow, and a dialogue waits for no more than 0.8 s
    with serving(line, tcp=tcp) as server:
        links = [link for link in server.links if link.carries[0] in MAKERS[maker].carries]
        channels = line.rig.scene.skin.channels
        with reading(links) as items:
            health = readings_of(Intake(ExpectedReadings(channels), links), items, 50)
    assert [lost_on_the_way(link) for link in health] == [{}] * len(links)
    assert all(link.format for link in health)


def lost_on_the_way(health):
    """Losses but those of frames that were there before the wrench."""
    return {loss: count for loss, count in health.losses.items() if count and loss not in (Loss.UNPAIRED, Loss.LATE)}


@pytest.fixture(scope="module")
def played():
    """What all links brought while the operator poked, and the rig."""
    orchestra, brought = Orchestra(make_line(pokes=POKES), WRENCHES, SKINS), Brought()
    with closing(orchestra), reading(orchestra.links.values(), brought):
        orchestra.play(brought)
    return orchestra, brought.items


@pytest.mark.parametrize(("wrench", "skin"), pairs_of_each())
def test_a_session_over_each_kind_finds_the_pokes(played, wrench, skin):
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
    first, second = (Intake(ExpectedReadings(orchestra.line.rig.scene.skin.channels), links) for _ in range(2))
    samples = [[s for item in kept for s in intake.feed(item)] for intake in (first, second)]
    assert len(samples[0]) > 50
    made = [[(each.host_s, each.wrench.tolist(), each.skin.tolist()) for each in course] for course in samples]
    assert made[0] == made[1]


def test_who_sends_what():
    streams = tuple(Stream)
    of_robot = dict.fromkeys((Stream.WRENCH, Stream.JOINTS, Stream.TOOL), "rtde")
    assert assign_devices(("rtde", "xela"), streams) == of_robot | {Stream.SKIN: "xela"}
    assert assign_devices(("netft", "yarp"), streams) == {Stream.WRENCH: "netft", Stream.SKIN: "yarp", Stream.JOINTS: "yarp"}
    with pytest.raises(InputError, match="expected some of netft"):
        assign_devices(("optoforce",), streams)
    with pytest.raises(InputError, match="none that no other"):
        assign_devices(("netft", "bota"), streams)
