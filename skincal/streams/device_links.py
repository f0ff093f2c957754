"""Links to devices that are spoken to: transports, and the talk over them; what is said comes from `skincal.streams.decoders`.

Imported when a device's address is opened, and each device's own modules when it is that device's.
"""

from __future__ import annotations

import contextlib
import json
import os
import queue
import re
import select
import signal
import socket
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from importlib.util import find_spec
from itertools import islice
from pathlib import Path
from typing import Any, Protocol

from skincal.model.errors import InputError
from skincal.model.given import read_regular
from skincal.model.readings import Stream
from skincal.streams.decoders.dialogue import Dialogue, DialogueError
from skincal.streams.device_address import DRIVER_NUMBERS, DeviceAddress, parse_device, split_command
from skincal.streams.failures import FailureKind, Link, LinkFailure

READY_S = 0.8
"""s. A device that has not agreed to send so long after it was asked speaks another language, or not at all."""
ANSWER_S = 1.0
"""s. For a page or the answer of a name server: machines of one room."""
ANSWER_MAX = 1 << 20
"""Bytes of an answer: a name server's has some 10,000 ports."""
DATAGRAM_MAX = 1472
"""Bytes of a datagram that passes Ethernet in one piece; no device here sends longer ones."""
DATAGRAMS_TOGETHER = 64
"""Datagrams of one read: more than come while a busy program waits 60 ms, at 1 kHz."""
RECEIVE_BUFFER = 1 << 20
"""Bytes that the system keeps for a program that is held up: some seconds at 1 kHz, each datagram with the system's own 700."""


class _OpenTcp(Protocol):
    def __call__(self, address: str, host: str, port: int, /) -> Link: ...


@dataclass(frozen=True, slots=True)
class Ports:
    """How the program opens what it also opens plainly."""

    tcp: _OpenTcp
    """From the address as the operator wrote it, for sentences, a host and a port."""
    serial: Callable[[str, int], Link]
    """From the port's name and its baud rate."""
    given_up: Callable[[], bool] = lambda: False
    """Whether nobody waits for the link any more."""


class TalkingLink:
    """A transport and what is said over it.

    The constructor waits until the device agrees to send, at most `READY_S`, and raises LinkFailure where it does not.
    """

    def __init__(self, address: str, transport: Link, dialogue: Dialogue) -> None:
        self._address, self._transport, self._dialogue = address, transport, dialogue
        self._early = b""
        self._heard_s = time.monotonic()
        try:
            self._begin()
        except BaseException:
            transport.close()
            raise

    def _begin(self) -> None:
        opening = self._dialogue.opening()
        if opening:
            self._transport.write(opening)
        end_s = time.monotonic() + READY_S
        while not self._dialogue.ready:
            # What is said and not understood must not fill the memory meanwhile.
            if time.monotonic() > end_s or len(self._early) > ANSWER_MAX:
                raise LinkFailure(FailureKind.ABSENT, f"{self._address}: does not answer as it should; check what runs there.")
            self._early += self._hear(end_s - time.monotonic())

    def _hear(self, timeout_s: float) -> bytes:
        data = self._transport.read(max(timeout_s, 0.0))
        if data:
            try:
                answer = self._dialogue.hear(data)
            except DialogueError as error:
                sentence = f"{self._address}: {error}. It is read no further."
                raise LinkFailure(FailureKind.NONSENSE, sentence) from error
            if answer:
                self._transport.write(answer)
        return data

    def read(self, timeout_s: float) -> bytes:
        """See `Link`."""
        if self._early:
            early, self._early = self._early, b""
            return early
        data = self._hear(min(timeout_s, self._dialogue.silence_s))
        now_s = time.monotonic()
        if data:
            self._heard_s = now_s
        elif now_s - self._heard_s >= self._dialogue.silence_s:
            self._heard_s = now_s
            words = self._dialogue.on_silence()
            if words:
                self._transport.write(words)
        return data

    def write(self, data: bytes) -> None:
        """See `Link`."""
        self._transport.write(data)

    def close(self) -> None:
        """See `Link`; says the farewell before."""
        if self._dialogue.farewell:
            with contextlib.suppress(LinkFailure):
                self._transport.write(self._dialogue.farewell)
        self._transport.close()


