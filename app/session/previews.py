"""Previews of links before a recording. No Qt, and nothing waits here."""

from __future__ import annotations

import time
from collections import deque
from collections.abc import Mapping
from dataclasses import dataclass
from typing import TypeAlias

import numpy as np

from skincal.devices.link import LinkError
from skincal.geometry import FloatArray
from skincal.model.errors import InputError
from skincal.model.readings import Batch, Chunk, LinkEvent, LinkHealth, Stream
from skincal.model.scene import Scene
from skincal.streams.expected_readings import ExpectedReadings
from skincal.streams.intake import LinkIntake
from skincal.streams.links import ChunkQueue, LinkSpec, Reader, describe_links, yarp_ports
from skincal.streams.ros_topics import FoundTopic, list_ros_topics
from skincal.streams.transports.serial_port import list_serial_ports

PREVIEW_CURVE_POINTS = 80  # Points of a small curve: eight seconds at ten updates per second
CHANGE_UNIT_OF_STREAM = {Stream.SKIN: 1.0, Stream.JOINTS: float(np.degrees(1.0)), Stream.TIP: 1000.0, Stream.TOOL: 1000.0}
"""Unit of the shown change over that of the readings."""
POSITION_COLUMNS = [3, 7, 11]
"""Columns of the position in the upper rows of a 4 x 4 pose."""
MAX_WORK_PER_LINK_UPDATE_S = 0.010  # Limit of work per update and link; the rest waits


def list_ports() -> list[tuple[str, str]]:
    """List address and description of serial ports, and of YARP ports if a name server answers; may take seconds."""
    try:
        ports = [(f"yarp:{name}", f"YARP port at {host}:{number}") for name, (host, number) in yarp_ports()]
    except LinkError:
        ports = []
    return [*list_serial_ports(), *ports]


def list_topics() -> tuple[list[FoundTopic], str]:
    """List the topics of ROS 2 that can be read, and a sentence if some or all are missing; takes two seconds."""
    try:
        found, left_out = list_ros_topics()
    except InputError as error:
        return [], str(error)
    return found, f"{left_out} more topics of ROS 2 are not listed; type their addresses." if left_out else ""


def list_trackers() -> list[tuple[str, str]]:
    """List address and description of the optical trackers that answer a broadcast; takes half a second."""
    from skincal.streams.tracker_search import find_trackers  # only parts that a tool pokes need it

    return find_trackers()


@dataclass(frozen=True, slots=True)
class Preview:
    """Live preview of one stream: its newest readings and state."""

    health: LinkHealth
    now_ns: int
    """Time of the update, host's monotonic clock."""
    curve: tuple[float, ...]
    """Newest value of each update: force in N, largest change of a raw value, largest joint motion in degrees, or largest
    motion of tip or tool along an axis in mm."""
    frames: tuple[FloatArray, ...] = ()
    """Readings of the last update, (n,) float each; raw values of a skin, radians of joints."""


class _Preview:
    """Reader and decoder of one previewed link."""

    def __init__(self, spec: LinkSpec, expected: ExpectedReadings) -> None:
        self._inbox, self._intake = ChunkQueue(), LinkIntake(expected, spec)
        self._first: dict[Stream, FloatArray] = {}
        self._now: dict[Stream, float] = {}
        self._frames: dict[Stream, list[FloatArray]] = {stream: [] for stream in spec.carries}
        self._curves: dict[Stream, deque[float]] = {stream: deque(maxlen=PREVIEW_CURVE_POINTS) for stream in spec.carries}
        self.reader = Reader(spec, self._inbox)
        self.reader.start()

    def update(self) -> None:
        end_s = time.perf_counter() + MAX_WORK_PER_LINK_UPDATE_S
        self._now.clear()
        for frames in self._frames.values():
            frames.clear()
        while not self._inbox.empty() and time.perf_counter() < end_s:
            item: Chunk | LinkEvent = self._inbox.get()
            for arrived in self._intake.feed(item):
                self._take_batch(arrived.batch)
        for stream, value in self._now.items():
            self._curves[stream].append(value)

    def _take_batch(self, batch: Batch) -> None:
        stream, newest = batch.stream, batch.values[-1]
        self._frames[stream].extend(batch.values)
        if stream is Stream.WRENCH:
            self._now[stream] = float(np.linalg.norm(newest[:3]))
            return
        if stream is Stream.TOOL:
            newest = newest[POSITION_COLUMNS]
            if not np.isfinite(newest).all():
                return
        first = self._first.setdefault(stream, newest)
        if len(first) == len(newest):
            change = float(np.nanmax(np.abs(newest - first), initial=0.0))
            self._now[stream] = CHANGE_UNIT_OF_STREAM[stream] * change

    def stream_preview(self, stream: Stream) -> Preview:
        now_ns = time.monotonic_ns()
        return Preview(self._intake.health(now_ns), now_ns, tuple(self._curves[stream]), tuple(self._frames[stream]))


_Key: TypeAlias = tuple[LinkSpec, ExpectedReadings]


class Previews:
    """Links of a dialog that is being filled in."""

    def __init__(self) -> None:
        self._open: dict[_Key, _Preview] = {}
        self._ending: list[Reader] = []
        self._closed = False

    def choose(self, addresses: Mapping[Stream, str], scene: Scene | None) -> None:
        """Preview the devices at these addresses and no others; returns at once, and does nothing after `stop_readers`.

        Without a scene nothing is previewed, since it defines the expected numbers of values.

        Raises
        ------
        InputError
            An address has an unknown form.
        """
        if scene is None:
            self.choose_expected({}, ExpectedReadings(1))
        else:
            self.choose_expected(addresses, ExpectedReadings.of_scene(scene))

    def choose_expected(self, addresses: Mapping[Stream, str], expected: ExpectedReadings) -> None:
        """Preview the devices at these addresses with the expected values of their readings; see `choose`."""
        if self._closed:
            return
        wanted: set[_Key] = {(spec, expected) for spec in describe_links(addresses)}
        for gone in self._open.keys() - wanted:
            self._end(gone)
        for new in wanted - self._open.keys():
            self._open[new] = _Preview(*new)

    def update(self) -> dict[Stream, Preview]:
        """Process new readings and give the preview of each stream."""
        self._ending = [reader for reader in self._ending if reader.running]
        for preview in self._open.values():
            preview.update()
        return {stream: preview.stream_preview(stream) for (spec, *_), preview in self._open.items() for stream in spec.carries}

    def stop_readers(self) -> list[Reader]:
        """Close every link for good; another thread must wait for the returned readers."""
        self._closed = True
        for each in list(self._open):
            self._end(each)
        return self._ending

    def _end(self, each: _Key) -> None:
        reader = self._open.pop(each).reader
        reader.halt()
        self._ending.append(reader)
