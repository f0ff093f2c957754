"""Links of a session: their addresses, and the thread that reads a link, stamps its bytes and queues them.

An address may come from a stranger's session, so `parse_address` alone decides what may be opened.
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
from urllib.parse import parse_qsl

from skincal.devices.family import AUTO_FORMAT, DeviceAddress, Form, Route
from skincal.devices.foreign_addresses import foreign_advice
from skincal.devices.link import FailureKind, Link, LinkError
from skincal.devices.registry import parse_device, split_baud
from skincal.model.errors import InputError
from skincal.model.readings import Chunk, LinkEvent, LinkState, Stream
from skincal.streams.decoders.auto_detect import LinkDecoder
from skincal.streams.decoders.board_part import BoardPart, PartDecoder, read_part

YARP_PORTS_LISTED_MAX = 200
"""A whole iCub has some hundred ports."""
FILE_PREFIX = "file:"
UNKNOWN_SCHEME_RE = re.compile(r"([a-z][a-z0-9+.-]+):.", re.IGNORECASE)
"""Begin of an address that is neither a port nor a path: at least two letters, since Windows has drives of one."""
ADDRESS_HELP = "a serial port such as /dev/ttyUSB0 or COM3, socket://HOST:PORT, a file, or a device (docs/devices.md)"
ADDRESS_MAX_CHARS = 1000
"""The full address is shown to the operator before connecting."""
SHARED_LINK = "board"
"""Name of a link that carries several streams."""
SERIAL_ROUTE = Route(usage="/dev/ttyUSB0", form=Form.SERIAL, transport="serial")
FILE_ROUTE = Route(usage="file:PATH", form=Form.PATH, transport="file")

QUEUED_MAX_BYTES = 1 << 20
"""Bytes of a link that may wait in the queue: a second of the fastest devices, a tenth of a second of work."""
CHUNK_MEMORY_OVERHEAD_BYTES = 200
"""Memory of a chunk beyond its bytes, so that many small chunks count, too."""
ITEMS_AT_ONCE, BYTES_AT_ONCE = 64, 1 << 15
"""Items that are processed together, and their bytes: a second or some of a recording, and 0.01 s of work."""
DROP_BYTES_AFTER_OVERFLOW_FOR_NS = 500_000_000
"""ns. A link that is too fast is dropped for this long, so that it causes at most two messages a second."""
READ_TIMEOUT_S = 0.1
"""s. Longest wait in one read, and so until a stop is noticed."""
RETRY_S, RETRY_MAX_S = 0.1, 5.0
"""s. Pause before a link is opened again; it doubles with each short connection, up to the maximum."""
MAX_RETRY_DELAY_DOUBLINGS = 6
CONNECTION_STABLE_AFTER_S = 1.0
"""s. A connection that ends sooner is short: a server that has no room closes it at once."""
THREAD_JOIN_TIMEOUT_S = 2.0
"""s. Longest wait for the thread at a stop: longer than a connection may take."""
BACKPRESSURE_MAX_S, BACKPRESSURE_POLL_S = 5.0, 0.02
"""s. A device that must not lose bytes is not read for so long while the queue is full; the system keeps some of TCP."""
REPORT_NEW_OPEN_ERROR_AFTER_S = 1.0
"""s. A new reason why a lost link does not open is reported when it has lasted so long: a port that comes back may deny
access until the system has set its owner."""
EXPECTED_WHILE_LOST = (FailureKind.ABSENT, FailureKind.REFUSED)
"""Failures that only say that the link is still away."""
STATE_AFTER_FAILURE = {FailureKind.ENDED: LinkState.ENDED, FailureKind.PROTOCOL_ERROR: LinkState.FAILED}
"""State of a link that is not opened again."""


SIMULATED_ADDRESS = "simulated:"
"""Begins the address of a link that a simulator fed while it recorded: nothing can be connected there."""


@dataclass(frozen=True, slots=True)
class LinkSpec:
    """A link as the operator describes it; `InputError` if its address is too long."""

    name: str
    """Unique in a session, such as `"wrench"`."""
    address: str
    """`/dev/ttyUSB0`, `COM3`, either with `@921600` for its baud rate; `file:PATH` or a file's path; a device's address
    (`skincal.devices.registry`)."""
    carries: tuple[Stream, ...]
    format: str = AUTO_FORMAT
    """One of `skincal.streams.decoders.auto_detect.NAMES`."""

    def __post_init__(self) -> None:
        _check_length(self.address)

    @property
    def is_simulated(self) -> bool:
        """Whether a simulator fed the link while it recorded."""
        return self.address.startswith(SIMULATED_ADDRESS)


def _check_length(address: str) -> None:
    if len(address) > ADDRESS_MAX_CHARS:
        raise InputError(f"{address}: the address has {len(address)} characters; expected at most {ADDRESS_MAX_CHARS}.")


def parse_address(address: str) -> DeviceAddress:
    """Read an address. Nothing is opened.

    Raises InputError: the address is empty, too long, or not valid, or neither a port nor a file can be there.
    """
    device = _read_address(address)
    if device.route is SERIAL_ROUTE and address.startswith("/") and not _may_be_path(device.path):
        raise InputError(
            f"{address}: there is no such port or file. A topic of ROS 2 begins with ros2: (type ros2:{address}), or is "
            f"behind a rosbridge server (rosbridge://HOST:PORT{address})."
        )
    return device


def _read_address(address: str) -> DeviceAddress:
    """Read an address, as `parse_address`, also of a port or file that was there while a session was recorded."""
    if not address:
        raise InputError(f"The address is empty. Expected {ADDRESS_HELP}.")
    _check_length(address)
    device = parse_device(address)
    if device is not None:
        _part_of(device)
        return device
    place, options = _split_part(address)
    path, baud = split_baud(place)
    # Before unknown schemes: the name of an existing file may begin like one.
    if path.startswith(FILE_PREFIX) or _is_file(path):
        return DeviceAddress(address, FILE_ROUTE, path=path.removeprefix(FILE_PREFIX), baud=baud, options=options)
    advice = foreign_advice(address)
    if advice:
        raise InputError(f"{address}: {advice}")
    scheme = UNKNOWN_SCHEME_RE.match(address)
    if scheme is not None:
        raise InputError(f"{address}: skincal cannot open addresses that begin with {scheme[1]}:. Expected {ADDRESS_HELP}.")
    device = DeviceAddress(address, SERIAL_ROUTE, path=path, baud=baud, options=options)
    _part_of(device)
    return device


def _split_part(address: str) -> tuple[str, dict[str, str]]:
    """Split `PORT?channels=0-15`; a question mark before anything else is part of a name."""
    place, mark, query = address.rpartition("?")
    options = dict(parse_qsl(query, keep_blank_values=True))
    return (place, options) if mark and "channels" in options and {*options} <= {"channels", "of"} else (address, {})


def _part_of(address: DeviceAddress) -> BoardPart | None:
    """Return the part of a board that an address names. Raises InputError."""
    try:
        return read_part(address.options)
    except InputError as error:
        raise InputError(f"{address.text}: {error}") from error


def make_link_decoder(address: str, format_name: str, channels: int | None, carries: tuple[Stream, ...]) -> LinkDecoder:
    """Make the decoder of a link: of a part of a board if its address names one. A recorded command names none."""
    try:
        part = _part_of(_read_address(address)) if "channels=" in address else None
    except InputError:
        part = None
    if part is None:
        return LinkDecoder(format_name, channels, carries)
    return PartDecoder(part, format_name, channels, carries)


def _may_be_path(path: str) -> bool:
    """Check whether a path is there, or may still come: a port in `/dev`, or a pty that another program is about to name."""
    folder = Path(path).parent
    try:
        return "?" not in path and (
            path.startswith("/dev/") or Path(path).exists() or (folder != folder.parent and folder.is_dir())
        )
    except OSError:  # such as a name that is too long
        return False


def _is_file(path: str) -> bool:
    try:
        return Path(path).is_file()
    except OSError:  # such as a name that is too long
        return False


def _device_route(address: str) -> Route | None:
    """Return the route of a device's address; `None` for other and wrong addresses."""
    try:
        device = parse_device(address)
    except InputError:
        return None
    return None if device is None else device.route