def open_device(address: str, carries: tuple[Stream, ...], ports: Ports) -> Link:
    """Open a device's address, which `parse_device` understands. Raises LinkFailure."""
    device = parse_device(address)
    assert device is not None
    return _OPENERS[device.scheme](device, carries, ports)


def _ask(where: str, server: tuple[str, int], request: bytes, ports: Ports, end: bytes) -> bytes:
    """Return a server's answer to one request, up to `end` or its closing, within `ANSWER_S` and `ANSWER_MAX`."""
    link = ports.tcp(where, *server)
    answer = b""
    until_s = time.monotonic() + ANSWER_S
    try:
        link.write(request)
        while end not in answer and len(answer) < ANSWER_MAX and (left_s := until_s - time.monotonic()) > 0:
            answer += link.read(left_s)
    except LinkFailure:
        # Closed: that is how most servers end an answer.
        return answer
    finally:
        link.close()
    return answer


def _open_lines(device: DeviceAddress, carries: tuple[Stream, ...], ports: Ports) -> Link:
    del carries
    return ports.tcp(device.text, device.host, device.port)


# ------------------------------------------------------------------ ATI RDT


class DatagramLink:
    """UDP with one host; each datagram is a packet of the given kind."""

    def __init__(self, address: str, host: str, port: int, kind: int) -> None:
        self._address, self._kind = address, kind
        try:
            family, *_, place = socket.getaddrinfo(host, port, type=socket.SOCK_DGRAM)[0]
            self._socket = socket.socket(family, socket.SOCK_DGRAM)
            self._socket.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, RECEIVE_BUFFER)
            # Connected: what others send does not arrive.
            self._socket.connect(place)
            self._socket.setblocking(False)
        except UnicodeError as error:
            raise LinkFailure(FailureKind.ABSENT, f"{address}: no host can have this name; check it.") from error
        except OSError as error:
            raise LinkFailure(FailureKind.ABSENT, f"{address}: cannot be reached: {error.strerror or error}.") from error

    def read(self, timeout_s: float) -> bytes:
        """See `Link`."""
        from skincal.streams.decoders.framing import pack

        datagrams: list[bytes] = []
        try:
            if not select.select([self._socket], [], [], timeout_s)[0]:
                return b""
            while len(datagrams) < DATAGRAMS_TOGETHER:
                datagrams.append(self._socket.recv(DATAGRAM_MAX))
        except BlockingIOError:
            pass
        except OSError as error:
            if not datagrams:
                raise LinkFailure(FailureKind.REFUSED, _nobody(self._address)) from error
        return b"".join(pack(self._kind, datagram) for datagram in datagrams)

    def write(self, data: bytes) -> None:
        """See `Link`."""
        # What a full buffer or a host that is away does to a datagram is what the network may do, too: asked again later.
        with contextlib.suppress(OSError):
            self._socket.send(data)

    def close(self) -> None:
        """See `Link`."""
        self._socket.close()


def _nobody(address: str) -> str:
    return f"{address}: nothing listens there; switch the sensor on, or check the number."


class _Preface:
    """A transport that hands on some bytes of the host's own first."""

    def __init__(self, first: bytes, transport: Link) -> None:
        self._first, self._transport = first, transport
        self.write, self.close = transport.write, transport.close

    def read(self, timeout_s: float) -> bytes:
        """See `Link`."""
        first, self._first = self._first, b""
        return first or self._transport.read(timeout_s)


def _open_netft(device: DeviceAddress, carries: tuple[Stream, ...], ports: Ports) -> Link:
    from skincal.streams.decoders import rdt
    from skincal.streams.decoders.framing import pack

    del carries
    page = _netft_page(device, ports)
    try:
        rdt.read_page(page)
    except ValueError as error:
        raise LinkFailure(FailureKind.OTHER, f"{device.text}: {error}; {_GIVE_COUNTS}.") from error
    transport = DatagramLink(device.text, device.host, device.port, rdt.RECORDS)
    return TalkingLink(device.text, _Preface(pack(rdt.PAGE, page), transport), rdt.RdtDialogue())


