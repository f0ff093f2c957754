"""Port at which one robot is asked to poke: a thread that sends targets and reads the robot's answers.

The present target is sent again to a robot that connects. A client that breaks the protocol, floods the port or does not read
is disconnected, with one sentence.
"""

from __future__ import annotations

import contextlib
import queue
import select
import socket
import threading
import time
from collections import deque
from collections.abc import Sequence
from enum import Enum

from skincal.model.errors import InputError, plain_text
from skincal.robot.target_lines import (
    GREETING,
    AskedLine,
    Held,
    Judged,
    LineCutter,
    NoTarget,
    PartPlace,
    Refused,
    RobotLine,
    TipPose,
    read_answer_line,
    write_line,
)
from skincal.streams.transports.target_tips import report_tip
from skincal.streams.transports.tcp import enable_keepalive

LOOPBACK_ADDRESS = "127.0.0.1"
SEND_POLL_PERIOD_S = 0.02
"""s. Longest delay until lines are sent."""
ROBOT_LINES_PER_S_MAX = 50
"""More than a robot has to say: a poke takes a second."""
UNSENT_MAX_BYTES = 1 << 16
"""Bytes that wait for a robot that does not read: some hundred targets."""
ACCEPT_ROBOT_AGAIN_AFTER_S = 0.5
"""s. After a disconnection no client is accepted for so long."""
READ_MAX_BYTES = 4096
REPEAT_SAME_SENTENCE_AFTER_S = 60.0
"""s. A robot that connects and is disconnected again and again causes one sentence in so long."""
SAME_SENTENCE_FIRST_CHARS = 40
"""Sentences that begin with the same characters are the same."""
QUEUED_LINES_MAX = 1000
"""Lines and answers that wait; more are part of a flood."""


def parse_port(text: str) -> tuple[str, int]:
    """Read host and port of `PORT` (this machine only) or `HOST:PORT`. Raises InputError."""
    host, colon, port = text.rpartition(":")
    host = host.strip("[]") if colon else LOOPBACK_ADDRESS
    if not (port.isascii() and port.isdigit() and len(port) < 6 and int(port) < 65536 and host):
        raise InputError(f"{text!r} is no port for targets; expected PORT, such as 7010, or HOST:PORT for other machines, too.")
    return host, int(port)


class RobotChange(Enum):
    """A robot connected or left."""

    CAME = "came"
    LEFT = "left"


def open_port(host: str, port: int) -> socket.socket:
    """Open a port, 0 for a free one, for a `TargetServer`. Raises InputError."""
    try:
        family = socket.AF_INET6 if ":" in host else socket.AF_INET
        return socket.create_server((host, port), family=family, backlog=4)
    except (OSError, UnicodeError, OverflowError) as error:
        why = getattr(error, "strerror", None) or error
        raise InputError(f"targets cannot be served at {host}:{port} ({why}); name another port.") from None


