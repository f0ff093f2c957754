"""NDI trackers (Polaris, Aurora) by their text commands, over a serial port or TCP: the pose of one tool.

A command is its name, a colon, its words, a check sum of 4 hexadecimal digits, and a carriage return. An answer is text with
the same end. `TX:0001` answers with the number of tools (2 digits) and for each its handle (2), the pose, its state (8), its
frame (8), and a line feed; the system's state (4) ends it. A pose is q0 qx qy qz (sign and 5 digits, 1/10000), x y z (sign and
6 digits, 1/100 mm) and an error (1/10000 mm). `MISSING` or `DISABLED` stands for a lost tool; **its frame number goes on**.

The tracker is initialised first. The definition of a passive tool is written from a file (`?rom=FILE`), 64 bytes a command.
Then all tools are initialised and enabled, and tracking starts. The next pose is requested after the answer to the one before.

Sources: the maker's Polaris API guide, the public library ndicapi; the commands are those that ndicapi 3.7.6 sends, byte for
byte, and it decodes the answers to the same poses. No tracker was tried.
"""

from __future__ import annotations

import math
import re
from collections import deque
from collections.abc import Iterable
from dataclasses import replace
from pathlib import Path
from typing import ClassVar

import numpy as np

from skincal.devices.decoding import NO_SEQ, FrameDecoder, FrameSplitter, MarkSplitter
from skincal.devices.family import DeviceAddress, Family, Form, Handshake, HandshakeError, Questions, Route, Vector, over_tcp
from skincal.devices.link import FailureKind, LinkError
from skincal.devices.tracked_bodies import BodyChoice, write_options
from skincal.geometry import FloatArray
from skincal.model.pose_form import PoseForm, RotationForm
from skincal.model.readings import Loss, Stream

ANSWER_END = b"\r"
ANSWER_MAX_BYTES = 20_000
"""Bytes. 255 tools fit."""
CRC_BYTES = 4
CRC_POLYNOMIAL = 0xA001
OPTIONS_WORD = b"SKINCAL "
"""Begin of the line that the link puts before all answers: the options of the address."""
POSE_REQUEST = "TX:0001"
STOP_REQUEST = "TSTOP:"
"""First of all, for a tracker that another program left tracking; others refuse it."""
POLL_SILENCE_S = 0.008
"""s between an answer and the next request: trackers measure 20 to 400 poses a second."""
ANSWER_SILENCES_MAX = 250
"""Silences, 2 s: INIT takes seconds. Then a pose is requested again."""
POSE_REFUSALS_MAX = 100
"""Refusals in a row, about 1 s: a tracker may need a moment after it was started."""
ROM_CHUNK_BYTES, ROM_MIN_BYTES, ROM_MAX_BYTES = 64, 1024, 2048
_TOOL_RE = re.compile(
    rb"([0-9A-F]{2})(?:(?:[+-]\d{5}){4}(?:[+-]\d{6}){3}[+-]\d{5}|MISSING|DISABLED|UNOCCUPIED)(?:([0-9A-F]{8})([0-9A-F]{8}))?\n"
)
_POSES_RE = re.compile(rb"([0-9A-F]{2})((?:[0-9A-F]{2}[^\n]*\n)*)[0-9A-F]{4}")
_ERROR_WORDS = {
    "0C": "not possible in its present mode: end the other program that uses it",
    "12": "it cannot start tracking",
    "13": "the tool cannot be initialised: check its definition file",
}


def crc16(data: bytes) -> int:
    """Compute the check sum of a command or an answer (CRC-16, reflected, from 0)."""
    crc = 0
    for byte in data:
        crc ^= byte
        for _ in range(8):
            crc = crc >> 1 ^ (CRC_POLYNOMIAL if crc & 1 else 0)
    return crc


def with_crc(text: bytes) -> bytes:
    """Add check sum and end to a command or an answer."""
    return text + f"{crc16(text):04X}".encode() + ANSWER_END


def read_answer(line: bytes) -> bytes | None:
    """Return the text of an answer without its check sum, which must fit; else `None`."""
    text, crc = line[:-CRC_BYTES], line[-CRC_BYTES:]
    return text if len(line) > CRC_BYTES and crc == f"{crc16(text):04X}".encode() else None