_GIVE_COUNTS = "give the counts for each N and N m of its data sheet, such as ?cpf=1000000&cpt=1000000"
HEX_COUNTS = 10_000.0, 100_000.0
"""Counts for each N and N m of every OnRobot HEX."""


def _netft_page(device: DeviceAddress, ports: Ports) -> bytes:
    """Return what the address or the sensor's own page says of its counts."""
    from skincal.streams.decoders import rdt

    options = device.options
    product = {"hex": "OnRobot HEX", "axia": "Axia", "netft": "Net F/T"}.get(options.get("device", "netft"))
    if product is None:
        raise LinkFailure(FailureKind.ADDRESS, f"{device.text}: device is {options['device']}; expected netft, axia or hex.")
    force, torque = HEX_COUNTS if product == "OnRobot HEX" else (0.0, 0.0)
    try:
        force, torque = float(options.get("cpf", force)), float(options.get("cpt", torque))
        number = int(options.get("page", 80))
        if not 1 <= number <= 65535:
            raise ValueError(f"page is {number}, not a port in 1 ... 65535")
    except ValueError as error:
        raise LinkFailure(FailureKind.ADDRESS, f"{device.text}: {error}; {_GIVE_COUNTS}.") from error
    if force and torque:
        return rdt.given_page(force, torque, product)
    where = f"{device.text} (its page, http://{device.host}:{number}/netftapi2.xml)"
    request = f"GET /netftapi2.xml HTTP/1.0\r\nHost: {device.host}\r\n\r\n".encode()
    try:
        answer = _ask(where, (device.host, number), request, ports, b"</netft")
    except LinkFailure as failure:
        raise LinkFailure(failure.kind, f"{failure} Or {_GIVE_COUNTS}.") from failure
    return answer.partition(b"\r\n\r\n")[2][: rdt.PAGE_MAX]


# ------------------------------------------------------------------ YARP


CONFIG_MOST = 1 << 16
"""Bytes of a file of YARP's settings: each is a line or two."""
NAMES_SHOWN = 3
"""Ports named as examples where one is not known."""


def yarp_server() -> tuple[str, int]:
    """Return host and port of the name server that this machine's YARP uses, by its files; this machine where it has none."""
    folder = _yarp_folder()
    namespace = (_first_words(folder / "yarp_namespace.conf") or ["/root"])[0]
    name = "yarp.conf" if namespace == "/root" else re.sub("[^A-Za-z0-9]", "_", namespace) + ".conf"
    words = _first_words(folder / name)
    if len(words) > 1 and words[1].isdigit() and len(words[1]) < 6:
        return words[0], int(words[1])
    return "127.0.0.1", 10000


def _yarp_folder() -> Path:
    given, config = os.environ.get("YARP_CONFIG_HOME"), os.environ.get("XDG_CONFIG_HOME")
    if given:
        return Path(given)
    if config:
        return Path(config) / "yarp"
    if sys.platform == "win32":
        return Path(os.environ.get("APPDATA", "")) / "yarp" / "config"
    return Path.home() / ("Library/Preferences/yarp" if sys.platform == "darwin" else ".config/yarp")


def _first_words(path: Path) -> list[str]:
    """Return the words of a file's first line that says something; none where there is no such file, or none of YARP's size."""
    try:
        lines = read_regular(path, CONFIG_MOST).decode("utf-8", "replace").splitlines()
    except InputError:
        return []
    words = [line.split() for line in lines if line.strip() and line.strip()[0] not in "#["]
    return words[0] if words else []


def ask_names(where: str, server: tuple[str, int], port: str, ports: Ports) -> dict[str, tuple[str, int]]:
    """Return where a name server says that a port is, or all that it knows for an empty one. Raises LinkFailure."""
    from skincal.streams.decoders.yarp_port import NAME_END, name_query, read_names

    host, number = server
    answer = _ask(f"{where} (name server {host}:{number})", server, name_query(port), ports, NAME_END)
    if NAME_END not in answer:
        sentence = f"{where}: what answers at {host}:{number} is no YARP name server; check the server's host and port."
        raise LinkFailure(FailureKind.OTHER, sentence)
    return read_names(answer)


