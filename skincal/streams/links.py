"""Links of a session: their addresses, and the thread that reads one, stamps its bytes and queues them.

An address may come from a stranger's session, so `parse_address` alone decides what is opened.
"""

from __future__ import annotations

import queue
import re
import threading
import time
from collections import Counter
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from skincal.devices.family import AUTO, DeviceAddress, Form, Route
from skincal.devices.link import FailureKind, Link, LinkError
from skincal.devices.registry import parse_device
from skincal.model.errors import InputError
from skincal.model.readings import Chunk, LinkEvent, LinkState, Stream

PORTS_LISTED_MAX = 200
"""Ports of a YARP network that are listed: a whole iCub has some hundred."""
FILE_PREFIX = "file:"
UNKNOWN_SCHEME_RE = re.compile(r"([a-z][a-z0-9+.-]+):.", re.IGNORECASE)
"""Begin of an address that is neither a port nor a path: at least two letters, since Windows has drives of one."""
ADDRESS_HELP = "a serial port such as /dev/ttyUSB0 or COM3, socket://HOST:PORT, a file, or a device (docs/devices.md)"
ADDRESS_MAX_CHARS = 1000
"""Maximum length of an address. The full address is shown to the operator before connecting."""
SHARED_LINK = "board"
"""Name of a link that carries several streams."""
QUEUED_MAX_BYTES = 1 << 20
"""Bytes of a link that may wait in the queue: a second of the fastest devices, a tenth of a second of work."""
ITEM_OVERHEAD_BYTES = 200
"""Memory of an item beyond its bytes, so that many small items count, too."""
DROP_NS = 500_000_000
"""ns. A link that is too fast is not read for this long, so that at most two events a second say so."""
SERIAL_ROUTE = Route(usage="/dev/ttyUSB0", form=Form.SERIAL, transport="serial")
FILE_ROUTE = Route(usage="file:PATH", form=Form.PATH, transport="file")


@dataclass(frozen=True, slots=True)
class LinkSpec:
    """A link as the operator describes it; `InputError` if its address is too long."""

    name: str
    """Unique in a session, such as `"wrench"`."""
    address: str
    """`/dev/ttyUSB0`, `COM3`, either with `@921600` for its baud rate; `file:PATH` or a file's path; a device's address
    (`skincal.devices.registry`)."""
    carries: tuple[Stream, ...]
    format: str = AUTO
    """One of `skincal.streams.decoders.auto_detect.NAMES`."""

    def __post_init__(self) -> None:
        _check_length(self.address)


def _check_length(address: str) -> None:
    if len(address) > ADDRESS_MAX_CHARS:
        raise InputError(f"{address}: the address has {len(address)} characters; expected at most {ADDRESS_MAX_CHARS}.")


def parse_address(address: str) -> DeviceAddress:
    """Read an address. Nothing is opened.

    Raises InputError: the address is empty, too long, or not valid.
    """
    if not address:
        raise InputError(f"The address is empty. Expected {ADDRESS_HELP}.")
    _check_length(address)
    device = parse_device(address)
    if device is not None:
        return device
    path, baud = split_baud(address)
    # Before unknown schemes: the name of an existing file may begin like one.
    if path.startswith(FILE_PREFIX) or _is_file(path):
        return DeviceAddress(address, FILE_ROUTE, path=path.removeprefix(FILE_PREFIX), baud=baud)
    scheme = UNKNOWN_SCHEME_RE.match(address)
    if scheme is not None:
        raise InputError(f"{address}: skincal cannot open addresses that begin with {scheme[1]}:. Expected {ADDRESS_HELP}.")
    return DeviceAddress(address, SERIAL_ROUTE, path=path, baud=baud)


def split_baud(address: str) -> tuple[str, int]:
    """Split `PORT@BAUD`; 0 for an address without a number after its last `@`."""
    path, at, baud = address.rpartition("@")
    if at and baud.isascii() and baud.isdigit() and int(baud) > 0:
        return path, int(baud)
    return address, 0


def _is_file(path: str) -> bool:
    try:
        return Path(path).is_file()
    except OSError:  # such as a name that is too long
        return False


def format_of(address: str, given: str) -> str:
    """Name the decoder of a link: the given one, or for `auto` the one of its address."""
    if given != AUTO:
        return given
    try:
        device = parse_device(address)
    except InputError:
        return given
    return given if device is None else device.route.format


