"""Links: where a device's bytes come from, and the thread that reads one: it stamps what it read, and does nothing else.

Serial ports, TCP and files stand behind one small interface.

pyserial is imported here only, and only when a serial port is opened. Every failure ends as one `LinkFailure` with a
sentence that says what was seen and what to do.

An address may come from a stranger's session, so `parse_address` alone decides what is opened: what it does not know never
reaches pyserial, whose URLs run other code and write files (`spy://PORT?file=X` empties X).
"""

from __future__ import annotations

import contextlib
import errno
import math
import queue
import re
import socket
import sys
import threading
import time
from collections import Counter
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from enum import Enum
from importlib import import_module
from pathlib import Path
from typing import Any
from urllib.parse import urlsplit

from skincal.model.errors import InputError
from skincal.model.given import open_regular
from skincal.model.readings import Chunk, LinkEvent, LinkState, Stream
from skincal.streams.decoders.detect import AUTO
from skincal.streams.device_address import from_start, parse_device
from skincal.streams.failures import FailureKind, Link, LinkFailure

DEFAULT_BAUD = 115200
PORTS_LISTED = 200
"""Ports of a YARP network that are listed: a whole iCub has some hundred."""
FILE_PREFIX = "file:"
SOCKET_PREFIX = "socket://"
SCHEME = re.compile(r"([a-z][a-z0-9+.-]+):.", re.IGNORECASE)
"""How an address begins that is neither a port nor a path: with two letters or more, since Windows has drives of one."""
KNOWN = "a serial port such as /dev/ttyUSB0 or COM3, socket://HOST:PORT, a file, or a device (docs/devices.md)"
ADDRESS_MOST = 1000
"""Characters of an address: four times the longest name of a host. Before it is connected, all of it is shown."""
SHARED_LINK = "board"
"""Name of a link that carries several streams."""
READ_BYTES = 65536
"""Most bytes of one read: more than a second of any serial port."""
CONNECT_S = 1.0
"""s. A host in the same room answers in milliseconds; a reader must be able to stop."""
PROBE_IDLE_S, PROBE_S, PROBES = 3, 2, 3
"""s, s: a dead server is noticed after 3 + 3 * 2 = 9 s of silence. By default systems wait for two hours."""
WAITING_MOST = 1 << 20
"""Bytes of a link that wait to be worked on: a second of the fastest devices, a tenth of a second of work."""
ITEM_BYTES = 200
"""What an item takes beside its bytes: many small ones must not be for nothing."""
DROP_NS = 500_000_000
"""ns. A link that is too fast is not listened to for so long: it is said twice a second at most, and all else gets its turn."""
WRITE_S = 0.5
"""s. A command is a few bytes; a port that takes none for so long is stuck."""
BLOCK_BYTES = 512
"""Bytes handed on of a file together: three skin frames of 84 taxels."""
BITS_PER_BYTE = 10
"""Start bit, eight data bits, stop bit."""


@dataclass(frozen=True, slots=True)
class LinkSpec:
    """A link as the operator describes it; `InputError` where its address is too long."""

    name: str
    """Unique in a session, such as `"wrench"`."""
    address: str
    """`/dev/ttyUSB0`, `COM3`, either with `@921600` for its baud rate; `socket://host:port`; `file:PATH` or a file's path; a
    device's address (`skincal.streams.device_address`)."""
    carries: tuple[Stream, ...]
    format: str = "auto"
    """One of `skincal.streams.decoders.detect.NAMES`."""

    def __post_init__(self) -> None:
        _check_length(self.address)


def _check_length(address: str) -> None:
    if len(address) > ADDRESS_MOST:
        raise InputError(f"{address}: the address has {len(address)} characters; expected at most {ADDRESS_MOST}.")


class LinkKind(Enum):
    """What an address names."""

    SERIAL = "serial port"
    TCP = "TCP server"
    FILE = "file"
    DEVICE = "device that is spoken to"


@dataclass(frozen=True, slots=True)
class Address:
    """An address that was understood."""

    kind: LinkKind
    place: str
    """Name of the port, path of the file, host, or the whole address of a device that is spoken to."""
    number: int
    """Baud rate, or the TCP server's port."""


