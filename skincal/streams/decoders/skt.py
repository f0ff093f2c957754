"""SKT/1: text records of makers' devices.

One record a line, LF or CRLF, at most 4096 bytes, each ending with `*` and four upper-case hex digits, the
CRC-16/CCITT-FALSE of every byte before the `*`; lines that start with `#` are comments:

    H,skt1,key=value,...                                header
    T,<seq>,<t_us>,<v0>,...,<v(n-1)>                    skin, `nan` where a taxel is dead
    F,<seq>,<t_us>,<fx>,<fy>,<fz>,<tx>,<ty>,<tz>,<status>   wrench, N and N m; status bit 0 saturated, bit 1 invalid
    J,<seq>,<t_us>,<a0>,...                             joint angles, degrees
    P,<seq>,<t_us>,<x>,<y>,<z>                          position of the tip, metres, in a fixed frame
    P,<seq>,<t_us>,<x>,<y>,<z>,<qx>,<qy>,<qz>,<qw>      pose of the tool, metres and quaternion, in a fixed frame
    E,<code>,<text>                                     an error of the device

Other records are skipped. `seq` counts each letter alone.
"""

from __future__ import annotations

import binascii
from typing import ClassVar

from skincal.devices.decoding import (
    CLOCK_MODULUS_US,
    CRC_CCITT_INITIAL_VALUE,
    SEQ_MODULUS,
    WRENCH_VALUES,
    DeviceTime,
    FrameDecoder,
    SequenceCounter,
)
from skincal.model.pose_form import PoseForm, RotationForm
from skincal.model.readings import Loss, Stream

LINE_MAX_BYTES = 4096
"""Bytes. The longest line of the protocol."""
CHECKSUM_TAIL_BYTES = 5
"""`*` and the checksum."""
STREAM_OF_LETTER = {b"T": Stream.SKIN, b"F": Stream.WRENCH, b"J": Stream.JOINTS, b"P": Stream.TIP}
FIELDS_BEFORE_VALUES = 3
"""Fields before the values: letter, seq, t_us."""


class SktDecoder(FrameDecoder):
    """Decodes SKT/1."""

    name: ClassVar[str] = "SKT/1"
    mark: ClassVar[bytes] = b"\n"
    limit: ClassVar[int] = LINE_MAX_BYTES
    defined_pose: ClassVar[PoseForm | None] = PoseForm(RotationForm.QUATERNION_XYZW)

    def __init__(self, channels: int | None, carries: tuple[Stream, ...]) -> None:
        super().__init__(channels, carries)
        self._time = DeviceTime()
        self._sequences = {stream: SequenceCounter() for stream in Stream}

    def _decode(self, frame: bytes) -> Loss | None:
        line = frame.removesuffix(b"\r")
        if not line or line.startswith(b"#"):
            return None
        text, tail = line[:-CHECKSUM_TAIL_BYTES], line[-CHECKSUM_TAIL_BYTES:]
        if tail != b"*%04X" % binascii.crc_hqx(text, CRC_CCITT_INITIAL_VALUE):
            return Loss.BAD_CHECKSUM
        # Before the record is read: its checksum proves the format, independent of the record.
        self.valid_records += 1
        return self._record(text)

    def _record(self, text: bytes) -> Loss | None:
        letter, _, rest = text.partition(b",")
        stream = STREAM_OF_LETTER.get(letter)
        if stream is Stream.TIP and Stream.TOOL in self._carries:
            stream = Stream.TOOL
        if stream is not None:
            return self._reading(stream, text.split(b","))
        if letter == b"H":
            self._read_header(rest.decode(errors="replace"))
        elif letter == b"E":
            self._problem = f"The board reports error {rest.decode(errors='replace')}"
        return None

    def _reading(self, stream: Stream, fields: list[bytes]) -> Loss | None:
        try:
            raw_seq, raw_us = int(fields[1]), int(fields[2])
            values = [float(field) for field in fields[FIELDS_BEFORE_VALUES:]]
            status = 0
            if stream is Stream.WRENCH and len(values) == WRENCH_VALUES + 1:
                values.pop()
                status = int(fields[-1])
        except (ValueError, IndexError):
            return Loss.UNREADABLE
        if not (0 <= raw_seq < SEQ_MODULUS and 0 <= raw_us < CLOCK_MODULUS_US):
            return Loss.UNREADABLE
        device_s = self._time.unwrap(raw_us)
        seq, missing = self._sequences[stream].unwrap(raw_seq, device_s)
        self._count_missing(missing)
        return self._add(stream, seq, device_s, values, status)
