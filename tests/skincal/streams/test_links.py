"""Links and reader threads for real: ptys that vanish and return, TCP servers that restart, files, and clear refusals."""

import errno
import os
import queue
import re
import socket
import sys
import time
from contextlib import closing, contextmanager
from pathlib import Path

import numpy as np
import pytest
import serial

from skincal.model.errors import InputError
from skincal.model.readings import LinkState, Stream
from skincal.streams import links
from skincal.streams.links import (
    REPORT_NEW_OPEN_ERROR_AFTER_S,
    FailureKind,
    LinkError,
    LinkSpec,
    Reader,
    describe_links,
    open_link,
    parse_address,
)
from tests.approved import approved, approved_pattern
from tests.skincal.poke_script import skt_line
from tests.skincal.streams.link_support import PATIENCE_S, next_data, next_event, reading, spec

LOST_WITHIN_S = 0.3

NO_SOCKETS = [
    "socket://", "socket://[::1", "socket://host", "socket://host:port", "socket://:7000", "socket://h:99999", "socket://a..b:1",
    f"socket://{'a' * 70}:1", "socket://192.168.1.1@elsewhere:7000",
]  # fmt: skip
STRANGE = [
    "spy://{port}?file={path}", "SPY:///dev/null?file={path}", "alt://{port}?class=PosixPollSerial", "hwgrep://.*", "loop://",
    "rfc2217://127.0.0.1:1", "cp2110://0", "http://127.0.0.1:1", "Socket://h:1", "simulated:wrench", "nothing://x@9600",
]  # fmt: skip
needs_pty = pytest.mark.skipif(not hasattr(os, "openpty"), reason="this platform has no pty")


class Pty:
    """The device's end of a pseudo-terminal."""

    def __init__(self):
        import tty

        self.master, slave = os.openpty()
        tty.setraw(slave)
        self.path = os.ttyname(slave)
        # Open while the device is: a pty whose last reader closes would look unplugged to the next.
        self._slave = slave

    def write(self, data):
        os.write(self.master, data)

    def unplug(self):
        if self.master >= 0:
            os.close(self._slave)
            os.close(self.master)
            self.master = -1


@contextmanager
def pty():
    device = Pty()
    try:
        yield device
    finally:
        device.unplug()


# ------------------------------------------------------------------ a real pty


