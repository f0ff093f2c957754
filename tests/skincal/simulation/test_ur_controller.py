"""A simulated UR controller: wrench and pose of the tool by one link, from its packets to positions, and over loopback."""

from __future__ import annotations

import threading
import time
from contextlib import closing

import numpy as np
import pytest

from skincal.cli.simulate import _speakers
from skincal.mesh.load import load_surface
from skincal.model.readings import SESSION_START_TIME_NS, Batch, Chunk, LinkEvent, LinkState, Stream
from skincal.model.scene import load_scene, resource
from skincal.session.pipeline import Pipeline
from skincal.simulation.boards import board_headers
from skincal.simulation.device import DeviceSettings, DeviceTimeline
from skincal.simulation.emulated_devices import ControllerTalk, RtdeController
from skincal.simulation.operator import AutoOperator, Habits
from skincal.simulation.rig_errors import RigErrors
from skincal.simulation.serve import Server
from skincal.simulation.simulated_rig import Rig
from skincal.streams.expected_readings import ExpectedReadings
from skincal.streams.intake import LinkIntake
from skincal.streams.links import ChunkQueue, LinkSpec, Reader, describe_links
from skincal.taxels.result import Method

POKES = 4
FIELDS = b"timestamp,ft_raw_wrench,actual_TCP_pose,tcp_offset"
OF_ROBOT = {Stream.WRENCH: "rtde", Stream.TOOL: "rtde"}


def timeline() -> DeviceTimeline:
    scene = load_scene(resource("scenes/cobot-forearm/scene.toml"))
    assert scene.surface is not None
    surface = load_surface(scene.surface)[0]
    streams = np.random.default_rng(1).spawn(3)
    rig = Rig(scene, surface, RigErrors.none(), streams[0])
    hand = AutoOperator(rig, Habits.careful().with_tool(), streams[1], POKES)
    return DeviceTimeline(rig, hand, streams[2], DeviceSettings(emulated=OF_ROBOT))


def test_packets_of_one_controller_give_positions():
    line = timeline()
    scene, surface = line.rig.scene, load_surface(line.rig.scene.surface)[0]
    links = [
        LinkSpec("robot", "rtde://ur", (Stream.WRENCH, Stream.TOOL), "rtde"),
        LinkSpec("skin", "simulated:skin", (Stream.SKIN,)),
    ]
    pipeline = Pipeline(scene, links, surface)
    for link in links:
        pipeline.feed(LinkEvent(link.name, SESSION_START_TIME_NS, LinkState.OPEN))
    controller, talk = RtdeController(), ControllerTalk()
    for stream in OF_ROBOT:
        controller.add_stream(stream)
    talk.on_request(b"\x00" + bytes([11 + len(FIELDS)]) + b"O" + bytes(8) + FIELDS)
    while not line.finished:
        for _, arrivals in line.advance_many(20):
            for at_ns, link, data in arrivals:
                is_skin = link == "skin"
                sent = data if is_skin else talk.frame(controller.join(Stream(link), data))
                if sent:
                    pipeline.feed(Chunk("skin" if is_skin else "robot", SESSION_START_TIME_NS + at_ns, sent))
    pipeline.close()
    snapshot = pipeline.snapshot()
    assert len(snapshot.contacts) >= POKES - 1
    rows = {channel: row for row, channel in enumerate(line.rig.channels.tolist())}
    errors = [
        np.linalg.norm(each.position - line.rig.places[rows[each.channel]])
        for each in snapshot.estimates[Method.SURFACE]
        if each.position is not None and each.channel in {contact.strongest_channel for contact in snapshot.contacts}
    ]
    # One poke of a hand that aims to 2 mm, and a skin 2.5 mm thick.
    assert len(errors) >= 3
    assert float(np.median(errors)) < 0.005


def test_one_address_gives_wrench_and_flange_over_loopback():
    line = timeline()
    stop = threading.Event()
    with closing(Server(line, tcp=True)) as server:
        address = {link.carries[0]: link.address for link in server.links}
        assert address[Stream.WRENCH] == address[Stream.TOOL]
        assert address[Stream.TOOL].startswith("rtde://127.0.0.1:")
        (spec,) = describe_links({stream: address[stream] for stream in OF_ROBOT})
        thread = threading.Thread(target=server.run, args=(stop,), daemon=True)
        thread.start()
        inbox = ChunkQueue()
        intake = LinkIntake(ExpectedReadings.of_scene(line.rig.scene), spec)
        reader = Reader(spec, inbox)
        reader.start()
        batches: dict[Stream, list[Batch]] = {stream: [] for stream in OF_ROBOT}
        end = time.monotonic() + 20.0
        try:
            while not all(batches.values()) and time.monotonic() < end:
                item = inbox.get()
                for arrived in intake.feed(item):
                    batches[arrived.batch.stream].append(arrived.batch)
        finally:
            stop.set()
            thread.join(10.0)
            reader.stop()
    wrench, pose = batches[Stream.WRENCH][0], batches[Stream.TOOL][0]
    assert wrench.device_s[0] == pose.device_s[0], "one clock"
    assert line.rig.tool is not None
    flange = line.rig.tool.reported(np.array([0.0]), np.random.default_rng(0))[0]
    assert pose.values[0][[3, 7, 11]] == pytest.approx(flange[:3], abs=1e-6), (
        "the tool centre point of the pendant is taken out"
    )


def test_the_command_gives_the_robot_what_the_scene_has():
    tool = load_scene(resource("scenes/cobot-forearm/scene.toml"))
    assert _speakers("rtde", tool) == {Stream.WRENCH: "rtde", Stream.TOOL: "rtde"}
    none = load_scene(resource("scenes/cobot-tip/scene.toml"))
    assert _speakers("rtde", none) == {Stream.TOOL: "rtde"}
    assert _speakers("rtde", load_scene(resource("scenes/flat-patch/scene.toml"))) == {Stream.WRENCH: "rtde"}


def test_a_rig_without_a_sensor_has_no_device_for_it():
    none = load_scene(resource("scenes/cobot-tip/scene.toml"))
    rates = dict.fromkeys(Stream, 100.0)
    assert set(board_headers(none, rates, 255.0, rises=True)) == {Stream.SKIN, Stream.TOOL}
    below = load_scene(resource("scenes/flat-patch/scene.toml"))
    assert set(board_headers(below, rates, 255.0, rises=True)) == {Stream.WRENCH, Stream.SKIN}