def parse_address(address: str) -> Address:
    """Return what an address names; nothing is opened.

    Raises InputError: no link that is known has such an address, the sentence says which have; or it is too long.
    """
    if not address:
        raise InputError(f"The address is empty; expected {KNOWN}.")
    _check_length(address)
    if address.startswith(SOCKET_PREFIX):
        return Address(LinkKind.TCP, *_host_and_port(address))
    if parse_device(address) is not None:
        return Address(LinkKind.DEVICE, address, 0)
    path, baud = split_baud(address)
    # Before the schemes: the name of a file that is there may begin like one.
    if path.startswith(FILE_PREFIX) or _is_file(path):
        return Address(LinkKind.FILE, path.removeprefix(FILE_PREFIX), baud)
    scheme = SCHEME.match(address)
    if scheme is not None:
        raise InputError(
            f"{address}: skincal does not open what begins with {scheme[1]}:, expected {KNOWN}; name the device itself."
        )
    return Address(LinkKind.SERIAL, path, baud)


def describe_links(addresses: Mapping[Stream, str | None]) -> tuple[LinkSpec, ...]:
    """Return the links for the address of each stream; one address for several streams is one link.

    Raises InputError: an address is of no link that is known.
    """
    carried: dict[str, list[Stream]] = {}
    for stream, address in addresses.items():
        if address is not None:
            carried.setdefault(address, []).append(stream)
    for address in carried:
        parse_address(address)
    return tuple(
        LinkSpec(streams[0].value if len(streams) == 1 else SHARED_LINK, address, tuple(streams))
        for address, streams in carried.items()
    )


def open_link(spec: LinkSpec, given_up: Callable[[], bool] = lambda: False) -> Link:
    """Open what a link's address names.

    Parameters
    ----------
    given_up : whether nobody waits for it any more; asked where opening takes seconds, from any thread

    Raises LinkFailure with a sentence: not there, in use, permission denied, refused, address not understood.
    """
    try:
        address = parse_address(spec.address)
    except InputError as error:
        raise LinkFailure(FailureKind.ADDRESS, str(error)) from error
    if address.kind is LinkKind.TCP:
        return TcpLink(spec.address, address.place, address.number)
    if address.kind is LinkKind.DEVICE:
        # Only now, as each device's own modules in there: a scene costs what its devices need.
        from skincal.streams.device_links import Ports, open_device

        return open_device(spec.address, spec.carries, Ports(TcpLink, SerialLink, given_up))
    if address.kind is LinkKind.FILE:
        return PlaybackLink(Path(address.place), spec, address.number)
    port = SerialLink(address.place, address.number)
    if address.place != spec.address or spec.format != AUTO:
        return port
    from skincal.streams.baud_search import SearchingLink

    return SearchingLink(port, spec.carries)


def serial_ports() -> list[tuple[str, str]]:
    """Return name and description of each serial port of this machine that has a device."""
    from serial.tools import list_ports

    return [(port.device, port.description or "") for port in list_ports.comports() if port.description != "n/a"]


def yarp_ports() -> list[tuple[str, tuple[str, int]]]:
    """Return name, host and number of ports that the name server of this machine's YARP knows. Raises LinkFailure."""
    from skincal.streams.device_links import Ports, ask_names, yarp_server

    return sorted(ask_names("No YARP", yarp_server(), "", Ports(TcpLink, SerialLink)).items())[:PORTS_LISTED]


def split_baud(address: str) -> tuple[str, int]:
    """Split `PORT@BAUD`; an address without a number after its last `@` has the default rate."""
    path, at, baud = address.rpartition("@")
    if at and baud.isascii() and baud.isdigit() and int(baud) > 0:
        return path, int(baud)
    return address, DEFAULT_BAUD


