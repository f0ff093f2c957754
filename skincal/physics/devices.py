"""The robot's sensors as bytes of boards (SKB/1): force/torque sensor, skin and joints."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from skincal.geometry import FloatArray
from skincal.model.readings import Stream
from skincal.physics.engine import PERIOD_S
from skincal.physics.rig import SimulatedRobot
from skincal.simulation.boards import (
    BOARD_CLOCK_WRAP_US,
    BOARD_HEADER_PERIOD_S,
    US_PER_S,
    board_encoder,
    board_headers,
    encode_header,
)

CONTROL_PERIODS_PER_SENT_BLOCK = 5
BLOCK_S = CONTROL_PERIODS_PER_SENT_BLOCK * PERIOD_S
"""s of readings that are sent together; also the time between two skin frames: 50 Hz, as in the paper (section III-B)."""
CONTROL_PERIODS_PER_JOINT_RECORD = 2
"""Periods between two records of the joints: 125 Hz."""


class RobotDevices:
    """Collects the readings of a robot after each of its periods, and encodes them in blocks."""

    block_s = BLOCK_S
    emulated: Mapping[Stream, str] = {}

    def __init__(self, robot: SimulatedRobot) -> None:
        self._robot = robot
        scene = robot.scene
        self.channels = scene.skin.channels
        rates = {
            Stream.WRENCH: 1 / PERIOD_S,
            Stream.SKIN: 1 / BLOCK_S,
            Stream.JOINTS: 1 / (CONTROL_PERIODS_PER_JOINT_RECORD * PERIOD_S),
            Stream.TOOL: 1 / (CONTROL_PERIODS_PER_JOINT_RECORD * PERIOD_S),
        }
        top = (scene.skin.range or (0.0, 255.0))[1] if scene.skin.axes is None else np.inf
        self._headers = board_headers(scene, rates, top, rises=scene.skin.polarity > 0)
        self._encoders = {
            stream: board_encoder("skb", stream, top if stream is Stream.SKIN else 255.0, header.width)
            for stream, header in self._headers.items()
        }
        self._periods = 0
        self._readings: dict[Stream, list[tuple[int, FloatArray]]] = {stream: [] for stream in self._headers}
        self._next_header_s = 0.0
        self.now = 0.0
        """s, end of the encoded time."""
        robot.add_listener(self._collect)

    @property
    def links(self) -> dict[str, Stream]:
        """Name of each link and its stream."""
        return {stream.value: stream for stream in self._headers}

    @property
    def is_block_full(self) -> bool:
        return self._periods > 0 and self._periods % CONTROL_PERIODS_PER_SENT_BLOCK == 0

    def _collect(self) -> None:
        self._periods += 1
        time_us = round(self._periods * PERIOD_S * US_PER_S) % BOARD_CLOCK_WRAP_US
        if Stream.WRENCH in self._headers:
            self._readings[Stream.WRENCH].append((time_us, self._robot.reading))
        if self._periods % CONTROL_PERIODS_PER_SENT_BLOCK == 0:
            self._readings[Stream.SKIN].append((time_us, self._robot.skin_frame()))
        if self._periods % CONTROL_PERIODS_PER_JOINT_RECORD == 0 and Stream.TOOL in self._headers:
            self._readings[Stream.TOOL].append((time_us, self._robot.pose_record()))
        if self._periods % CONTROL_PERIODS_PER_JOINT_RECORD == 0 and Stream.JOINTS in self._headers:
            self._readings[Stream.JOINTS].append((time_us, np.degrees(self._robot.joint_record())))

    def greeting(self, link: str) -> bytes:
        """Return the header that a board sends when a host connects or asks."""
        stream = Stream(link)
        return encode_header(self._encoders[stream], self._headers[stream], round(self.now * US_PER_S))

    def advance(self) -> list[tuple[int, str, bytes]]:
        """Encode the readings since the last call: (simulated nanoseconds, link, bytes)."""
        sent: list[tuple[int, str, bytes]] = []
        has_header = self.now >= self._next_header_s
        self.now = self._periods * PERIOD_S
        for stream, encoder in self._encoders.items():
            data = self.greeting(stream.value) if has_header else b""
            readings, self._readings[stream] = self._readings[stream], []
            if readings:
                times, values = zip(*readings, strict=True)
                data += b"".join(encoder.encode(stream, np.array(times), np.array(values)))
            if data:
                sent.append((round(self.now * 1e9), stream.value, data))
        if has_header:
            self._next_header_s += BOARD_HEADER_PERIOD_S
        return sent