@needs_pty
def test_stream_at_1_khz_over_a_pty_is_whole_and_prompt():
    with pty() as device, reading(device.path) as items:
        next_event(items, LinkState.OPEN)
        sent_ns = []
        begun = time.monotonic()
        for i in range(800):
            delay = begun + i * 0.001 - time.monotonic()
            if delay > 0:
                time.sleep(delay)
            sent_ns.append(time.monotonic_ns())
            device.write(i.to_bytes(4, "little") * 9)
        chunks, count = [], 0
        while count < 800 * 36:
            chunk = items.get(timeout=PATIENCE_S)
            chunks.append(chunk)
            count += len(chunk.data)
        data = b"".join(chunk.data for chunk in chunks)
        assert data == b"".join(i.to_bytes(4, "little") * 9 for i in range(800))
        stamps = [chunk.host_ns for chunk in chunks]
        assert stamps == sorted(stamps)
        ends = np.cumsum([len(chunk.data) for chunk in chunks])
        late_ms = [
            (chunk.host_ns - sent_ns[min(end // 36, 800) - 1]) * 1e-6
            for chunk, end in zip(chunks, ends, strict=True)
            if end >= 36
        ]
        assert np.median(late_ms) < 20


@needs_pty
def test_unplugged_is_said_in_time_and_the_port_is_taken_up_again_by_itself(tmp_path):
    """The device returns under another number, as after a replug; a stable name leads to it."""
    port = tmp_path / "by-id"
    with pty() as first, pty() as second:
        port.symlink_to(first.path)
        with reading(port) as items:
            next_event(items, LinkState.OPEN)
            for round_number in range(3):
                device, other = (first, second) if round_number == 0 else (second, None)
                device.write(b"before")
                assert next_data(items, 6) == b"before"
                if other is None:
                    break
                unplugged_ns = time.monotonic_ns()
                device.unplug()
                event = next_event(items, LinkState.LOST)
                assert (event.host_ns - unplugged_ns) * 1e-9 < LOST_WITHIN_S
                assert "was lost" in event.text
                assert str(port) in event.text
                port.unlink()
                time.sleep(0.3)
                assert items.empty()  # trying again is silent
                port.symlink_to(other.path)
                next_event(items, LinkState.OPEN)


@needs_pty
def test_port_that_comes_later_is_opened_then(tmp_path):
    port = tmp_path / "tty"
    with reading(port) as items:
        event = next_event(items, LinkState.FAILED)
        assert event.text == approved("links.no_port", port=port)
        with pty() as device:
            port.symlink_to(device.path)
            next_event(items, LinkState.OPEN)
            device.write(b"alive")
            assert next_data(items, 5) == b"alive"


@needs_pty
def test_port_in_use_is_said_and_taken_when_it_is_free():
    with pty() as device:
        other = serial.Serial(device.path, exclusive=True)
        with pytest.raises(LinkError, match=approved_pattern("links.in_use")) as failure:
            open_link(spec(device.path))
        assert failure.value.kind is FailureKind.IN_USE
        with reading(device.path) as items:
            assert approved("links.in_use") in next_event(items, LinkState.FAILED).text
            other.close()
            next_event(items, LinkState.OPEN)


@needs_pty
def test_port_taken_by_another_program_while_away_is_said_after_a_while(tmp_path):
    port = tmp_path / "tty"
    with pty() as first, pty() as second:
        port.symlink_to(first.path)
        with reading(port) as items:
            next_event(items, LinkState.OPEN)
            with closing(serial.Serial(second.path, exclusive=True)):
                port.unlink()
                port.symlink_to(second.path)
                first.unplug()
                next_event(items, LinkState.LOST)
                taken = next_event(items, LinkState.LOST, REPORT_NEW_OPEN_ERROR_AFTER_S + PATIENCE_S)
                assert approved("links.in_use") in taken.text
            next_event(items, LinkState.OPEN)


@needs_pty
def test_commands_reach_the_device_and_any_baud_rate_is_taken():
    with pty() as device:
        for baud in (19200, 460800, 2_000_000):
            with closing(open_link(spec(f"{device.path}@{baud}"))) as link:
                link.write(b"?\n")
                assert os.read(device.master, 10) == b"?\n"


# ------------------------------------------------------------------ TCP


class Server:
    """A TCP server for one client."""

    def __init__(self, port=0):
        self._listener = socket.create_server(("127.0.0.1", port))
        self.port = self._listener.getsockname()[1]
        self.client = None

    def accept(self):
        self._listener.settimeout(PATIENCE_S)
        self.client, _ = self._listener.accept()
        return self.client

    def close(self):
        if self.client is not None:
            self.client.close()
        self._listener.close()


def test_server_that_restarts_is_taken_up_again_by_itself():
    server = Server()
    address = f"socket://127.0.0.1:{server.port}"
    with reading(address) as items:
        server.accept().sendall(b"one")
        next_event(items, LinkState.OPEN)
        assert next_data(items, 3) == b"one"
        closed_ns = time.monotonic_ns()
        server.close()
        event = next_event(items, LinkState.LOST)
        assert (event.host_ns - closed_ns) * 1e-9 < LOST_WITHIN_S
        assert "closed the connection" in event.text
        time.sleep(0.25)
        assert items.empty()
        server = Server(server.port)
        try:
            server.accept().sendall(b"two")
            next_event(items, LinkState.OPEN)
            assert next_data(items, 3) == b"two"
        finally:
            server.close()


def test_tcp_reads_and_writes():
    server = Server()
    with closing(server), closing(open_link(spec(f"socket://127.0.0.1:{server.port}"))) as link:
        client = server.accept()
        assert [link.read(0.05), link.read(0.0)] == [b"", b""]
        client.sendall(b"abc")
        assert link.read(1.0) == b"abc"
        link.write(b"?\n")
        assert client.recv(10) == b"?\n"


def test_tcp_peer_that_closes_while_the_link_is_set_up_is_said(monkeypatch):
    """On macOS a socket whose peer has closed already takes no options."""

    def refuse(_connection):
        raise OSError(errno.EINVAL, "Invalid argument")

    monkeypatch.setattr("skincal.streams.transports.tcp.enable_keepalive", refuse)
    with closing(Server()) as server, pytest.raises(LinkError, match=f"socket://127.0.0.1:{server.port}: "):
        open_link(spec(f"socket://127.0.0.1:{server.port}"))


# ------------------------------------------------------------------ files


def read_on(link, data):
    while True:
        data += link.read(0.1)


def test_file_plays_at_the_pace_of_its_device_and_ends(tmp_path):
    """Half a second of device time in few bytes: the device's clock sets the pace, not the baud rate."""
    path = tmp_path / "skin.log"
    path.write_bytes(b"".join(skt_line(f"T,{i},{1000 + i * 10_000},1,2,3,4") for i in range(60)))
    for address in (path, f"file:{path}"):
        with reading(address, (Stream.SKIN,)) as items:
            begun = next_event(items, LinkState.OPEN)
            assert next_data(items, path.stat().st_size) == path.read_bytes()
            event = next_event(items, LinkState.ENDED)
            assert 0.35 < (event.host_ns - begun.host_ns) * 1e-9 < 2.0
            assert "at its end" in event.text


def test_file_without_a_device_clock_plays_at_its_baud_rate(tmp_path):
    path = tmp_path / "skin.txt"
    path.write_bytes(b"1,2,3,4\n" * 480)
    with closing(open_link(LinkSpec("skin", f"{path}@115200", (Stream.SKIN,), "text"))) as link:
        begun = time.monotonic()
        data = bytearray()
        with pytest.raises(LinkError, match="at its end") as failure:
            read_on(link, data)
        assert failure.value.kind is FailureKind.ENDED
        assert data == path.read_bytes()
        assert 0.25 < time.monotonic() - begun < 2.0


# ------------------------------------------------------------------ refusals and addresses


@pytest.mark.parametrize(
    ("address", "kind", "words"),
    [
        *((address, FailureKind.ADDRESS, r"Example: socket://127\.0\.0\.1:7000") for address in NO_SOCKETS),
        ("socket://127.0.0.1:{free}", FailureKind.REFUSED, "socket://127.0.0.1:[0-9]+: connection refused"),
        ("file:/no/such.log", FailureKind.ABSENT, approved_pattern("links.no_file")),
        (os.devnull, FailureKind.ADDRESS, approved_pattern("links.no_serial_port")),
        ("/", FailureKind.ADDRESS, approved_pattern("links.no_serial_port")),
    ],
)
def test_what_cannot_be_opened_is_said(address, kind, words):
    with closing(socket.create_server(("127.0.0.1", 0))) as free:
        address = address.format(free=free.getsockname()[1])
    with pytest.raises(LinkError, match=words) as failure:
        open_link(spec(address))
    assert failure.value.kind is kind


@pytest.mark.parametrize("address", STRANGE)
def test_only_links_that_are_known_are_opened(tmp_path, monkeypatch, address):
    monkeypatch.setattr(serial, "Serial", lambda *_, **__: pytest.fail("pyserial was asked"))
    kept = tmp_path / "kept.txt"
    kept.write_text("a thesis")
    address = address.format(port="/dev/ttyUSB0", path=kept)
    with pytest.raises(InputError) as error:
        parse_address(address)
    begins = address.partition(":")[0]
    assert approved("links.refused_scheme", address=address, scheme=begins) in str(error.value)
    with pytest.raises(LinkError) as failure:
        open_link(spec(address))
    assert failure.value.kind is FailureKind.ADDRESS
    assert str(failure.value) == str(error.value)
    with pytest.raises(InputError, match="begin with"):
        describe_links({Stream.WRENCH: "/dev/ttyUSB0", Stream.SKIN: address})
    assert kept.read_text() == "a thesis"


@pytest.mark.parametrize(
    ("address", "kind", "place", "number"),
    [
        ("/dev/ttyUSB0@460800", "serial", "/dev/ttyUSB0", 460800),
        ("COM3", "serial", "COM3", 0),
        (r"\\.\COM12@9600", "serial", r"\\.\COM12", 9600),
        ("/dev/pts/7", "serial", "/dev/pts/7", 0),
        ("/dev/serial/by-id/usb-a:b-if00", "serial", "/dev/serial/by-id/usb-a:b-if00", 0),
        ("socket://127.0.0.1:7000", "tcp", "127.0.0.1", 7000),
        ("file:C:/logs/skin.bin@9600", "file", "C:/logs/skin.bin", 9600),
        (__file__, "file", __file__, 0),
        ("/dev/by-id/x@y", "serial", "/dev/by-id/x@y", 0),
        ("/dev/x@y@9600", "serial", "/dev/x@y", 9600),
        (f"./{'a' * 300}", "serial", f"./{'a' * 300}", 0),
        # The slashes say which Bota it is.
        ("bota:/dev/ttyUSB0", "serial", "/dev/ttyUSB0", 460800),
        ("bota:///dev/ttyACM0?baud=230400", "command", "/dev/ttyACM0", 0),
        ("bota:///COM7", "command", "COM7", 0),
        ("bota://192.168.0.45?mode=1&submode=3", "command", "192.168.0.45", 0),
        ("bota://dummy", "command", "dummy", 0),
    ],
)
def test_what_an_address_names(address, kind, place, number):
    found = parse_address(address)
    assert (found.route.transport, found.host or found.path, found.baud or found.port) == (kind, place, number)


def test_a_port_s_name_is_never_a_url(monkeypatch):
    """Were the check above gone, pyserial still would not look for a handler of `spy://`."""
    monkeypatch.setattr(links, "UNKNOWN_SCHEME_RE", re.compile("(?!)(x)"))
    with pytest.raises(LinkError, match=approved_pattern("links.no_port_begin")) as failure:
        open_link(spec("spy:///dev/null"))
    assert failure.value.kind is FailureKind.ABSENT


@pytest.mark.parametrize("address", ["", "nothing://x"])
def test_address_that_cannot_be_right_is_said_once_and_left(address):
    items = queue.SimpleQueue()
    reader = Reader(spec(address), items)
    reader.start()
    event = next_event(items, LinkState.FAILED)
    assert approved("links.no_address") in event.text
    time.sleep(0.3)
    assert not reader.running
    assert items.empty()
    reader.stop()


WINDOWS_DENIED = "could not open port 'COM3': PermissionError(13, 'Access is denied.', None, 5)"
WINDOWS_ABSENT = "could not open port 'COM9': FileNotFoundError(2, 'The system cannot find the file', None, 2)"


@pytest.mark.parametrize(
    ("platform", "error", "kind", "words"),
    [
        ("linux", serial.SerialException(errno.EACCES, "denied"), FailureKind.DENIED, "dialout"),
        ("darwin", serial.SerialException(errno.EACCES, "denied"), FailureKind.DENIED, "permission denied"),
        ("linux", serial.SerialException(errno.EBUSY, "busy"), FailureKind.IN_USE, approved("links.in_use")),
        ("linux", serial.SerialException(errno.ENOENT, "none"), FailureKind.ABSENT, approved("links.no_port_begin")),
        ("win32", serial.SerialException(WINDOWS_DENIED), FailureKind.IN_USE, approved("links.in_use")),
        ("win32", serial.SerialException(WINDOWS_ABSENT), FailureKind.ABSENT, approved("links.no_port_begin")),
        ("linux", OSError(errno.EPROTO, "odd"), FailureKind.OTHER, "cannot be opened"),
    ],
)
def test_what_the_system_says_becomes_a_sentence(monkeypatch, platform, error, kind, words):
    def refuse(*_args, **_kwargs):
        raise error

    monkeypatch.setattr(serial, "Serial", refuse)
    monkeypatch.setattr("skincal.streams.transports.serial_port.sys.platform", platform)
    with pytest.raises(LinkError, match=words) as failure:
        open_link(spec("/dev/ttyX"))
    assert failure.value.kind is kind


def test_fault_in_the_thread_arrives_as_a_message(monkeypatch):
    def broken(*_):
        raise ZeroDivisionError("oops")

    monkeypatch.setattr("skincal.streams.links.open_link", broken)
    items = queue.SimpleQueue()
    reader = Reader(spec("x"), items)
    reader.start()
    assert "ZeroDivisionError" in next_event(items, LinkState.FAILED).text
    reader.stop()


def test_serial_is_imported_only_when_a_port_is_opened():
    import subprocess

    code = "import sys, skincal.streams.intake, skincal.streams.links; sys.exit('serial' in sys.modules)"
    assert subprocess.run([sys.executable, "-c", code], check=False, cwd=Path(__file__).parents[3]).returncode == 0


def test_one_address_for_several_streams_is_one_board():
    wrench, skin, joints = Stream.WRENCH, Stream.SKIN, Stream.JOINTS
    for addresses, expected in (
        (("a", "a", "a"), [("board", (wrench, skin, joints))]),
        (("a", "b", "b"), [("wrench", (wrench,)), ("board", (skin, joints))]),
        (("a", "b", None), [("wrench", (wrench,)), ("skin", (skin,))]),
    ):
        links = describe_links(dict(zip((wrench, skin, joints), addresses, strict=True)))
        assert [(link.name, link.carries) for link in links] == expected