class SerialLink:
    """A serial port or a pty."""

    def __init__(self, port: str, baud: int) -> None:
        import serial

        self._name = port
        self._errors = _serial_errors()
        try:
            # Exclusive: on POSIX two programs could open one port otherwise, and each would get some of its bytes.
            # Not `serial_for_url`: it takes more for a URL than a port's name.
            self._port: Any = serial.Serial(port, baudrate=baud, timeout=0, write_timeout=WRITE_S, exclusive=True)
        # What pyserial raises for a rate that it cannot set.
        except ValueError as error:
            raise LinkFailure(
                FailureKind.ADDRESS, f"{port} does not open at {baud} baud ({error}); check the address and its @BAUD."
            ) from error
        except self._errors as error:
            raise _open_failure(port, error) from error
        self._ask_for_low_latency()

    def _ask_for_low_latency(self) -> None:
        """Have a USB adapter hand bytes on after 1 ms instead of 16; ptys and many drivers cannot, which is no error."""
        ask: Any = getattr(self._port, "set_low_latency_mode", None)
        if ask is None:
            return
        try:
            ask(True)
        except (ValueError, NotImplementedError, AttributeError, *self._errors):
            return

    def read(self, timeout_s: float) -> bytes:
        """See `Link`."""
        try:
            if self._port.timeout != timeout_s:
                # Each assignment sets up the whole port again.
                self._port.timeout = timeout_s
            # pyserial's `read(n)` waits until all n bytes are there or the time is over: so one is awaited, and what is
            # there with it is taken.
            first: bytes = self._port.read(1)
            waiting: int = self._port.in_waiting if first else 0
            return first + self._port.read(min(waiting, READ_BYTES)) if waiting else first
        except self._errors as error:
            raise LinkFailure(FailureKind.VANISHED, _vanished(self._name)) from error

    def write(self, data: bytes) -> None:
        """See `Link`."""
        try:
            self._port.write(data)
        except self._errors as error:
            raise LinkFailure(FailureKind.VANISHED, f"{self._name} takes no bytes: {error}.") from error

    def set_baud(self, baud: int) -> None:
        """Go on at another rate; what the system refuses is left as it is."""
        try:
            self._port.baudrate = baud
        except ValueError:
            return
        except self._errors as error:
            raise LinkFailure(FailureKind.VANISHED, _vanished(self._name)) from error

    def close(self) -> None:
        """See `Link`."""
        try:
            self._port.close()
        except self._errors:
            return


class TcpLink:
    """A TCP server that sends what a serial port would."""

    def __init__(self, address: str, host: str, port: int) -> None:
        self._name = address
        try:
            self._socket = socket.create_connection((host, port), CONNECT_S)
        except UnicodeError as error:
            raise LinkFailure(FailureKind.ABSENT, f"{address}: no host can have this name; check it.") from error
        except OverflowError as error:
            raise LinkFailure(FailureKind.ADDRESS, f"{address}: port {port} is not in 1 ... 65535.") from error
        except OSError as error:
            raise _connect_failure(address, error) from error
        try:
            enable_keepalive(self._socket)
        except OSError as error:  # macOS: EINVAL where the peer has closed the connection already
            self._socket.close()
            raise _connect_failure(address, error) from error

    def read(self, timeout_s: float) -> bytes:
        """See `Link`."""
        self._socket.settimeout(timeout_s)
        try:
            data = self._socket.recv(READ_BYTES)
        except (TimeoutError, BlockingIOError):  # the second with a timeout of 0
            return b""
        except OSError as error:
            raise LinkFailure(FailureKind.VANISHED, _hung_up(self._name)) from error
        if not data:
            raise LinkFailure(FailureKind.VANISHED, _hung_up(self._name))
        return data

    def write(self, data: bytes) -> None:
        """See `Link`."""
        self._socket.settimeout(WRITE_S)
        try:
            self._socket.sendall(data)
        except OSError as error:
            raise LinkFailure(FailureKind.VANISHED, _hung_up(self._name)) from error

    def close(self) -> None:
        """See `Link`."""
        self._socket.close()