def _yarp_transport(device: DeviceAddress, ports: Ports) -> Link:
    """Return the connection to a port whose place its name server says. Raises LinkFailure."""
    server = (device.host, device.port) if device.host else yarp_server()
    found = ask_names(device.text, server, device.path, ports).get(device.path)
    if found is None:
        known = ask_names(device.text, server, "", ports)
        some = ", ".join(islice((name for name in known if len(name) < 80), NAMES_SHOWN)) or "none"
        raise LinkFailure(
            FailureKind.ABSENT,
            f"{device.text}: the name server {server[0]}:{server[1]} knows no port {device.path}; it knows {len(known)} ports, "
            f"such as {some}. Start the robot's part, or check the name (skincal devices lists them).",
        )
    try:
        return ports.tcp(f"{device.text} (at {found[0]}:{found[1]} by the name server)", *found)
    except LinkFailure as failure:
        raise LinkFailure(
            failure.kind, f"{failure} The address is the robot's own view of itself: this machine may not reach it."
        ) from failure


def _open_yarp(device: DeviceAddress, carries: tuple[Stream, ...], ports: Ports) -> Link:
    from skincal.streams.decoders.yarp_port import YarpDialogue

    del carries
    return TalkingLink(device.text, _yarp_transport(device, ports), YarpDialogue())


def asked_device(address: str) -> DeviceAddress:
    """Return what the address of a port that answers questions names; LinkFailure where it is of no YARP port."""
    device = parse_device(address)
    if device is None or device.scheme != "yarp":
        usage = "yarp:/skinManager/rpc or yarp://SERVER:10000/skinManager/rpc"
        raise LinkFailure(FailureKind.ADDRESS, f"{address} is no port of a YARP network; expected such as {usage}.")
    return device


class AskedPort:
    """A YARP port that answers questions (RPC), one after another; binary, as every port here.

    Raises LinkFailure: the address is of no YARP port, or nobody answers there within `timeout_s`.
    """

    def __init__(self, address: str, ports: Ports, timeout_s: float) -> None:
        from skincal.streams.decoders.yarp_port import HELLO, Messages

        device = asked_device(address)
        self._address, self._timeout_s, self._messages = address, timeout_s, Messages()
        self._transport = _yarp_transport(device, ports)
        try:
            self._transport.write(HELLO)
            self._hear(lambda: self._messages.port is not None)
        except BaseException:
            self.close()
            raise

    def ask(self, question: Sequence[str | int | float]) -> list[float | str]:
        """Return the values that the port answers. Raises LinkFailure, after which nothing more is to be asked."""
        from skincal.streams.decoders.yarp_port import PortBottleError, read_answer, write_question

        self._transport.write(write_question(question))
        bodies: list[bytes | None] = []
        self._hear(lambda: bool(bodies), bodies)
        try:
            return read_answer(bodies[0] or b"")
        except PortBottleError as error:
            raise LinkFailure(FailureKind.NONSENSE, f"{self._address}: its answer cannot be read: {error}.") from error

    def _hear(self, enough: Callable[[], bool], bodies: list[bytes | None] | None = None) -> None:
        """Read until it is `enough`; messages go to `bodies`."""
        end_s = time.monotonic() + self._timeout_s
        while not enough():
            left_s = end_s - time.monotonic()
            if left_s <= 0:
                raise LinkFailure(FailureKind.ABSENT, f"{self._address}: no answer within {self._timeout_s:g} s.")
            heard = self._messages.split(self._transport.read(left_s))
            if self._messages.fault:
                raise LinkFailure(FailureKind.NONSENSE, f"{self._address}: {self._messages.fault}.")
            if bodies is not None:
                bodies += heard

    def close(self) -> None:
        """Hang up."""
        self._transport.close()


# ------------------------------------------------------------------ serial ports with a talk, and robots


