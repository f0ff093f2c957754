"""The port at which one robot is asked to poke: a thread that sends what is asked for and reads what the robot answers.

It knows nothing of guides: who holds it tells it lines, and takes answers. What is asked for now is sent again to a robot that
comes, or comes back. A client that does not keep to the lines, says too much or takes nothing is hung up on, for one sentence.
"""

from __future__ import annotations

import contextlib
import queue
import select
import socket
import threading
import time
from collections import deque
from collections.abc import Callable, Sequence
from enum import Enum

from skincal.model.errors import InputError, plain_text
from skincal.robot.target_lines import (
    GREETING,
    Answer,
    AnswerKind,
    AskedLine,
    Judged,
    LineCutter,
    NoTarget,
    PokeTarget,
    Refused,
    read_answer_line,
    read_line,
    write_answer,
    write_line,
)
from skincal.streams.transports.tcp import enable_keepalive

LOCAL = "127.0.0.1"
WAKE_S = 0.02
"""s. How soon what is to be sent goes out."""
LINES_A_SECOND = 50
"""More than a robot has to say: a poke takes a second."""
PENDING_MAX = 1 << 16
"""Bytes that wait for a robot that takes none: some hundred targets."""
AGAIN_S = 0.5
"""s. Who was hung up on is heard again so much later."""
READ_BYTES = 4096
SAID_AGAIN_S = 60.0
"""s. Who comes, is hung up on and comes again costs one sentence in so long."""
SAME_WORDS = 40
"""Characters by which a sentence is known again."""
HOLD_MAX = 1000
"""Answers that wait to be taken; what comes beyond is of a flood."""


def parse_port(text: str) -> tuple[str, int]:
    """Return host and port of `PORT` or `HOST:PORT`; this machine alone where no host is named. Raises InputError."""
    host, colon, port = text.rpartition(":")
    host = host.strip("[]") if colon else LOCAL
    if not (port.isascii() and port.isdigit() and len(port) < 6 and int(port) < 65536 and host):
        raise InputError(f"{text!r} is no port for targets; expected PORT, such as 7010, or HOST:PORT for other machines, too.")
    return host, int(port)


class RobotCame(Enum):
    """That a robot came, or came back."""

    CAME = "came"