def enable_keepalive(connection: socket.socket) -> None:
    """Have the system ask a silent server whether it is there: one that lost its power says no goodbye.

    It is asked after `PROBE_IDLE_S` of silence, `PROBES` times, and one that answers may be silent for ever.
    """
    connection.setsockopt(socket.SOL_SOCKET, socket.SO_KEEPALIVE, 1)
    # The names of the first differ: macOS has its own.
    idle = getattr(socket, "TCP_KEEPIDLE", getattr(socket, "TCP_KEEPALIVE", None))
    options = {
        idle: PROBE_IDLE_S,
        getattr(socket, "TCP_KEEPINTVL", None): PROBE_S,
        getattr(socket, "TCP_KEEPCNT", None): PROBES,
    }
    for option, value in options.items():
        if option is not None:
            with contextlib.suppress(OSError):  # a system that knows the name, and not the option
                connection.setsockopt(socket.IPPROTO_TCP, option, value)


def _is_file(path: str) -> bool:
    try:
        return Path(path).is_file()
    except OSError:  # such as a name that is too long
        return False


def _host_and_port(address: str) -> tuple[str, int]:
    try:
        parts = urlsplit(address)
        host, port = parts.hostname, parts.port
        # What stands before an @ would be taken for the host by who reads the address.
        fits = parts.username is None and bool(host and port) and bool((host or "").encode("idna"))
    except ValueError:  # among them: a name that no host can have
        host, port, fits = None, None, False
    if not (fits and host and port):
        raise InputError(f"{address} is no TCP address; expected socket://HOST:PORT, such as socket://127.0.0.1:7000.")
    return host, port


def _serial_errors() -> tuple[type[Exception], ...]:
    """Return what pyserial raises: its own errors, bare OSError from a lost port, termios.error where there is termios."""
    import serial

    try:
        termios: Any = import_module("termios")
    except ImportError:
        return serial.SerialException, OSError
    return serial.SerialException, OSError, termios.error


def _open_failure(port: str, error: Exception) -> LinkFailure:
    """Turn what the system said of a port into a sentence.

    pyserial keeps the error number on POSIX; on Windows only the name of the system's exception is left in its text, and
    there a port in use is a PermissionError.
    """
    number = getattr(error, "errno", None)
    text = str(error)
    windows = sys.platform == "win32"
    if number in (errno.EAGAIN, errno.EBUSY, errno.EWOULDBLOCK) or (windows and "PermissionError" in text):
        sentence = f"{port}: port is used by another program; close that program, or choose another port."
        return LinkFailure(FailureKind.IN_USE, sentence)
    if number in (errno.EACCES, errno.EPERM):
        return LinkFailure(FailureKind.DENIED, _denied(port))
    if number in (errno.ENOENT, errno.ENXIO, errno.ENODEV, errno.ENOTDIR, errno.EIO) or "FileNotFoundError" in text:
        return LinkFailure(FailureKind.ABSENT, f"There is no port {port}; plug the device in, or check the name.")
    if number == errno.EISDIR or "Could not configure port" in text:
        return LinkFailure(FailureKind.ADDRESS, f"{port} is not a serial port; expected a port such as /dev/ttyUSB0 or COM3.")
    return LinkFailure(FailureKind.OTHER, f"{port} cannot be opened: {text}.")


def _denied(port: str) -> str:
    if sys.platform.startswith("linux"):
        return (
            f"{port}: permission denied; add yourself to the group that owns it, on most systems dialout "
            "(sudo usermod -aG dialout $USER), and log in again."
        )
    return f"{port}: permission denied; the port belongs to another user."


def _vanished(port: str) -> str:
    return f"{port} vanished; plug the device in again, it is then taken up by itself."


def _hung_up(address: str) -> str:
    return f"{address}: the other side closed the connection; it is taken up again when the server is back."


def _connect_failure(address: str, error: OSError) -> LinkFailure:
    if isinstance(error, ConnectionRefusedError):
        sentence = f"{address}: connection refused; no program listens there, start it or check the port number."
        return LinkFailure(FailureKind.REFUSED, sentence)
    if isinstance(error, socket.gaierror):
        return LinkFailure(FailureKind.ABSENT, f"{address}: no host of this name is known; check the name, or give its number.")
    if isinstance(error, TimeoutError):
        return LinkFailure(FailureKind.ABSENT, f"{address}: no answer within {CONNECT_S:g} s; check the cable and the number.")
    return LinkFailure(FailureKind.OTHER, f"{address}: cannot connect: {error.strerror or error}.")