def format_of(address: str, given: str) -> str:
    """Name the decoder of a link: the given one, or for `auto` the one of its address."""
    route = _device_route(address) if given == AUTO_FORMAT else None
    return given if route is None else route.format


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
    is_cancelled : whether to give up; asked from any thread while opening takes seconds
    """
    try:
        address = _read_address(spec.address)
    except InputError as error:
        raise LinkError(FailureKind.ADDRESS, str(error)) from error
    # Imported now: a program that opens no link needs no transport.
    from skincal.streams.opening import open_address

    return open_address(address, spec.carries, spec.format, is_cancelled)


def yarp_ports() -> list[tuple[str, tuple[str, int]]]:
    """List name, host and number of the ports that the name server of this machine's YARP knows. Raises LinkError."""
    from skincal.devices.yarp import ask_names, name_server
    from skincal.streams.opening import NetworkQuestions

    return sorted(ask_names("No YARP", name_server(), "", NetworkQuestions()).items())[:YARP_PORTS_LISTED_MAX]


class ChunkQueue:
    """Queue of the readers' chunks and events. Of each link at most `QUEUED_MAX_BYTES` wait. Safe from any thread.

    Bytes beyond that are dropped for `DROP_BYTES_AFTER_OVERFLOW_FOR_NS`, and a `LinkEvent` with their number takes their
    place. So garbage at the speed of a network does not slow other links, and nothing old is shown.
    """

    def __init__(self) -> None:
        self._queue: queue.SimpleQueue[Any] = queue.SimpleQueue()
        self._lock = threading.Lock()
        self._waiting: Counter[str] = Counter()
        """Memory of the waiting chunks of each link, bytes."""
        self._unhurried = frozenset[str]()
        """Links whose chunks end no wait."""
        self._others_came = threading.Event()
        self._dropping: dict[str, tuple[int, int]] = {}
        """By link: until when its bytes are dropped, ns, and how many were."""

    def put(self, item: Any) -> bool:
        """Add an item to the queue; return `False` for a `Chunk` that does not fit."""
        with self._lock:
            if isinstance(item, Chunk):
                until_ns, dropped = self._dropping.get(item.link, (item.host_ns, 0))
                if not self._fits(item) or item.host_ns < until_ns:
                    until_ns = until_ns if item.link in self._dropping else item.host_ns + DROP_BYTES_AFTER_OVERFLOW_FOR_NS
                    self._dropping[item.link] = until_ns, dropped + len(item.data)
                    return False
                self._waiting[item.link] += len(item.data) + CHUNK_MEMORY_OVERHEAD_BYTES
            if isinstance(item, Chunk | LinkEvent):
                self._report_dropped(item.link, item.host_ns)  # before the item: bytes were dropped while the link was open
            self._queue.put(item)
            if not isinstance(item, Chunk) or item.link not in self._unhurried:
                self._others_came.set()
            return True

    def _fits(self, chunk: Chunk) -> bool:
        return self._waiting[chunk.link] + len(chunk.data) <= QUEUED_MAX_BYTES

    def has_room(self, chunk: Chunk) -> bool:
        """Check whether the queue has room for a chunk."""
        with self._lock:
            return self._fits(chunk)

    def _report_dropped(self, link: str, host_ns: int) -> None:
        if link in self._dropping:
            _, dropped = self._dropping.pop(link)
            text = f"{link} sends more than can be read: {dropped} bytes were dropped; check its format and its rate."
            self._queue.put(LinkEvent(link, host_ns, LinkState.OPEN, text, dropped))

    def get(self, timeout: float | None = None) -> Any:
        """Return the next item. Raises `queue.Empty` if none comes within `timeout`, seconds."""
        item = self._queue.get(timeout=timeout)
        if isinstance(item, Chunk):
            with self._lock:
                self._waiting[item.link] -= len(item.data) + CHUNK_MEMORY_OVERHEAD_BYTES
        return item

    def wait_for_others(self, links: frozenset[str], timeout: float) -> None:
        """Wait until something other than chunks of some links was put since the last call, at most `timeout`, seconds."""
        self._unhurried = links
        self._others_came.wait(timeout)
        self._others_came.clear()

    @property
    def is_full(self) -> bool:
        """Whether so much waits that it is processed at once."""
        return self._queue.qsize() >= ITEMS_AT_ONCE

    def get_many(self, timeout: float) -> list[Any]:
        """Return one to `ITEMS_AT_ONCE` items, fewer once they have `BYTES_AT_ONCE`.

        Raises `queue.Empty` if none comes within `timeout`, seconds.
        """
        found = [self.get(timeout)]
        size = _size_of(found[0])
        while len(found) < ITEMS_AT_ONCE and size < BYTES_AT_ONCE and not self._queue.empty():
            found.append(self.get())
            size += _size_of(found[-1])
        return found

    def empty(self) -> bool:
        """Check whether nothing waits. If a link fell silent while its bytes were dropped, this is reported now."""
        if self._dropping and self._queue.empty():
            self._report_all(time.monotonic_ns())
        return self._queue.empty()

    def finish(self) -> None:
        """Report all dropped bytes, as nothing more comes."""
        self._report_all(None)

    def _report_all(self, due_ns: int | None) -> None:
        with self._lock:
            for link in [link for link, (until_ns, _) in self._dropping.items() if due_ns is None or due_ns >= until_ns]:
                self._report_dropped(link, time.monotonic_ns())