def tool_definition(data: bytes, handle: str) -> list[str]:
    """Build the commands that write a tool's definition file, padded with zeros."""
    padded = data.ljust(ROM_MIN_BYTES, b"\0")
    padded = padded.ljust(-(-len(padded) // ROM_CHUNK_BYTES) * ROM_CHUNK_BYTES, b"\0")
    starts = range(0, len(padded), ROM_CHUNK_BYTES)
    return [f"PVWR:{handle}{start:04X}{padded[start : start + ROM_CHUNK_BYTES].hex().upper()}" for start in starts]


class NdiHandshake(Handshake):
    """Initialises the tracker and its tools, starts tracking, and asks for poses."""

    silence_s = POLL_SILENCE_S
    closing_bytes = with_crc(STOP_REQUEST.encode())

    def __init__(self, rom: bytes = b"") -> None:
        self._lines = MarkSplitter(ANSWER_END, ANSWER_MAX_BYTES)
        self._rom = rom
        find = ["PHRQ:*********1****"] if rom else []
        self._commands = deque([STOP_REQUEST, "INIT:", "PHSR:01", *find, "PHSR:02", "PHSR:03", "TSTART:"])
        self._asked = ""
        """Command without an answer yet; empty if there is none."""
        self._silences = 0
        self._refusals = 0
        """Requests for poses in a row that were refused."""

    def opening(self) -> bytes:
        return self._ask()

    def on_data(self, data: bytes) -> bytes:
        self._silences = 0
        request = b""
        for line in self._lines.split(data):
            asked, self._asked = self._asked, ""
            answer = None if line is None else read_answer(line)
            if answer is not None and asked:
                self._use(asked, answer.decode("ascii", "replace"))
            elif asked and asked != POSE_REQUEST:
                self._commands.appendleft(asked)  # the answer was damaged
            if self._commands:
                request = self._ask()
        return request

    def on_silence(self) -> bytes:
        self._silences += 1
        if self._asked and self._silences < ANSWER_SILENCES_MAX:
            return b""
        self._silences = 0
        return self._ask()

    def _ask(self) -> bytes:
        """Return the next command of the setting up, else the request for poses."""
        self._asked = self._commands.popleft() if self._commands else POSE_REQUEST
        return with_crc(self._asked.encode())

    def _use(self, asked: str, answer: str) -> None:
        """Plan what follows from an answer. Raises HandshakeError."""
        self._refusals = self._refusals + 1 if asked == POSE_REQUEST and answer.startswith("ERROR") else 0
        if 0 < self._refusals < POSE_REFUSALS_MAX:
            return
        if answer.startswith("ERROR") and asked != STOP_REQUEST:
            words = _ERROR_WORDS.get(answer[5:7], "see the maker's API guide")
            raise HandshakeError(f"the tracker answers {answer[:7]} to {asked.partition(':')[0]}: {words}")
        if asked == "PHSR:01":
            self._plan(f"PHF:{handle}" for handle in _handles(answer))
        elif asked.startswith("PHRQ:"):
            self._plan(tool_definition(self._rom, answer[:2]))
        elif asked == "PHSR:02":
            self._plan(f"PINIT:{handle}" for handle in _handles(answer))
        elif asked == "PHSR:03":
            handles = _handles(answer)
            if not handles:
                raise HandshakeError(
                    "the tracker has no tool: name the definition file of the tool by ?rom=FILE, or plug it in"
                )
            self._plan(f"PENA:{handle}D" for handle in handles)

    def _plan(self, commands: Iterable[str]) -> None:
        """Put commands before the others."""
        self._commands.extendleft(reversed(list(commands)))


def _handles(answer: str) -> list[str]:
    """List the handles of an answer to PHSR: their number, and 2 + 3 digits each."""
    return [answer[at : at + 2] for at in range(2, len(answer) - 4, 5)]


class NdiDecoder(FrameDecoder):
    """Decodes the answers of an NDI tracker."""

    name: ClassVar[str] = "NDI"
    defined_pose: ClassVar[PoseForm | None] = PoseForm(RotationForm.QUATERNION_WXYZ)

    def __init__(self, channels: int | None, carries: tuple[Stream, ...]) -> None:
        super().__init__(channels, carries)
        self._choice = BodyChoice()
        self._frame_number = b""
        """Of the newest pose, as it came."""
        self.units[Stream.TOOL] = "pose of a tool in the tracker's frame, m"

    def _make_splitter(self) -> FrameSplitter:
        return MarkSplitter(ANSWER_END, ANSWER_MAX_BYTES)

    def _decode(self, frame: bytes) -> Loss | None:
        answer = read_answer(frame)
        if answer is None:
            return Loss.BAD_CHECKSUM
        if answer.startswith(OPTIONS_WORD):
            return None if self._choice.read_options(answer.removeprefix(OPTIONS_WORD)) else Loss.UNREADABLE
        found = _POSES_RE.fullmatch(answer)
        if found is None or not found[2]:
            return None  # the answer to another command
        tools = [_TOOL_RE.fullmatch(line) for line in found[2].splitlines(keepends=True)]
        if len(tools) != int(found[1], 16) or None in tools:
            return Loss.UNREADABLE
        names = [tool[1].decode() for tool in tools if tool is not None]
        index = self._choice.index_of(names)
        tool = None if index is None else tools[index]
        if index is None or tool is None:
            self._status = self._choice.problem
            return Loss.NO_POSE
        return self._add_tool(names[index], tool)

    def _add_tool(self, name: str, tool: re.Match[bytes]) -> Loss | None:
        if tool[3] and tool[3] == self._frame_number:
            return None  # asked faster than it measures
        self._frame_number = tool[3] or b""
        self.valid_records += 1
        values = _pose_numbers(tool[0][2:])
        if values is None:
            self._status = f"The tracker does not see the tool {name}"
            return Loss.NO_POSE
        self._status = ""
        self.units[Stream.TOOL] = f"pose of the tool {name} in the tracker's frame, m"
        return self._add(Stream.TOOL, NO_SEQ, math.nan, values)


def _pose_numbers(text: bytes) -> FloatArray | None:
    """Read x y z in metres and the quaternion w x y z, (7,), of a tool's entry; `None` if it is lost."""
    if not text.startswith((b"+", b"-")):
        return None
    turn = [float(text[at : at + 6]) * 1e-4 for at in range(0, 24, 6)]
    place = [float(text[at : at + 7]) * 1e-5 for at in range(24, 45, 7)]
    return np.array([*place, *turn])


def _with_options(address: DeviceAddress, questions: Questions) -> DeviceAddress:
    """Fill in the options and the tool's definition. Raises LinkError: its file cannot be read."""
    del questions
    path, rom = address.options.get("rom", ""), b""
    if path:
        try:
            rom = Path(path).read_bytes()
        except OSError as error:
            raise LinkError(
                FailureKind.ADDRESS, f"{address.label}: {path} cannot be read: {error.strerror or error}."
            ) from error
        if not 0 < len(rom) <= ROM_MAX_BYTES:
            raise LinkError(
                FailureKind.ADDRESS,
                f"{address.label}: {path} has {len(rom)} bytes; expected a tool definition of 1 to {ROM_MAX_BYTES} bytes.",
            )
    head = with_crc(OPTIONS_WORD + write_options(address.options.get("body", "").upper()))
    return replace(address, first_bytes=head, handshake=NdiHandshake(rom))


_VECTOR_TOOLS = b"0202MISSING000000310000012A\n01+09515+00381+01893+02393+010000-020000+030000+00012000000310000012A\n0000"
"""Tool 01 at 100 -200 300 mm, R = Rz(30) Ry(20) Rx(10) degrees; tool 02 lost."""
_VECTOR_POSE = (
    0.8137839472483146, -0.4410060881515248, 0.3785093359670826, 0.1,
    0.46985821142382195, 0.8825563891787725, 0.018096438249940366, -0.2,
    -0.3420364722636452, 0.1631191286545401, 0.9254205538610131, 0.3,
)  # fmt: skip
"""Upper rows of the pose, with the rotation of four digits."""
_SERIAL_ROUTE = Route(
    usage="ndi:/dev/ttyUSB0@115200?body=01",
    form=Form.SERIAL,
    transport="serial",
    format="ndi",
    baud=9600,
    options=("body", "rom"),
    handshake=lambda _: NdiHandshake(),
    prepare=_with_options,
)

DEVICE_FAMILY = Family(
    routes=(_SERIAL_ROUTE, replace(over_tcp(_SERIAL_ROUTE), usage="ndi://192.168.1.5:8765?body=01", port=8765)),
    decoders={"ndi": NdiDecoder},
    vectors=(
        Vector("ndi", (Stream.TOOL,), with_crc(OPTIONS_WORD + write_options("01")) + with_crc(_VECTOR_TOOLS), (_VECTOR_POSE,)),
    ),
)