class PlaybackLink:
    """A file of raw bytes, as a port wrote them, read at the pace at which its device made them.

    The device's clock in the bytes sets the pace; bytes without one come as fast as a port of the given baud rate sends them.
    So arrival stamps mean what they mean for a port, and nothing that follows can tell the two apart. The file's end is a
    `LinkFailure` of kind ENDED.
    """

    def __init__(self, path: Path, spec: LinkSpec, baud: int) -> None:
        # Only now: decoders are not needed to describe links.
        from skincal.streams.decoders.detect import LinkDecoder

        self._path = path
        try:
            self._file = open_regular(path, advice="check the name")
        except InputError as error:
            raise LinkFailure(FailureKind.OTHER if path.exists() else FailureKind.ABSENT, str(error)) from error
        try:
            self._decoder = LinkDecoder(spec.format, None, spec.carries)
        except InputError as error:
            self._file.close()
            raise LinkFailure(FailureKind.ADDRESS, str(error)) from error
        self._byte_s = BITS_PER_BYTE / baud
        self._block: bytes | None = None
        self._started_s = time.monotonic()
        self._due_s = 0.0
        self._device_s = math.nan

    def read(self, timeout_s: float) -> bytes:
        """See `Link`."""
        if self._block is None:
            self._block = self._next_block()
        wait_s = self._started_s + self._due_s - time.monotonic()
        if wait_s > timeout_s:
            time.sleep(timeout_s)
            return b""
        if wait_s > 0:
            time.sleep(wait_s)
        block, self._block = self._block, None
        return block

    def _next_block(self) -> bytes:
        """Read the next block and find when it is due: as much later as its device's clock went on."""
        try:
            block = self._file.read(BLOCK_BYTES)
        except OSError as error:
            raise LinkFailure(FailureKind.OTHER, f"{self._path} cannot be read further: {error.strerror or error}.") from error
        if not block:
            raise LinkFailure(FailureKind.ENDED, f"{self._path} is at its end.")
        before = self._device_s
        for _, batch in self._decoder.feed(block, round(self._due_s * 1e9)):
            self._device_s = float(batch.device_s[-1])
        passed_s = self._device_s - before
        # No clock, or none yet, is NaN, which is not >= 0 either.
        self._due_s += passed_s if passed_s >= 0 else len(block) * self._byte_s
        return block

    def write(self, data: bytes) -> None:
        """Do nothing: a recording takes no commands."""

    def close(self) -> None:
        """See `Link`."""
        self._file.close()


READ_S = 0.1
"""s. Longest wait in one read: how soon a stop is seen."""
RETRY_S = 0.1
"""s. Pause between attempts to open a link that is away."""
STEADY_S = 1.0
"""s. A link that is lost sooner after it was opened was lost hastily: a server that has no room hangs up at once."""
RETRY_MOST_S = 5.0
"""s. A link that is lost hastily again and again is opened anew ever later, up to this."""
JOIN_S = 2.0
"""s. Longest wait for the thread at a stop: longer than a connection may take."""
HOLD_S, HOLD_STEP_S = 5.0, 0.02
"""s. So long a device that a gap would spoil is not read while a busy program has no room; the system keeps some of TCP."""
NEW_REASON_S = 1.0
"""s. A new reason why a lost link does not open is reported when it has lasted so long: a port that comes back may deny
access until the system has set its owner."""

EXPECTED_WHILE_LOST = (FailureKind.ABSENT, FailureKind.REFUSED)
"""Reasons that say no more than that the link is still away."""
AFTER = {FailureKind.ENDED: LinkState.ENDED, FailureKind.NONSENSE: LinkState.FAILED}
"""State of a link that is read no further."""