class TargetServer:
    """Serves targets at an open port from the start, also to a robot that has connected before."""

    def __init__(self, listener: socket.socket) -> None:
        listener.setblocking(False)
        self._listener = listener
        self.host, self.port = listener.getsockname()[:2]
        self._lock = threading.Lock()
        self._target: AskedLine = NoTarget.WAIT
        self._lines: deque[str] = deque(maxlen=QUEUED_LINES_MAX)
        self._received: queue.Queue[RobotLine | RobotChange | str] = queue.Queue(QUEUED_LINES_MAX)
        self._client: socket.socket | None = None
        self._pending = b""
        self._cutter = LineCutter()
        self._line_times: deque[float] = deque(maxlen=ROBOT_LINES_PER_S_MAX)
        self._ignore_until_s = 0.0
        self._reported_s: dict[str, float] = {}
        """By the beginning of a sentence: when it was last reported, host's monotonic clock, seconds."""
        self._refusal = ""
        self._stop = threading.Event()
        self._thread = threading.Thread(target=self._run, name="targets", daemon=True)
        self._thread.start()

    @property
    def place(self) -> str:
        """Host and port, for sentences."""
        return f"{self.host}:{self.port}"

    # Called from other threads

    def send(self, lines: Sequence[AskedLine]) -> None:
        """Send lines. The last one that is not about a poke is sent again to a robot that connects later."""
        with self._lock:
            for line in lines:
                if not isinstance(line, Judged | Held | PartPlace):
                    self._target = line
                self._lines.append(write_line(line))

    def read_answers(self) -> list[RobotLine | RobotChange | str]:
        """Return the answers since the last call, and sentences on robots that connected or were disconnected."""
        found: list[RobotLine | RobotChange | str] = []
        with contextlib.suppress(queue.Empty):
            while True:
                found.append(self._received.get_nowait())
        return found

    def refuse(self, reason: str) -> None:
        """Disconnect the robot because of an impossible answer."""
        self._refusal = reason

    def close(self) -> None:
        """Send the last lines and close the port."""
        self._stop.set()
        self._thread.join()

    # Called in the server's thread

    def _run(self) -> None:
        try:
            while not self._stop.is_set():
                self._poll_once()
            self._send_pending()
        finally:
            self._close_client()
            self._listener.close()

    def _poll_once(self) -> None:
        is_open = time.monotonic() >= self._ignore_until_s
        sockets = [each for each in (self._listener if is_open else None, self._client) if each is not None]
        ready = select.select(sockets, [], [], SEND_POLL_PERIOD_S)[0] if sockets else []
        if not sockets:
            self._stop.wait(SEND_POLL_PERIOD_S)
        # First: a robot that disconnects and comes back at once finds the place free.
        if self._client is not None and self._client in ready:
            self._read(self._client)
        if self._listener in ready:
            self._accept()
        self._send_pending()
        reason, self._refusal = self._refusal, ""
        if reason:
            self._disconnect(reason)

    def _accept(self) -> None:
        try:
            client, (host, *_) = self._listener.accept()
        except OSError:
            return
        try:
            client.setblocking(False)
            if self._client is not None:
                client.send(f"{GREETING}\n{write_line(Refused('another robot is connected'))}\n".encode())
                client.close()
                return
            client.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
            enable_keepalive(client)
        except OSError:  # macOS: EINVAL if the peer has closed the connection already
            client.close()
            return
        with self._lock:
            self._lines.clear()
            self._pending = f"{GREETING}\n{write_line(self._target)}\n".encode()
        self._client, self._cutter = client, LineCutter()
        self._line_times.clear()
        self._enqueue(RobotChange.CAME)
        self._report(f"A robot connected from {host}.")

    def _send_pending(self) -> None:
        with self._lock:
            lines = list(self._lines)
            self._lines.clear()
        if self._client is None:
            return
        self._pending += "".join(f"{line}\n" for line in lines).encode()
        try:
            self._pending = self._pending[self._client.send(self._pending) :] if self._pending else b""
        except BlockingIOError:
            pass
        except OSError:
            self._disconnect()
        if len(self._pending) > UNSENT_MAX_BYTES:
            self._disconnect("it does not read its lines.")

    def _read(self, client: socket.socket) -> None:
        try:
            data = client.recv(READ_MAX_BYTES)
        except BlockingIOError:
            return
        except OSError:
            data = b""
        if not data:
            self._disconnect()
            return
        try:
            for line in self._cutter.feed(data):
                self._take_line(line)
        except InputError as error:
            self._disconnect(str(error))

    def _take_line(self, line: str) -> None:
        now_s = time.monotonic()
        self._line_times.append(now_s)
        if len(self._line_times) == ROBOT_LINES_PER_S_MAX and now_s - self._line_times[0] < 1.0:
            raise InputError(f"it sends more than {ROBOT_LINES_PER_S_MAX} lines in a second.")
        answer = read_answer_line(line)
        if isinstance(answer, TipPose):
            report_tip(answer.place)
        if answer is not None:
            self._enqueue(answer)

    def _disconnect(self, reason: str = "") -> None:
        """Close the connection. The robot gets the `reason` and is ignored for a while; without one, it has left."""
        if reason:
            self._report(f"The robot at the port for targets is disconnected: {reason}")
            if self._client is not None:
                with contextlib.suppress(OSError):
                    self._client.send(f"{write_line(Refused(reason))}\n".encode())
            self._ignore_until_s = time.monotonic() + ACCEPT_ROBOT_AGAIN_AFTER_S
        else:
            self._report("The robot closed the connection. The present request is sent again when it reconnects.")
        self._enqueue(RobotChange.LEFT)
        self._close_client()

    def _close_client(self) -> None:
        if self._client is not None:
            with contextlib.suppress(OSError):
                self._client.shutdown(socket.SHUT_WR)
            self._client.close()
        self._client, self._pending = None, b""

    def _report(self, sentence: str) -> None:
        kind, now_s = sentence[:SAME_SENTENCE_FIRST_CHARS], time.monotonic()
        if now_s - self._reported_s.get(kind, -REPEAT_SAME_SENTENCE_AFTER_S) >= REPEAT_SAME_SENTENCE_AFTER_S:
            self._reported_s[kind] = now_s
            self._enqueue(plain_text(sentence))

    def _enqueue(self, item: RobotLine | RobotChange | str) -> None:
        with contextlib.suppress(queue.Full):
            self._received.put_nowait(item)