def _open_bota(device: DeviceAddress, carries: tuple[Stream, ...], ports: Ports) -> Link:
    from skincal.streams.decoders.bota import BotaDialogue

    del carries
    return TalkingLink(device.text, ports.serial(device.path, device.baud), BotaDialogue())


def _open_robotiq(device: DeviceAddress, carries: tuple[Stream, ...], ports: Ports) -> Link:
    if device.host:
        return _open_lines(device, carries, ports)
    from skincal.streams.decoders.robotiq import RobotiqDialogue

    return TalkingLink(device.text, ports.serial(device.path, device.baud), RobotiqDialogue())


def _open_papillarray(device: DeviceAddress, carries: tuple[Stream, ...], ports: Ports) -> Link:
    from skincal.streams.decoders.papillarray import PapillArrayDialogue

    del carries
    return TalkingLink(device.text, ports.serial(device.path, device.baud), PapillArrayDialogue())


def _open_rtde(device: DeviceAddress, carries: tuple[Stream, ...], ports: Ports) -> Link:
    from skincal.streams.decoders.rtde import RtdeDialogue

    return TalkingLink(device.text, ports.tcp(device.text, device.host, device.port), RtdeDialogue(carries))


# ------------------------------------------------------------------ websockets


class WebsocketLink:
    """A websocket client; each text message is a packet.

    The library knows the protocol and no port: bytes in, messages and bytes to send out.
    """

    def __init__(self, address: str, transport: Link, host: str, port: int, message_max: int) -> None:
        from websockets.client import ClientProtocol
        from websockets.uri import parse_uri

        self._address, self._transport = address, transport
        self._protocol = ClientProtocol(parse_uri(f"ws://{f'[{host}]' if ':' in host else host}:{port}/"), max_size=message_max)
        self._message = b""
        try:
            self._protocol.send_request(self._protocol.connect())
            self._send()
            self._open()
        except BaseException:
            transport.close()
            raise

    def _open(self) -> None:
        from websockets.protocol import State

        end_s = time.monotonic() + READY_S
        self._early = b""
        while self._protocol.state is State.CONNECTING:
            left_s = end_s - time.monotonic()
            if left_s < 0 or self._protocol.handshake_exc is not None:
                raise LinkFailure(FailureKind.OTHER, f"{self._address}: what answers there is no websocket server.")
            self._early += self._take(self._transport.read(left_s))

    def _take(self, data: bytes) -> bytes:
        from websockets.frames import Frame, Opcode

        from skincal.streams.decoders.framing import pack

        if not data:
            return b""
        self._protocol.receive_data(data)
        out = b""
        for event in self._protocol.events_received():
            if not isinstance(event, Frame) or event.opcode not in (Opcode.TEXT, Opcode.BINARY, Opcode.CONT):
                continue
            self._message += event.data
            if event.fin:
                out += pack(1, self._message)
                self._message = b""
        self._send()
        return out

    def _send(self) -> None:
        for data in self._protocol.data_to_send():
            if data:
                self._transport.write(data)

    def read(self, timeout_s: float) -> bytes:
        """See `Link`."""
        if self._early:
            early, self._early = self._early, b""
            return early
        if self._protocol.parser_exc is not None:
            why = f"{self._address}: it breaks the websocket protocol ({self._protocol.parser_exc}). It is read no further."
            raise LinkFailure(FailureKind.NONSENSE, why)
        return self._take(self._transport.read(timeout_s))

    def write(self, data: bytes) -> None:
        """See `Link`."""
        self._protocol.send_text(data)
        self._send()

    def close(self) -> None:
        """See `Link`."""
        self._transport.close()


def _open_xela(device: DeviceAddress, carries: tuple[Stream, ...], ports: Ports) -> Link:
    from skincal.streams.decoders.xela import MESSAGE_MAX

    del carries
    transport = ports.tcp(device.text, device.host, device.port)
    return WebsocketLink(device.text, transport, device.host, device.port, MESSAGE_MAX)


# ------------------------------------------------------------------ commands