class Inbox:
    """What readers bring, in order, for the one that takes it; of each link no more waits than `WAITING_MOST`.

    Bytes beyond that are dropped for `DROP_NS`, and a `LinkEvent` that says how many takes their place: garbage at the speed of
    a network costs other links nothing, and what is shown is not from long ago. Any thread may call any method.
    """

    def __init__(self) -> None:
        self._queue: queue.SimpleQueue[Any] = queue.SimpleQueue()
        self._lock = threading.Lock()
        self._waiting: Counter[str] = Counter()
        self._dropped: Counter[str] = Counter()
        self._until_ns: dict[str, int] = {}

    def put(self, item: Any) -> bool:
        """Take the next item, if it has room; what is no `Chunk` always has. Return whether it was taken."""
        with self._lock:
            if not isinstance(item, Chunk):
                if isinstance(item, LinkEvent):
                    # Before it: what was dropped came while the link was open.
                    self._tell_dropped(item.link, item.host_ns)
            elif self._has_room(item):
                self._waiting[item.link] += len(item.data) + ITEM_BYTES
            else:
                self._dropped[item.link] += len(item.data)
                return False
            self._queue.put(item)
            return True

    def _has_room(self, chunk: Chunk) -> bool:
        """Return whether a chunk may wait; where that is so again, say first what was dropped."""
        link, full = chunk.link, self._waiting[chunk.link] + len(chunk.data) > WAITING_MOST
        if not full and chunk.host_ns >= self._until_ns.get(link, 0):
            self._tell_dropped(link, chunk.host_ns)
            return True
        if link not in self._until_ns:
            self._until_ns[link] = chunk.host_ns + DROP_NS
        return False

    def has_room(self, chunk: Chunk) -> bool:
        """Return whether a chunk would be taken, but for a time of dropping; nothing changes."""
        with self._lock:
            return self._waiting[chunk.link] + len(chunk.data) <= WAITING_MOST

    def _tell_dropped(self, link: str, host_ns: int) -> None:
        if self._until_ns.pop(link, None) is not None:
            bytes_ = self._dropped.pop(link, 0)
            text = f"{link} sends more than can be read: {bytes_} bytes were dropped; check its format and its rate."
            self._queue.put(LinkEvent(link, host_ns, LinkState.OPEN, text, bytes_))

    def get(self, timeout: float | None = None) -> Any:
        """Return the next item; `queue.Empty` where none comes within `timeout`, seconds."""
        item = self._queue.get(timeout=timeout)
        if isinstance(item, Chunk):
            with self._lock:
                self._waiting[item.link] -= len(item.data) + ITEM_BYTES
        return item

    def empty(self) -> bool:
        """Return whether nothing waits; what a link that fell silent had dropped is said now."""
        if self._until_ns and self._queue.empty():
            self._tell_due(time.monotonic_ns())
        return self._queue.empty()

    def finish(self) -> None:
        """Say what was dropped and is not said yet; nothing comes any more."""
        self._tell_due(None)

    def _tell_due(self, until_ns: int | None) -> None:
        with self._lock:
            for link in [link for link, due_ns in self._until_ns.items() if until_ns is None or until_ns >= due_ns]:
                self._tell_dropped(link, time.monotonic_ns())