def describe_links(addresses: Mapping[Stream, str | None]) -> tuple[LinkSpec, ...]:
    """Describe the links for the address of each stream; one address for several streams is one link.

    Raises InputError: an address is not valid.
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


def open_link(spec: LinkSpec, is_cancelled: Callable[[], bool] = lambda: False) -> Link:
    """Open a link. Raises LinkError.

    Parameters
    ----------
    is_cancelled : whether nobody waits for it any more; asked while opening takes seconds, from any thread
    """
    try:
        address = parse_address(spec.address)
    except InputError as error:
        raise LinkError(FailureKind.ADDRESS, str(error)) from error
    # Imported now: a program that opens no link needs no transport.
    from skincal.streams.opening import open_address

    return open_address(address, spec.carries, spec.format, is_cancelled)


def serial_ports() -> list[tuple[str, str]]:
    """List name and description of each serial port of this machine that has a device."""
    from skincal.streams.transports.serial_port import list_serial_ports

    return list_serial_ports()


def yarp_ports() -> list[tuple[str, tuple[str, int]]]:
    """List name, host and number of the ports that the name server of this machine's YARP knows. Raises LinkError."""
    from skincal.devices.yarp import ask_names, name_server
    from skincal.streams.opening import NetworkQuestions

    return sorted(ask_names("No YARP", name_server(), "", NetworkQuestions()).items())[:PORTS_LISTED_MAX]


READ_MAX_S = 0.1
"""s. Longest wait in one read: how soon a stop is seen."""
RETRY_S = 0.1
"""s. Pause between attempts to open a link that is away."""
STABLE_AFTER_S = 1.0
"""s. A link that is lost sooner after it was opened was lost hastily: a server that has no room hangs up at once."""
RETRY_MAX_S = 5.0
"""s. A link that is lost hastily again and again is opened anew ever later, up to this."""
JOIN_MAX_S = 2.0
"""s. Longest wait for the thread at a stop: longer than a connection may take."""
BACKPRESSURE_MAX_S, BACKPRESSURE_POLL_S = 5.0, 0.02
"""s. So long a device that a gap would spoil is not read while a busy program has no room; the system keeps some of TCP."""
NEW_REASON_S = 1.0
"""s. A new reason why a lost link does not open is reported when it has lasted so long: a port that comes back may deny
access until the system has set its owner."""

EXPECTED_WHILE_LOST = (FailureKind.ABSENT, FailureKind.REFUSED)
"""Reasons that say no more than that the link is still away."""
STATE_AFTER_FAILURE = {FailureKind.ENDED: LinkState.ENDED, FailureKind.PROTOCOL_ERROR: LinkState.FAILED}
"""State of a link that is read no further."""