LINE_MAX = 300
"""Bytes kept of what a command says of its end."""
WAITING_CHUNKS = 64
"""Reads that wait; a command that prints faster waits itself."""
GIVEN_UP_S = 0.1
"""s. While a command is waited for it is asked this often whether anybody still wants it."""
END_S = 1.0
"""s that a command has to end, once it is told to."""


_APART: dict[str, Any] = (
    # Without a console of its own a command in a program without one would open a window.
    {"creationflags": subprocess.CREATE_NEW_PROCESS_GROUP | subprocess.CREATE_NO_WINDOW}
    if sys.platform == "win32"
    else {"start_new_session": True}
)
"""How a command is started apart: Ctrl-C in a terminal is for this program, which then ends it with all that it started."""


def end_tree(pid: int) -> None:
    """End a process of Windows with all that it started: no signal reaches these. Raises OSError: there is no such tool."""
    # By its whole path: else one that lies in the working folder would be run.
    tool = Path(os.environ.get("SYSTEMROOT", r"C:\Windows")) / "System32" / "taskkill.exe"
    with contextlib.suppress(subprocess.TimeoutExpired):
        subprocess.run([str(tool), "/F", "/T", "/PID", str(pid)], capture_output=True, check=False, timeout=END_S)


class CommandLink:
    """What a command prints; it runs as long as the link is open.

    Parameters
    ----------
    command : its words; on Windows its line
    ready_s : how long the constructor waits for the first bytes
    after : what its end means for the link
    who : what a sentence calls it
    given_up : ends the waiting
    stdin : of the command
    """

    def __init__(
        self,
        address: str,
        command: Sequence[str] | str,
        ready_s: float,
        after: FailureKind,
        who: str,
        given_up: Callable[[], bool] = lambda: False,
        stdin: int = subprocess.DEVNULL,
    ) -> None:
        self._address, self._after, self._who = address, after, f"{address}: {who}"
        # A pipe: without this a script in Python would hand its lines on by eight thousand bytes.
        surroundings = {**os.environ, "PYTHONUNBUFFERED": "1"}
        streams: dict[str, Any] = {"stdin": stdin, "stdout": subprocess.PIPE, "stderr": subprocess.PIPE}
        try:
            self._process = subprocess.Popen(command, bufsize=0, env=surroundings, **_APART, **streams)
        except (OSError, ValueError) as error:
            reason = getattr(error, "strerror", None) or error
            raise LinkFailure(FailureKind.ADDRESS, f"{address}: cannot be started: {reason}; check the command.") from error
        self._brought: queue.Queue[bytes] = queue.Queue(WAITING_CHUNKS)
        self._said = b""
        self._threads = [threading.Thread(target=work, daemon=True) for work in (self._bring, self._listen)]
        for thread in self._threads:
            thread.start()
        self._early = b""
        try:
            until_s = time.monotonic() + ready_s
            while not (self._early or given_up()) and (left_s := until_s - time.monotonic()) > 0:
                self._early = self.read(min(left_s, GIVEN_UP_S))
        except LinkFailure as failure:
            self.close()
            raise LinkFailure(FailureKind.ADDRESS if after is FailureKind.ENDED else after, str(failure)) from failure

    def _bring(self) -> None:
        assert self._process.stdout is not None
        with self._process.stdout as stream:
            while data := stream.read(1 << 16):
                self._brought.put(data)
        self._brought.put(b"")

    def _listen(self) -> None:
        assert self._process.stderr is not None
        with self._process.stderr as stream:
            while data := stream.read(1 << 12):
                self._said = (self._said + data)[-LINE_MAX * 10 :]

    @property
    def spoke(self) -> bool:
        """Whether bytes came by now."""
        return bool(self._early)

    def read(self, timeout_s: float) -> bytes:
        """See `Link`."""
        if self._early:
            early, self._early = self._early, b""
            return early
        try:
            data = self._brought.get(timeout=timeout_s)
        except queue.Empty:
            return b""
        if not data:
            self._brought.put(b"")
            raise LinkFailure(self._after, self._ending())
        return data

    def _ending(self) -> str:
        try:
            code = self._process.wait(END_S)
        except subprocess.TimeoutExpired:
            return f"{self._who} has closed its output."
        self._threads[1].join(END_S)
        if code == 0:
            return f"{self._who} has ended."
        said = self._said.decode("utf-8", "replace").strip().splitlines()
        why = f": {said[-1][-LINE_MAX:].rstrip('.')}" if said else ""
        return f"{self._who} has ended with code {code}{why}."

    def write(self, data: bytes) -> None:
        """Do nothing: a command is told nothing."""

    def close(self) -> None:
        """See `Link`; ends the command, and what it started."""
        self._end(signal.SIGTERM)
        until_s = time.monotonic() + END_S
        while (self._lives() or self._threads[0].is_alive()) and time.monotonic() < until_s:
            # The thread may wait for room.
            with contextlib.suppress(queue.Empty):
                self._brought.get(timeout=0.02)
        if self._lives():
            self._end(getattr(signal, "SIGKILL", signal.SIGTERM))
        with contextlib.suppress(subprocess.TimeoutExpired):
            self._process.wait(END_S)
        if self._process.stdin is not None:
            self._process.stdin.close()

    def _lives(self) -> bool:
        """Return whether the command runs, or anything that it started."""
        if self._process.poll() is None or sys.platform == "win32":
            return self._process.poll() is None
        try:
            os.killpg(self._process.pid, 0)
        except OSError:
            return False
        return True

    def _end(self, number: int) -> None:
        with contextlib.suppress(OSError):
            if sys.platform != "win32":
                os.killpg(self._process.pid, number)
            elif self._process.poll() is None:
                end_tree(self._process.pid)
                self._process.terminate()