class Reader:
    """Reads one link into a queue, in one daemon thread, and takes a lost link up again by itself.

    Events: OPEN each time the link opens; FAILED when it cannot be opened at first, LOST when it vanished, each with a
    sentence, and again if the reason becomes another; ENDED at the end of a file. Attempts to open go on until `stop`,
    save after an end and for an address that cannot be right. Silence is no event. A link that was lost hastily is said to be
    open again once it brings bytes or holds, so that a server that hangs up on everybody costs one sentence.
    """

    def __init__(self, spec: LinkSpec, items: Inbox | queue.SimpleQueue[Chunk | LinkEvent]) -> None:
        self._spec = spec
        self._items = items
        self._stop = threading.Event()
        self._thread = threading.Thread(target=self._run, name=f"reader {spec.name}", daemon=True)
        self._opened = False
        self._hasty = 0
        """Times in a row that the link was lost within `STEADY_S`."""
        self._opened_s, self._told = 0.0, False
        """When it was opened last, and whether that was said."""
        self._from_start = from_start(spec.address)
        self._reported = ""
        """The sentence that was reported last."""
        self._reason, self._reason_since_s = "", 0.0
        """Another reason that is not reported yet, and since when it holds."""

    def start(self) -> None:
        """Begin to read."""
        self._thread.start()

    def halt(self) -> None:
        """Read no more after the read in progress; returns at once, and the thread closes the link."""
        self._stop.set()

    def stop(self) -> None:
        """Stop reading and close the link; waits for the thread, at most two seconds."""
        self.halt()
        # A thread that was never started cannot be joined: Python raises.
        if self._thread.ident is not None:
            self._thread.join(JOIN_S)

    @property
    def running(self) -> bool:
        """Whether the thread still reads or tries to."""
        return self._thread.is_alive()

    def _run(self) -> None:
        try:
            while not self._stop.is_set():
                final = self._try_once()
                if final:
                    return
                # Beyond six times it is the most in any case.
                self._stop.wait(min(RETRY_S * 2 ** min(self._hasty, 6), RETRY_MOST_S))
        except Exception as error:  # noqa: BLE001 - nothing above catches it: the operator must hear of it
            self._say(LinkState.FAILED, f"Reading stopped by a fault of the program: {error!r}.")

    def _try_once(self) -> bool:
        """Open the link and read it until it fails or is to stop; say whether to leave it at that."""
        try:
            link = open_link(self._spec, self._stop.is_set)
        except LinkFailure as failure:
            if self._stop.is_set():
                return True
            self._could_not_open(failure)
            return failure.kind is FailureKind.ADDRESS
        self._opened, self._opened_s, self._told = True, time.monotonic(), False
        if not self._hasty:
            self._say_open()
        try:
            self._read(link)
        except LinkFailure as failure:
            self._hasty = self._hasty + 1 if time.monotonic() - self._opened_s < STEADY_S else 0
            if self._told or failure.kind in AFTER:
                self._say(AFTER.get(failure.kind, LinkState.LOST), str(failure))
            else:
                self._could_not_open(failure)
            # What speaks another language will do so again: one sentence, not one a second.
            return failure.kind in AFTER
        finally:
            link.close()
        # Only a stop ends the reading without a failure.
        return True

    def _read(self, link: Link) -> None:
        tried: tuple[int, ...] = ()
        while not self._stop.is_set():
            data = link.read(READ_S)
            if not self._told and (data or time.monotonic() - self._opened_s >= STEADY_S):
                self._say_open()
            # Stamped at once, by a clock that nobody can set back while a session runs.
            if data:
                self._hand_on(Chunk(self._spec.name, time.monotonic_ns(), data))
            # Of a port whose baud rate is searched: what follows is heard at another one.
            now_tried: tuple[int, ...] = getattr(link, "tried", ())
            if len(now_tried) > 1 and now_tried != tried:
                tried = now_tried
                self._items.put(LinkEvent(self._spec.name, time.monotonic_ns(), LinkState.OPEN, tried=tried))

    def _hand_on(self, chunk: Chunk) -> None:
        """Have a chunk taken; where a gap would spoil what follows, it waits for room, and what comes in the system."""
        until_s = time.monotonic() + HOLD_S
        while self._from_start and isinstance(self._items, Inbox) and not self._items.has_room(chunk):
            if self._stop.wait(HOLD_STEP_S) or time.monotonic() > until_s:
                break
        if self._items.put(chunk) is False and self._from_start:
            self._stop.wait(DROP_NS * 1e-9)
            raise LinkFailure(FailureKind.VANISHED, f"{self._spec.address}: bytes were dropped, so it is connected anew.")

    def _could_not_open(self, failure: LinkFailure) -> None:
        """Report why the link does not open: at once the first time, later only what is new and lasts."""
        sentence = str(failure)
        if not self._reported:
            self._say(LinkState.FAILED, sentence)
            return
        expected = self._opened and failure.kind in EXPECTED_WHILE_LOST
        if expected or sentence == self._reported:
            self._reason = ""
            return
        now_s = time.monotonic()
        if sentence != self._reason:
            self._reason, self._reason_since_s = sentence, now_s
        elif now_s - self._reason_since_s >= NEW_REASON_S:
            self._say(LinkState.LOST if self._opened else LinkState.FAILED, sentence)

    def _say_open(self) -> None:
        self._told = True
        self._say(LinkState.OPEN)

    def _say(self, state: LinkState, sentence: str = "") -> None:
        self._reported, self._reason = sentence, ""
        self._items.put(LinkEvent(self._spec.name, time.monotonic_ns(), state, sentence))