class TargetServer:
    """Listens at a port from the start.

    Raises
    ------
    InputError
        The port cannot be had.
    """

    def __init__(self, host: str, port: int) -> None:
        try:
            family = socket.AF_INET6 if ":" in host else socket.AF_INET
            self._listening = socket.create_server((host, port), family=family, backlog=4)
        except (OSError, UnicodeError, OverflowError) as error:
            why = getattr(error, "strerror", None) or error
            raise InputError(f"targets cannot be served at {host}:{port} ({why}); name another port.") from None
        self._listening.setblocking(False)
        self.host, self.port = host, int(self._listening.getsockname()[1])
        self._lock = threading.Lock()
        self._now: AskedLine = NoTarget.WAIT
        self._out: deque[str] = deque(maxlen=HOLD_MAX)
        self._heard: queue.Queue[Answer | RobotCame | str] = queue.Queue(HOLD_MAX)
        self._client: socket.socket | None = None
        self._pending = b""
        self._lines = LineCutter()
        self._times: deque[float] = deque(maxlen=LINES_A_SECOND)
        self._deaf_until_s = 0.0
        self._said: dict[str, float] = {}
        """When each sentence was said last, by how it begins; host's monotonic clock, seconds."""
        self._refusal = ""
        self._stop = threading.Event()
        self._thread = threading.Thread(target=self._run, name="targets", daemon=True)
        self._thread.start()

    # From the thread that asks

    def send(self, lines: Sequence[AskedLine]) -> None:
        """Say these; the last that asks for something, or for nothing, is said again to who comes later."""
        with self._lock:
            for line in lines:
                if not isinstance(line, Judged):
                    self._now = line
                self._out.append(write_line(line))

    def take(self) -> list[Answer | RobotCame | str]:
        """Return what was answered since the last call, and sentences on robots that came, went and were hung up on."""
        found: list[Answer | RobotCame | str] = []
        with contextlib.suppress(queue.Empty):
            while True:
                found.append(self._heard.get_nowait())
        return found

    def refuse(self, reason: str) -> None:
        """Hang up on the robot, and say why: it answered what cannot be."""
        self._refusal = reason

    def close(self) -> None:
        """Say the last lines, hang up and listen no more."""
        self._stop.set()
        self._thread.join()

    # In the thread of its own

    def _run(self) -> None:
        try:
            while not self._stop.is_set():
                self._turn()
            self._send_pending()
        finally:
            self._hang_up()
            self._listening.close()

    def _turn(self) -> None:
        deaf = time.monotonic() < self._deaf_until_s
        waits = [each for each in (None if deaf else self._listening, self._client) if each is not None]
        ready = select.select(waits, [], [], WAKE_S)[0] if waits else []
        if not waits:
            self._stop.wait(WAKE_S)
        # First: who hangs up and comes back at once finds the place free.
        if self._client is not None and self._client in ready:
            self._read()
        if self._listening in ready:
            self._accept()
        self._send_pending()
        reason, self._refusal = self._refusal, ""
        if reason:
            self._refuse(reason)

    def _accept(self) -> None:
        try:
            client, (host, *_) = self._listening.accept()
        except OSError:
            return
        client.setblocking(False)
        if self._client is not None:
            with contextlib.suppress(OSError):
                client.send(f"{GREETING}\n{write_line(Refused('another robot is connected'))}\n".encode())
            client.close()
            return
        try:
            client.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
            enable_keepalive(client)
        except OSError:  # macOS: EINVAL where the peer has closed the connection already
            client.close()
            return
        with self._lock:
            self._out.clear()
            self._pending = f"{GREETING}\n{write_line(self._now)}\n".encode()
        self._client, self._lines = client, LineCutter()
        self._times.clear()
        self._put(RobotCame.CAME)
        self._tell(f"A robot came, from {host}.")

    def _send_pending(self) -> None:
        with self._lock:
            lines = list(self._out)
            self._out.clear()
        if self._client is None:
            return
        self._pending += "".join(f"{line}\n" for line in lines).encode()
        try:
            self._pending = self._pending[self._client.send(self._pending) :] if self._pending else b""
        except BlockingIOError:
            pass
        except OSError:
            self._gone()
            return
        if len(self._pending) > PENDING_MAX:
            self._refuse("it takes nothing of what it is sent.")

    def _read(self) -> None:
        assert self._client is not None
        try:
            data = self._client.recv(READ_BYTES)
        except BlockingIOError:
            return
        except OSError:
            data = b""
        if not data:
            self._gone()
            return
        try:
            for line in self._lines.feed(data):
                self._hear(line)
        except InputError as error:
            self._refuse(str(error))

    def _hear(self, line: str) -> None:
        now_s = time.monotonic()
        self._times.append(now_s)
        if len(self._times) == LINES_A_SECOND and now_s - self._times[0] < 1.0:
            raise InputError(f"it sends more than {LINES_A_SECOND} lines in a second.")
        answer = read_answer_line(line)
        if answer is not None:
            self._put(answer)

    def _refuse(self, reason: str) -> None:
        self._tell(f"The robot at the port for targets is hung up on: {reason}")
        if self._client is not None:
            with contextlib.suppress(OSError):
                self._client.send(f"{write_line(Refused(reason))}\n".encode())
        self._hang_up()
        self._deaf_until_s = time.monotonic() + AGAIN_S

    def _gone(self) -> None:
        self._tell("The robot hung up; what is asked for now is said again when it comes back.")
        self._hang_up()

    def _hang_up(self) -> None:
        if self._client is not None:
            with contextlib.suppress(OSError):
                self._client.shutdown(socket.SHUT_WR)
            self._client.close()
        self._client, self._pending = None, b""

    def _tell(self, sentence: str) -> None:
        kind, now_s = sentence[:SAME_WORDS], time.monotonic()
        if now_s - self._said.get(kind, -SAID_AGAIN_S) >= SAID_AGAIN_S:
            self._said[kind] = now_s
            self._put(plain_text(sentence))

    def _put(self, item: Answer | RobotCame | str) -> None:
        with contextlib.suppress(queue.Full):
            self._heard.put_nowait(item)


class TargetClient:
    """A robot's side, for simulated ones: connects, again and again until it is closed, and hands on what is asked.

    Parameters
    ----------
    take : gets every line that asks for something; what it refuses is answered with a fault
    """

    def __init__(self, host: str, port: int, take: Callable[[AskedLine], object]) -> None:
        self._place, self._take = (host, port), take
        self._answers: queue.SimpleQueue[Answer] = queue.SimpleQueue()
        self._stop = threading.Event()
        self._thread = threading.Thread(target=self._run, name="robot", daemon=True)
        self._thread.start()

    def say(self, answer: Answer) -> None:
        """Answer, from any thread."""
        self._answers.put(answer)

    def close(self) -> None:
        """Hang up for good."""
        self._stop.set()
        self._thread.join()

    def _run(self) -> None:
        while not self._stop.is_set():
            # Nobody listens yet, or no more, or who listens says what is no target: it is tried again.
            with contextlib.suppress(OSError, InputError), socket.create_connection(self._place, AGAIN_S) as connection:
                self._talk(connection)
            self._stop.wait(AGAIN_S)

    def _talk(self, connection: socket.socket) -> None:
        lines = LineCutter()
        connection.settimeout(WAKE_S)
        while not self._stop.is_set():
            with contextlib.suppress(queue.Empty):
                while True:
                    connection.sendall(f"{write_answer(self._answers.get_nowait())}\n".encode())
            try:
                data = connection.recv(READ_BYTES)
            except TimeoutError:
                continue
            if not data:
                return
            for line in lines.feed(data):
                self._hear(line)

    def _hear(self, line: str) -> None:
        asked = read_line(line)
        try:
            if asked is not None:
                self._take(asked)
        except InputError as error:
            if isinstance(asked, PokeTarget):
                self.say(Answer(AnswerKind.FAULT, asked.number, str(error)))