class ChunkQueue:
    """What readers bring, in order, for the one that takes it; of each link no more waits than `QUEUED_MAX_BYTES`.

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
                self._waiting[item.link] += len(item.data) + ITEM_OVERHEAD_BYTES
            else:
                self._dropped[item.link] += len(item.data)
                return False
            self._queue.put(item)
            return True

    def _has_room(self, chunk: Chunk) -> bool:
        """Return whether a chunk may wait; where that is so again, say first what was dropped."""
        link, full = chunk.link, self._waiting[chunk.link] + len(chunk.data) > QUEUED_MAX_BYTES
        if not full and chunk.host_ns >= self._until_ns.get(link, 0):
            self._tell_dropped(link, chunk.host_ns)
            return True
        if link not in self._until_ns:
            self._until_ns[link] = chunk.host_ns + DROP_NS
        return False

    def has_room(self, chunk: Chunk) -> bool:
        """Return whether a chunk would be taken, but for a time of dropping; nothing changes."""
        with self._lock:
            return self._waiting[chunk.link] + len(chunk.data) <= QUEUED_MAX_BYTES

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
                self._waiting[item.link] -= len(item.data) + ITEM_OVERHEAD_BYTES
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


def _needs_every_byte(address: str) -> bool:
    try:
        device = parse_device(address)
    except InputError:
        return False
    return device is not None and device.route.needs_every_byte


class Reader:
    """Reads one link into a queue, in one daemon thread, and takes a lost link up again by itself.

    Events: OPEN each time the link opens; FAILED when it cannot be opened at first, LOST when it vanished, each with a
    sentence, and again if the reason becomes another; ENDED at the end of a file. Attempts to open go on until `stop`,
    save after an end and for an address that cannot be right. Silence is no event. A link that was lost hastily is said to be
    open again once it brings bytes or holds, so that a server that hangs up on everybody costs one sentence.
    """

    def __init__(self, spec: LinkSpec, items: ChunkQueue | queue.SimpleQueue[Chunk | LinkEvent]) -> None:
        self._spec = spec
        self._items = items
        self._stop = threading.Event()
        self._thread = threading.Thread(target=self._run, name=f"reader {spec.name}", daemon=True)
        self._opened = False
        self._short_connections = 0
        """Times in a row that the link was lost within `STABLE_AFTER_S`."""
        self._opened_s, self._open_was_said = 0.0, False
        """When it was opened last, and whether that was said."""
        self._needs_every_byte = _needs_every_byte(spec.address)
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
            self._thread.join(JOIN_MAX_S)

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
                self._stop.wait(min(RETRY_S * 2 ** min(self._short_connections, 6), RETRY_MAX_S))
        except Exception as error:  # noqa: BLE001 - nothing above catches it: the operator must hear of it
            self._say(LinkState.FAILED, f"Reading stopped by a fault of the program: {error!r}.")

    def _try_once(self) -> bool:
        """Open the link and read it until it fails or is to stop; say whether to leave it at that."""
        try:
            link = open_link(self._spec, self._stop.is_set)
        except LinkError as failure:
            if self._stop.is_set():
                return True
            self._could_not_open(failure)
            return failure.kind is FailureKind.ADDRESS
        self._opened, self._opened_s, self._open_was_said = True, time.monotonic(), False
        if not self._short_connections:
            self._say_open()
        try:
            self._read(link)
        except LinkError as failure:
            self._short_connections = self._short_connections + 1 if time.monotonic() - self._opened_s < STABLE_AFTER_S else 0
            if self._open_was_said or failure.kind in STATE_AFTER_FAILURE:
                self._say(STATE_AFTER_FAILURE.get(failure.kind, LinkState.LOST), str(failure))
            else:
                self._could_not_open(failure)
            # What speaks another language will do so again: one sentence, not one a second.
            return failure.kind in STATE_AFTER_FAILURE
        finally:
            link.close()
        # Only a stop ends the reading without a failure.
        return True

    def _read(self, link: Link) -> None:
        tried: tuple[int, ...] = ()
        while not self._stop.is_set():
            data = link.read(READ_MAX_S)
            if not self._open_was_said and (data or time.monotonic() - self._opened_s >= STABLE_AFTER_S):
                self._say_open()
            # Stamped at once, by a clock that nobody can set back while a session runs.
            if data:
                self._enqueue_waiting(Chunk(self._spec.name, time.monotonic_ns(), data))
            # Of a port whose baud rate is searched: what follows is heard at another one.
            now_tried: tuple[int, ...] = getattr(link, "tried", ())
            if len(now_tried) > 1 and now_tried != tried:
                tried = now_tried
                self._items.put(LinkEvent(self._spec.name, time.monotonic_ns(), LinkState.OPEN, tried=tried))

    def _enqueue_waiting(self, chunk: Chunk) -> None:
        """Have a chunk taken; where a gap would spoil what follows, it waits for room, and what comes in the system."""
        until_s = time.monotonic() + BACKPRESSURE_MAX_S
        while self._needs_every_byte and isinstance(self._items, ChunkQueue) and not self._items.has_room(chunk):
            if self._stop.wait(BACKPRESSURE_POLL_S) or time.monotonic() > until_s:
                break
        if self._items.put(chunk) is False and self._needs_every_byte:
            self._stop.wait(DROP_NS * 1e-9)
            raise LinkError(FailureKind.VANISHED, f"{self._spec.address}: bytes were dropped, so it is connected anew.")

    def _could_not_open(self, failure: LinkError) -> None:
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
        self._open_was_said = True
        self._say(LinkState.OPEN)

    def _say(self, state: LinkState, sentence: str = "") -> None:
        self._reported, self._reason = sentence, ""
        self._items.put(LinkEvent(self._spec.name, time.monotonic_ns(), state, sentence))