def _size_of(item: Any) -> int:
    return len(item.data) if isinstance(item, Chunk) else 0


class Reader:
    """Reads one link into a queue, in one daemon thread, and opens a lost link again.

    Events: OPEN when the link opens; FAILED if it cannot be opened at first, LOST when it vanished, each with a sentence, and
    again for a new reason; ENDED at the end of a file. It tries to open the link until `stop`, except after an end and for a
    wrong address. Silence causes no event. After a short connection OPEN is reported only when bytes arrive or after
    `CONNECTION_STABLE_AFTER_S`, so that a server that keeps closing the connection causes one message.
    """

    def __init__(self, spec: LinkSpec, items: ChunkQueue | queue.SimpleQueue[Chunk | LinkEvent]) -> None:
        self._spec = spec
        self._items = items
        route = _device_route(spec.address)
        self._needs_every_byte = route is not None and route.needs_every_byte
        self._stop = threading.Event()
        self._thread = threading.Thread(target=self._run, name=f"reader {spec.name}", daemon=True)
        self._was_open = False
        self._opened_s, self._open_was_reported = 0.0, False
        self._short_connections = 0
        """Short connections in a row."""
        self._reported = ""
        """Sentence of the last event."""
        self._reason, self._reason_since_s = "", 0.0
        """A new reason that is not reported yet, and since when it holds."""

    def start(self) -> None:
        """Begin to read."""
        self._thread.start()

    def halt(self) -> None:
        """Stop after the read in progress. Returns at once; the thread closes the link."""
        self._stop.set()

    def stop(self) -> None:
        """Stop reading and close the link. Waits for the thread, at most two seconds."""
        self.halt()
        # A thread that was never started cannot be joined: Python raises.
        if self._thread.ident is not None:
            self._thread.join(THREAD_JOIN_TIMEOUT_S)

    @property
    def running(self) -> bool:
        """Whether the thread still reads, or tries to open the link."""
        return self._thread.is_alive()

    def _run(self) -> None:
        try:
            while not self._stop.is_set() and self._connect():
                self._stop.wait(min(RETRY_S * 2 ** min(self._short_connections, MAX_RETRY_DELAY_DOUBLINGS), RETRY_MAX_S))
        except Exception as error:  # noqa: BLE001 - nothing above catches it: the operator must be told
            self._report(LinkState.FAILED, f"Reading stopped by a fault of the program: {error!r}.")

    def _connect(self) -> bool:
        """Open the link and read it until it fails or is stopped; return whether to try again."""
        try:
            link = open_link(self._spec, self._stop.is_set)
        except LinkError as failure:
            if not self._stop.is_set():
                self._report_closed(failure)
            return failure.kind is not FailureKind.ADDRESS
        self._was_open, self._opened_s, self._open_was_reported = True, time.monotonic(), False
        if not self._short_connections:
            self._report_open()
        try:
            self._read(link)
        except LinkError as failure:
            self._short_connections = (
                self._short_connections + 1 if time.monotonic() - self._opened_s < CONNECTION_STABLE_AFTER_S else 0
            )
            if self._open_was_reported or failure.kind in STATE_AFTER_FAILURE:
                self._report(STATE_AFTER_FAILURE.get(failure.kind, LinkState.LOST), str(failure))
            else:
                self._report_closed(failure)
            return failure.kind not in STATE_AFTER_FAILURE
        finally:
            link.close()
        return False

    def _read(self, link: Link) -> None:
        bauds_tried: tuple[int, ...] = ()
        while not self._stop.is_set():
            data = link.read(READ_TIMEOUT_S)
            if not self._open_was_reported and (data or time.monotonic() - self._opened_s >= CONNECTION_STABLE_AFTER_S):
                self._report_open()
            # Dated at once, by a clock that cannot be set back while a session runs.
            if data:
                self._enqueue(Chunk(self._spec.name, time.monotonic_ns(), data))
            tried = link.tried
            if len(tried) > 1 and tried != bauds_tried:
                bauds_tried = tried
                self._items.put(LinkEvent(self._spec.name, time.monotonic_ns(), LinkState.OPEN, tried=tried))

    def _enqueue(self, chunk: Chunk) -> None:
        """Queue a chunk. If the device must not lose bytes, wait for room first."""
        until_s = time.monotonic() + BACKPRESSURE_MAX_S
        while self._needs_every_byte and isinstance(self._items, ChunkQueue) and not self._items.has_room(chunk):
            if self._stop.wait(BACKPRESSURE_POLL_S) or time.monotonic() > until_s:
                break
        if self._items.put(chunk) is False and self._needs_every_byte:
            self._stop.wait(DROP_BYTES_AFTER_OVERFLOW_FOR_NS * 1e-9)
            raise LinkError(FailureKind.VANISHED, f"{self._spec.address}: bytes were dropped, so it is connected again.")

    def _report_closed(self, failure: LinkError) -> None:
        """Report why the link is not open: at once the first time, later only a new reason that lasts."""
        sentence, now_s = str(failure), time.monotonic()
        if not self._reported:
            self._report(LinkState.FAILED, sentence)
        elif sentence == self._reported or (self._was_open and failure.kind in EXPECTED_WHILE_LOST):
            self._reason = ""
        elif sentence != self._reason:
            self._reason, self._reason_since_s = sentence, now_s
        elif now_s - self._reason_since_s >= REPORT_NEW_OPEN_ERROR_AFTER_S:
            self._report(LinkState.LOST if self._was_open else LinkState.FAILED, sentence)

    def _report_open(self) -> None:
        self._open_was_reported = True
        self._report(LinkState.OPEN)

    def _report(self, state: LinkState, sentence: str = "") -> None:
        self._reported, self._reason = sentence, ""
        self._items.put(LinkEvent(self._spec.name, time.monotonic_ns(), state, sentence))