def _open_run(device: DeviceAddress, carries: tuple[Stream, ...], ports: Ports) -> Link:
    del carries, ports
    # No shell.
    return CommandLink(device.text, split_command(device.path), READY_S, FailureKind.ENDED, "the command")


DRIVER_S = 10.0
"""s for the maker's driver to find its sensor: one on a serial port starts anew for three seconds."""


def driver_settings(device: DeviceAddress) -> dict[str, str | int]:
    """Return what `bota_child` is told: a serial number of digits stays as it is written."""
    kind = "dummy" if device.host == "dummy" else "socket" if device.host else "binary"
    numbers = {key: int(device.options[key]) for key in DRIVER_NUMBERS if key in device.options}
    return {"kind": kind, "place": device.host or device.path, **device.options, **numbers}


def _open_bota_driver(device: DeviceAddress, carries: tuple[Stream, ...], ports: Ports) -> Link:
    del carries
    if find_spec("bota_driver") is None:
        sentence = (
            f"{device.text}: newer Bota sensors are read by the maker's driver, which is not installed; "
            "python -m pip install bota-driver (the extra bota of skincal) installs it."
        )
        raise LinkFailure(FailureKind.ADDRESS, sentence)
    child = (sys.executable, "-P", "-m", "skincal.streams.bota_child", json.dumps(driver_settings(device)))
    begun_s = time.monotonic()
    try:
        # The end of its stdin tells it that this program is gone, however it went.
        after, who, stdin = FailureKind.VANISHED, "the maker's driver", subprocess.PIPE
        link = CommandLink(device.text, child, DRIVER_S, after, who, ports.given_up, stdin)
    except LinkFailure:
        # A process for each attempt: not ten a second.
        time.sleep(max(0.0, begun_s + END_S - time.monotonic()))
        raise
    if link.spoke:
        return link
    link.close()
    raise LinkFailure(FailureKind.ABSENT, f"{device.text}: the sensor sends nothing; check its power and its address.")


_OPENERS: dict[str, Callable[[DeviceAddress, tuple[Stream, ...], Ports], Link]] = {
    "netft": _open_netft,
    "yarp": _open_yarp,
    "bota": _open_bota,
    "bota-driver": _open_bota_driver,
    "robotiq": _open_robotiq,
    "rtde": _open_rtde,
    "xela": _open_xela,
    "papillarray": _open_papillarray,
    "lines": _open_lines,
    "run": _open_run,
}
"""By the scheme of the address."""
