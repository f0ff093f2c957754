"""Robot's side of the port for targets: reads skincal's lines and sends a robot's."""

from __future__ import annotations

import contextlib
import queue
import socket
import threading
from collections.abc import Callable, Sequence
from urllib.parse import unquote

import numpy as np

from skincal.model.errors import InputError, shortened
from skincal.model.scene import MAX_TIME_SETTING_S, SETTING_MAX
from skincal.robot.target_lines import (
    COORDINATE_MAX_M,
    KNOWN_POINT,
    NO_TAXEL,
    REASON_MAX_CHARS,
    Answer,
    AnswerKind,
    AskedLine,
    Held,
    Judged,
    LineCutter,
    NoTarget,
    PartPlace,
    PokeTarget,
    Refused,
    RobotLine,
    read_number,
    write_answer,
)
from skincal.robot.target_server import ACCEPT_ROBOT_AGAIN_AFTER_S, READ_MAX_BYTES, SEND_POLL_PERIOD_S

FORCE_MAX_N = SETTING_MAX
"""N. Maximum of a scene's thresholds; a robot has limits of its own."""
HOLD_TIME_MAX_S = 2.0 * MAX_TIME_SETTING_S
"""s. Twice the longest still window."""


def read_line(line: str) -> AskedLine | None:
    """Read a line of skincal; `None` for an empty line, the greeting, and words of later versions.

    Raises InputError: a known word is followed by something else than expected.
    """
    word, _, rest = line.strip().partition(" ")
    try:
        match word:
            case "target":
                return _target_of(rest.split())
            case "accepted" | "rejected":
                number, _, reason = rest.partition(" ")
                return Judged(read_number(number), (reason or word) if word == "rejected" else "")
            case "held":
                return Held(read_number(rest))
            case "part":
                return _part_of(rest.split())
            case "refused":
                return Refused(rest)
            case _:
                return NoTarget(line.strip()) if line.strip() in {each.value for each in NoTarget} else None
    except ValueError:
        raise InputError(
            f"{shortened(line.strip(), REASON_MAX_CHARS)!r} is no target; docs/wire.md describes these lines."
        ) from None


def _part_of(words: list[str]) -> PartPlace:
    from skincal.model.pose_form import PoseForm, RotationForm
    from skincal.model.tool_pose import convert_poses  # only robots that poke with a tool get this line

    frame, *rest = words
    values = np.array([[float(value) for value in rest]])
    poses, (fault,) = convert_poses(values, PoseForm(RotationForm.QUATERNION_XYZW), 1.0)
    if fault is not None:
        raise ValueError(words)
    return PartPlace("" if frame == NO_TAXEL else unquote(frame), poses[0])


def _target_of(words: list[str]) -> PokeTarget:
    if len(words) != 12:
        raise ValueError(words)
    number, what, frame, pose, *rest = words
    values = np.array([float(value) for value in rest])
    place, push, force, hold = values[:3], values[3:6], float(values[6]), float(values[7])
    size = float(np.linalg.norm(push))
    # NaN fails every comparison.
    if not (
        (np.abs(place) < COORDINATE_MAX_M).all()
        and 0.5 < size < 2.0
        and 0 < force <= FORCE_MAX_N
        and 0 <= hold <= HOLD_TIME_MAX_S
    ):
        raise ValueError(words)
    channel = None if what in (NO_TAXEL, KNOWN_POINT) else read_number(what)
    frame, pose = ("" if name == NO_TAXEL else unquote(name) for name in (frame, pose))
    return PokeTarget(read_number(number), channel, place, push / size, what == KNOWN_POINT, frame, pose, force, hold)


class TargetClient:
    """Client of a target server: connects, again and again until it is closed.

    Parameters
    ----------
    take : gets every line that skincal sends; if it raises InputError, a target is answered with a fault
    greeting : lines to send first on every connection
    lost : called when a connection ends
    """

    def __init__(
        self,
        host: str,
        port: int,
        take: Callable[[AskedLine], object],
        greeting: Sequence[RobotLine] = (),
        lost: Callable[[], object] = lambda: None,
    ) -> None:
        self._place, self._take, self._greeting, self._lost = (host, port), take, greeting, lost
        self._lines: queue.SimpleQueue[RobotLine] = queue.SimpleQueue()
        self._is_connected = False
        self._stop = threading.Event()
        self._thread = threading.Thread(target=self._run, name="robot", daemon=True)
        self._thread.start()

    def say(self, line: RobotLine) -> None:
        """Send a line, from any thread. Without a connection it is dropped: skincal sends its request again."""
        if self._is_connected:
            self._lines.put(line)

    def close(self) -> None:
        """Disconnect."""
        self._stop.set()
        self._thread.join()

    def _run(self) -> None:
        while not self._stop.is_set():
            # The server may be away, or send something else: try again.
            with (
                contextlib.suppress(OSError, InputError),
                socket.create_connection(self._place, ACCEPT_ROBOT_AGAIN_AFTER_S) as connection,
            ):
                self._talk(connection)
            if self._is_connected:
                self._is_connected = False
                self._lost()
            self._stop.wait(ACCEPT_ROBOT_AGAIN_AFTER_S)

    def _talk(self, connection: socket.socket) -> None:
        lines = LineCutter()
        connection.settimeout(SEND_POLL_PERIOD_S)
        # Answers to an earlier connection mean nothing to this one.
        self._lines, self._is_connected = queue.SimpleQueue(), True
        _send(connection, self._greeting)
        while not self._stop.is_set():
            with contextlib.suppress(queue.Empty):
                while True:
                    _send(connection, [self._lines.get_nowait()])
            try:
                data = connection.recv(READ_MAX_BYTES)
            except TimeoutError:
                continue
            if not data:
                return
            for line in lines.feed(data):
                self._handle_line(line)

    def _handle_line(self, line: str) -> None:
        asked = read_line(line)
        try:
            if asked is not None:
                self._take(asked)
        except InputError as error:
            if isinstance(asked, PokeTarget):
                self.say(Answer(AnswerKind.FAULT, asked.number, str(error)))


def _send(connection: socket.socket, lines: Sequence[RobotLine]) -> None:
    connection.sendall("".join(f"{write_answer(line)}\n" for line in lines).encode())
