"""Devices that are spoken to, over real sockets: they vanish, return, refuse, fall silent, and lie."""

import os
import socket
import subprocess
import sys
import threading
import time
from contextlib import closing, contextmanager, suppress
from pathlib import Path

import pytest

from skincal.devices.link import FailureKind, LinkError
from skincal.devices.rtde import RtdeHandshake
from skincal.devices.yarp import name_server, read_names
from skincal.model.errors import ERROR_SENTENCE_MAX_CHARS, InputError
from skincal.model.readings import Chunk, LinkEvent, LinkState, Loss, Stream
from skincal.simulation.emulated_devices import MAKERS, NameTalk, PlainTalk, RdtEncoder, RtdeTalk, XelaTalk, YarpEncoder
from skincal.simulation.emulated_transports import MakerOutlets, TalkOutlet
from skincal.streams import links
from skincal.streams.expected_readings import ExpectedReadings
from skincal.streams.intake import Intake
from skincal.streams.links import ADDRESS_MAX_CHARS, ChunkQueue, Reader, format_of, open_link, parse_address
from skincal.streams.opening import ANSWER_MAX_BYTES, HandshakeLink
from tests.approved import approved
from tests.skincal.meanwhile import meanwhile
from tests.skincal.streams.link_support import PATIENCE_S, WRENCH, next_event, reading, spec

TURN = threading.Lock()
"""An outlet is polled and written to by one thread at a time."""


def say(outlet, data):
    with TURN:
        outlet.write(data)


@contextmanager
def served(*outlets):
    """Outlets that a thread keeps polling."""

    def poll(over):
        while not over.wait(0.005):
            for outlet in outlets:
                with TURN:
                    outlet.poll()

    try:
        with meanwhile(poll):
            yield outlets
    finally:
        for outlet in outlets:
            outlet.close()


def readings_from(items, write, want=3, intake=None):
    """Write again and again until so many readings arrived."""
    intake = intake or Intake(ExpectedReadings(4), [spec("yarp:/x")])
    end = time.monotonic() + PATIENCE_S
    while intake.health(0)[0].readings < want:
        assert time.monotonic() < end
        write()
        time.sleep(0.02)
        while not items.empty():
            intake.feed(items.get())
    return intake.health(0)[0]


def free_port():
    with closing(socket.create_server(("127.0.0.1", 0))) as server:
        return server.getsockname()[1]


def refusal(address, carries=WRENCH):
    with pytest.raises(LinkError) as failure:
        open_link(spec(address, carries)).close()
    return str(failure.value)


class Answering(PlainTalk):
    """A server that answers whoever speaks with the same bytes."""

    def __init__(self, answer):
        super().__init__()
        self._answer = answer

    def on_request(self, _data):
        answer, self._answer = self._answer, b""
        return answer


def lying(answer, form):
    return TalkOutlet(lambda: Answering(answer), form)


# ------------------------------------------------------------------ YARP


def test_yarp_port_that_returns_under_another_number_is_found_again():
    encoder, makers = YarpEncoder(), MakerOutlets(64)
    first = makers.open("yarp", Stream.WRENCH, tcp=True)
    shared = first._shared
    with served(*shared), reading(first.address) as items:
        with served(first):
            next_event(items, LinkState.OPEN)
            readings_from(items, lambda: say(first, encoder.record(Stream.WRENCH, 1, [1.0] * 6)))
            first._shared = ()  # the name server outlives the port
        next_event(items, LinkState.LOST)
        second = makers.open("yarp", Stream.WRENCH, tcp=True)
        assert (second.address, second.port != first.port) == (first.address, True)
        second._shared = ()
        with served(second):
            next_event(items, LinkState.OPEN)
            readings_from(items, lambda: say(second, encoder.record(Stream.WRENCH, 2, [1.0] * 6)))


def test_yarp_address_that_cannot_be_reached_is_said_as_the_name_server_gave_it():
    number = free_port()
    with served(TalkOutlet(lambda: NameTalk({"/icub/x": number}), "yarp://127.0.0.1:{}/icub/x")) as (names,):
        said = refusal(names.address)
        assert f"127.0.0.1:{number} by the name server" in said
        assert approved("devices.robots_own_view") in said


def test_a_device_that_talks_and_never_agrees_is_not_kept():
    """At the speed of a network it would bring a gigabyte before the time is over."""
    sent = 0

    class Chatter:
        def read(self, _timeout_s):
            nonlocal sent
            sent += 60_000
            return (60_000).to_bytes(2, "big") + b"M" + bytes(59_997)

        def write(self, data):
            pass

        def close(self):
            pass

    with pytest.raises(LinkError, match="does not answer"):
        HandshakeLink("rtde://h", Chatter(), RtdeHandshake(WRENCH))
    assert sent <= ANSWER_MAX_BYTES + 120_000


def test_what_a_device_says_is_made_plain_and_short():
    failure = LinkError(FailureKind.OTHER, f"x: \x1b[2J{'word ' * 1000}; look at it.")
    assert len(str(failure)) <= ERROR_SENTENCE_MAX_CHARS
    assert "\x1b" not in str(failure)
    assert str(failure).endswith("; look at it.")


def test_a_name_server_that_is_none_or_knows_no_such_port():
    assert "connection refused" in refusal(f"yarp://127.0.0.1:{free_port()}/x")
    known = b"registration name /icub/head/state:o ip 127.0.0.1 port 10000 type tcp\r\n*** end of message\r\n"
    for answer, words in (
        (b"SSH-2.0-OpenSSH_9\r\n", "is no YARP name server"),
        (b"registration " * 300_000, "is no YARP name server"),
        (known, "knows no port /x; it knows 1 ports, such as /icub/head/state:o"),
    ):
        with served(lying(answer, "yarp://127.0.0.1:{}/x")) as (names,):
            assert words in refusal(names.address)


def test_yarp_server_of_this_machine_is_read_from_its_files(tmp_path, monkeypatch):
    monkeypatch.setenv("YARP_CONFIG_HOME", str(tmp_path))
    assert name_server() == ("127.0.0.1", 10000)
    (tmp_path / "yarp.conf").write_text("10.0.0.5 10010 yarp\n")
    assert name_server() == ("10.0.0.5", 10010)
    (tmp_path / "yarp_namespace.conf").write_text("/lab\n")
    (tmp_path / "_lab.conf").write_text("10.0.0.6 10011 yarp\n")
    assert name_server() == ("10.0.0.6", 10011)
    with (tmp_path / "yarp.conf").open("a") as file:
        file.truncate(1 << 40)
    (tmp_path / "yarp_namespace.conf").unlink()
    assert name_server() == ("127.0.0.1", 10000), "a file of a terabyte is none of YARP's"


def test_a_yarp_port_that_lies_costs_one_sentence():
    encoder, makers = YarpEncoder(), MakerOutlets(64)
    outlet = makers.open("yarp", Stream.WRENCH, tcp=True)
    with served(outlet), reading(outlet.address) as items:
        next_event(items, LinkState.OPEN)
        readings_from(items, lambda: say(outlet, encoder.record(Stream.WRENCH, 1, [1.0] * 6)))
        say(outlet, YARP_LIES["2 GB"][len(YARP_HELLO) :])
        assert approved("devices.read_no_further") in next_event(items, LinkState.FAILED).text
        say(outlet, bytes(100_000))
        time.sleep(0.5)
        assert items.empty()


# ------------------------------------------------------------------ ATI RDT


def test_netft_is_asked_again_when_it_falls_silent_and_gaps_are_counted():
    encoder = RdtEncoder()
    outlet = MakerOutlets(64).open("netft", Stream.WRENCH, tcp=True)
    with served(outlet), reading(outlet.address) as items:
        intake = Intake(ExpectedReadings(4), [spec(outlet.address)])
        readings_from(items, lambda: say(outlet, encoder.record(Stream.WRENCH, 1, [1.0] * 6)), 3, intake)
        outlet._host = None  # switched off and on, or another program stole the stream
        encoder._next_number.clear()
        health = readings_from(items, lambda: say(outlet, encoder.record(Stream.WRENCH, 1, [1.0] * 6)), 6, intake)
        assert health.state is LinkState.OPEN
        before = sum(health.losses.values())
        encoder._number(Stream.WRENCH), encoder._number(Stream.WRENCH)
        health = readings_from(items, lambda: say(outlet, encoder.record(Stream.WRENCH, 1, [1.0] * 6)), 12, intake)
        assert sum(health.losses.values()) - before == 2


@pytest.mark.parametrize("page", ["0", "70000"])
def test_netft_page_that_is_no_port_is_refused(page):
    assert "not a port in 1 ... 65535" in refusal(f"netft://127.0.0.1:9?page={page}")


def test_netft_without_its_page_says_what_to_give():
    said = refusal(f"netft://127.0.0.1:9?page={free_port()}")
    assert "connection refused" in said
    assert "?cpf=1000000&cpt=1000000" in said
    with served(lying(b"HTTP/1.0 200 OK\r\n\r\n<html>router</html></netft", "netft://127.0.0.1:9?page={}")) as (page,):
        assert "cfgcpf" in refusal(page.address)
    for wrong in ("cpf=x&cpt=1", "device=hexagon"):
        assert wrong.split("=")[1].split("&")[0] in refusal(f"netft://127.0.0.1:9?{wrong}")
    open_link(spec("netft://127.0.0.1:9?device=hex")).close()


# ------------------------------------------------------------------ Robotiq


@pytest.mark.skipif(not hasattr(os, "openpty"), reason="this platform has no pseudo-terminals")
def test_a_robotiq_stream_is_started_started_again_and_stopped_at_the_end():
    encoder, outlet = MAKERS["robotiq"].encoder(), MakerOutlets(4).open("robotiq", Stream.WRENCH, tcp=False)
    intake = Intake(ExpectedReadings(4), [spec(outlet.address)])
    with served(outlet):
        with reading(outlet.address) as items:
            readings_from(items, lambda: say(outlet, encoder.record(Stream.WRENCH, 1, [1.0] * 6)), 3, intake)
            with TURN:
                outlet._streams = False  # its power was off
            readings_from(items, lambda: say(outlet, encoder.record(Stream.WRENCH, 1, [1.0] * 6)), 9, intake)
            assert outlet._streams
            assert Loss.BAD_CHECKSUM not in intake.health(0)[0].losses, "its answer to the start is no loss"
        end = time.monotonic() + PATIENCE_S
        while outlet._streams and time.monotonic() < end:
            time.sleep(0.01)
        assert not outlet._streams


# ------------------------------------------------------------------ more than can be worked on


def test_what_comes_while_the_program_stands_still_waits_in_the_system_and_none_is_lost(monkeypatch):
    monkeypatch.setattr(links, "QUEUED_MAX_BYTES", 150_000)
    encoder, outlet, inbox = MAKERS["yarp"].encoder(), MakerOutlets(4).open("yarp", Stream.SKIN, tcp=True), ChunkQueue()
    address = spec(outlet.address, (Stream.SKIN,))
    intake, reader = Intake(ExpectedReadings(384), [address]), Reader(address, inbox)

    def write():
        say(outlet, encoder.record(Stream.SKIN, 1, [0.0] * 384))
        time.sleep(0.002)

    with served(outlet):
        reader.start()
        try:
            while_not(lambda: intake.health(0)[0].readings > 5, inbox, intake, write)
            for _ in range(200):  # nobody takes them: 600 kB
                write()
            while_not(lambda: intake.health(0)[0].readings > 200, inbox, intake, lambda: time.sleep(0.01))
        finally:
            reader.stop()
    (health,) = intake.health(0)
    assert {loss: count for loss, count in health.losses.items() if loss is not Loss.UNPAIRED} == {}


@pytest.mark.parametrize("maker", ["netft", "xela", "robotiq-text"])
def test_a_device_whose_bytes_were_dropped_is_read_on(maker, monkeypatch):
    """The program stood still: what comes after the gap is read, whether or not the protocol has a mark."""
    monkeypatch.setattr(links, "QUEUED_MAX_BYTES", 4000)
    monkeypatch.setattr(links, "BACKPRESSURE_MAX_S", 0.05)
    stream = Stream.SKIN if maker == "xela" else Stream.WRENCH
    encoder, outlet, inbox = MAKERS[maker].encoder(), MakerOutlets(4).open(maker, stream, tcp=True), ChunkQueue()
    count = 0

    def write():
        nonlocal count
        count += 1
        one = encoder.record(stream, count * 2000, [0.0] * 4 if stream is Stream.SKIN else [1.0] * 6)
        say(outlet, one)
        time.sleep(0.002)

    address = spec(outlet.address, (stream,))
    intake, reader = Intake(ExpectedReadings(4), [address]), Reader(address, inbox)
    with served(outlet):
        reader.start()
        try:
            while_not(lambda: intake.health(0)[0].readings > 20, inbox, intake, write)
            for _ in range(400):  # nobody takes them
                write()
            held = intake.health(0)[0].readings
            while_not(lambda: intake.health(0)[0].readings > held + 200, inbox, intake, write)
        finally:
            reader.stop()
    (health,) = intake.health(0)
    assert health.state is LinkState.OPEN
    assert health.losses[Loss.DROPPED] > 0


def while_not(done, inbox, intake, write):
    end = time.monotonic() + 4 * PATIENCE_S
    while not done():
        assert time.monotonic() < end, intake.health(0)
        write()
        while not inbox.empty():
            intake.feed(inbox.get())


# ------------------------------------------------------------------ RTDE, websockets


def test_controller_without_a_field_is_said(monkeypatch):
    monkeypatch.setattr(RtdeTalk, "KINDS", {k: v for k, v in RtdeTalk.KINDS.items() if k != b"ft_raw_wrench"})
    with served(TalkOutlet(RtdeTalk, "rtde://127.0.0.1:{}")) as (robot,):
        assert "has no ft_raw_wrench" in refusal(robot.address)


@pytest.mark.parametrize(
    ("answer", "form", "words"),
    [
        (b"\x00\x00V\x01", "rtde://127.0.0.1:{}", "no RTDE"),
        (b"\x00\x04V\x00", "rtde://127.0.0.1:{}", "version 2"),
        (b"", "rtde://127.0.0.1:{}", "does not answer"),
        (b"HTTP/1.1 404 Not Found\r\nContent-Length: 0\r\n\r\n", "xela://127.0.0.1:{}", "no websocket server"),
        (b"", "xela://127.0.0.1:{}", "no websocket server"),
        (b"nonsense " * 2000, "xela://127.0.0.1:{}", "no websocket server"),
    ],
)
def test_a_server_of_another_protocol_is_said(answer, form, words):
    with served(lying(answer, form)) as (server,):
        assert words in refusal(server.address, (Stream.SKIN,) if form.startswith("xela") else WRENCH)


@pytest.mark.parametrize(
    "frame",
    [
        b"\x81\x7f" + (2**31).to_bytes(8, "big"),  # 2 GB announced
        b"\x01\x7e\xff\xff" + b"1" * 65535 + (b"\x00\x7e\xff\xff" + b"1" * 65535) * 5,  # a message without an end
        b"\xf7\x00",  # no frame of the protocol
    ],
)
def test_websocket_that_lies_costs_one_sentence(frame, monkeypatch):
    monkeypatch.setattr(XelaTalk, "frame", lambda _self, data: data)
    with served(TalkOutlet(XelaTalk, "xela://127.0.0.1:{}")) as (server,), reading(server.address, (Stream.SKIN,)) as items:
        next_event(items, LinkState.OPEN)
        say(server, frame)
        assert approved("devices.read_no_further") in next_event(items, LinkState.FAILED).text
        time.sleep(0.4)
        assert all(isinstance(items.get(), Chunk) for _ in range(items.qsize()))


# ------------------------------------------------------------------ peers that lie


YARP_HELLO = b"YA" + (7).to_bytes(4, "little") + b"RP"
YARP_HEAD = b"YA\x0a\0\0\0RP\x01\x01" + b"\xff" * 8
MANY = 50_000


def yarp_frame(first, second=0):
    return YARP_HEAD + (first % 2**32).to_bytes(4, "little") + (second % 2**32).to_bytes(4, "little")


def rtde_packet(kind, length):
    return length.to_bytes(2, "big") + kind + bytes(length - 3)


RTDE_HELLO = b"\0\x04V\x01" + b"\0\x14O\x01DOUBLE,VECTOR6D" + b"\0\x04S\x01"
ENDLESS = {
    "a page without an end": ("netft://127.0.0.1:9?page={}", b"HTTP/1.0 200 OK\r\n\r\n<netft>", b"<a>b</a>" * MANY),
    "a page of heads": ("netft://127.0.0.1:9?page={}", b"HTTP/1.0 200 OK\r\n", b"X: y\r\n" * MANY),
    "names without an end": ("yarp://127.0.0.1:{}/x", b"", b"registration name /x " * MANY),
    "a name of megabytes": ("yarp://127.0.0.1:{}/x", b"registration name /", b"x" * MANY),
    "lines of words": ("lines://127.0.0.1:{}", b"", b"word " * MANY),
    "a line of digits": ("lines://127.0.0.1:{}", b"", b"1" * MANY),
    "a line of numbers": ("lines://127.0.0.1:{}", b"", b"1," * MANY),
    "text without a bracket": ("robotiq://127.0.0.1:{}", b"", b"1 , " * MANY),
    "brackets alone": ("robotiq://127.0.0.1:{}", b"", b"()" * MANY),
    "beginnings of frames": ("socket://127.0.0.1:{}", b"", bytes.fromhex("55667788") * MANY),
    "ends of frames": ("socket://127.0.0.1:{}", bytes.fromhex("55667788"), bytes.fromhex("AABBCCDD") * MANY),
    "heads of two makers": ("socket://127.0.0.1:{}", b"", b"\xaa\x20\x4e" * MANY),
    "a controller that only talks": ("rtde://127.0.0.1:{}", b"", rtde_packet(b"M", 65535)),
    "packets of another length": ("rtde://127.0.0.1:{}", RTDE_HELLO, rtde_packet(b"U", 65535)),
    "packets of nothing": ("rtde://127.0.0.1:{}", RTDE_HELLO, rtde_packet(b"U", 3) * MANY),
    "heads of a websocket": ("xela://127.0.0.1:{}", b"HTTP/1.1 101 Switching\r\n", b"X: y\r\n" * MANY),
    "a refusal of gigabytes": ("xela://127.0.0.1:{}", b"HTTP/1.1 404 No\r\nContent-Length: 9999999999\r\n\r\n", bytes(MANY)),
}
"""Of each liar the address, what it says first, and what it says then without an end."""
YARP_LIES = {
    "2 GB": YARP_HELLO + yarp_frame(2**31 - 1),
    "4 GB of two": YARP_HELLO + yarp_frame(2**31 - 1, 2**31 - 1),
    "negative": YARP_HELLO + yarp_frame(-1),
    "negative, and right in sum": YARP_HELLO + yarp_frame(-8, 16),
    "a port of another kind": b"220 ftp ready\r\n",
}


@contextmanager
def liar(first, then, pause_s=0.0):
    """A TCP server that says `first` to everybody who comes, then `then` for ever, or hangs up where that is empty."""
    server, came = socket.create_server(("127.0.0.1", 0)), []
    server.settimeout(0.05)

    def say_to(client, over):
        client.settimeout(0.2)
        with client, suppress(OSError):
            client.sendall(first)
            while then and not over.is_set():
                with suppress(TimeoutError):
                    client.sendall(then)
            over.wait(pause_s)

    def serve(over):
        while not over.is_set():
            with suppress(TimeoutError):
                client, _ = server.accept()
                came.append(client)
                say_to(client, over)

    with closing(server), meanwhile(serve):
        yield server.getsockname()[1], came


def heard_of(address, carries, seconds):
    """What is said of a link within so long while its bytes are worked on, without what says that bytes were dropped."""
    inbox, link = ChunkQueue(), spec(address, carries)
    intake, reader, said = Intake(ExpectedReadings(24), [link]), Reader(link, inbox), []
    reader.start()
    try:
        end = time.monotonic() + seconds
        while time.monotonic() < end:
            while not inbox.empty() and time.monotonic() < end:
                item = inbox.get()
                intake.feed(item)
                if isinstance(item, LinkEvent) and item.text and not item.dropped:
                    said.append(item.text)
            time.sleep(0.01)
    finally:
        reader.stop()
    assert not reader.running
    (health,) = intake.health(0)
    assert len(health.text) <= ERROR_SENTENCE_MAX_CHARS + 200
    assert health.readings < 10, "what a liar sends is no reading"
    return said


def held_mb():
    return int(Path("/proc/self/statm").read_text(encoding="ascii").split()[1]) * os.sysconf("SC_PAGE_SIZE") / 1e6


@pytest.mark.parametrize("name", ENDLESS)
def test_a_liar_without_an_end_costs_one_sentence_and_little_memory(name):
    form, first, then = ENDLESS[name]
    carries = (Stream.SKIN,) if form.startswith("xela") else WRENCH
    with liar(first, then) as (port, came):
        begun = held_mb() if sys.platform.startswith("linux") else 0.0
        said = heard_of(form.format(port), carries, 0.6)
        held = held_mb() - begun if sys.platform.startswith("linux") else 0.0
    assert came
    assert len(said) <= 1, said
    assert not any("fault of the program" in words for words in said)
    assert held < 40.0, f"{held:.0f} MB"


@pytest.mark.parametrize("name", YARP_LIES)
def test_a_name_server_that_sends_a_reader_to_a_liar_costs_one_sentence(name):
    with (
        liar(YARP_LIES[name], b"x" * MANY) as (number, came),
        served(TalkOutlet(lambda: NameTalk({"/x": number}), "yarp://127.0.0.1:{}/x")) as (names,),
    ):
        (said,) = heard_of(names.address, WRENCH, 1.0)
    assert came
    assert "no YARP port" in said or "announces a message of" in said or "no YARP message" in said


def test_a_name_server_with_numbers_that_no_port_has():
    answer = b"".join(b"registration name /%d ip 127.0.0.1 port %d type tcp\r\n" % (k, k) for k in (0, 80, 65535, 65536, 99999))
    assert read_names(answer) == {"/80": ("127.0.0.1", 80), "/65535": ("127.0.0.1", 65535)}


@pytest.mark.parametrize("first", [b"", b"Port already in use\r\n"], ids=["at once", "with a word"])
def test_a_server_that_hangs_up_on_everybody_is_asked_ever_later(first, monkeypatch):
    """As a serial server whose port has another reader: ten lines a second would hide all else."""
    monkeypatch.setattr(links, "RETRY_S", 0.02)
    with liar(first, b"") as (port, came):
        said = heard_of(f"socket://127.0.0.1:{port}", WRENCH, 1.2)
    assert 3 <= len(came) <= 6, "after 0, 0.04, 0.12, 0.28, 0.6 and 1.24 s"
    assert set(said) == {f"socket://127.0.0.1:{port}: {approved('devices.hung_up')}"}
    assert len(said) == (1 if not first else len(came))


# ------------------------------------------------------------------ addresses


@pytest.mark.parametrize(
    ("address", "form"),
    [
        ("netft://192.168.1.1", "rdt"), ("netft://[fe80::1]:49152?device=hex", "rdt"), ("yarp:/icub/x:o", "yarp-port"),
        ("yarp://10.0.0.1:10000/icub/x:o", "yarp-port"), ("bota:/dev/ttyUSB0", "bota"), ("bota:COM3", "bota"),
        ("bota://192.168.0.45?mode=1&submode=3", "bota"), ("bota:///COM7", "bota"),
        ("robotiq:COM4", "robotiq"), ("robotiq://10.0.0.2", "robotiq-text"), ("rtde://ur", "rtde"),
        ("xela://localhost", "xela"), ("papillarray:/dev/ttyACM0", "papillarray"), ("lines://127.0.0.1:7000", "auto"),
        ("/dev/ttyUSB0", "auto"), ("simulated:wrench", "auto"),
    ],
)  # fmt: skip
def test_the_address_says_the_format(address, form):
    assert format_of(address, "auto") == form
    assert format_of(address, "skt") == "skt"


LONG = f"socket://{'h' * (ADDRESS_MAX_CHARS - len('socket://:7'))}:7"


@pytest.mark.parametrize(
    "address",
    [
        "netft:/dev/ttyUSB0", "netft://", "netft://h:99999", "netft://h?speed=9", "yarp:x", "yarp://server", "yarp:", "bota://h/x",
        "rtde:", "xela:5000", "lines://host", "lines:", "netft://user@h", "bota:/dev/x?rate=1", LONG + "7", "run:", "run:  ",
        "run:'open", "bota://", "bota://host/path", "bota://host:80", "bota://host?mode=x", "bota://u@host", "ros2:",
        "ros2:/a b", "ros2:/a?domain=233", "ros2:/a?domain=x", "ros2://host/a", "ros2:/a++/b",
    ],
)  # fmt: skip
def test_addresses_that_cannot_be_right(address):
    with pytest.raises(InputError, match=r"is not a valid \w+ address\. Example: |unknown option|1001 characters"):
        parse_address(address)


def test_the_longest_address_is_taken():
    """All of it is shown before it is connected."""
    assert len(spec(LONG).address) == ADDRESS_MAX_CHARS


def test_a_device_costs_no_import_where_none_is_opened():
    code = """import sys, skincal.streams.intake, skincal.streams.links
from skincal.streams.intake import Intake
from skincal.streams.links import LinkSpec
from skincal.model.readings import Stream
from skincal.streams.expected_readings import ExpectedReadings
Intake(ExpectedReadings(4), [LinkSpec("a", "netft://h", (Stream.WRENCH,)), LinkSpec("b", "/dev/x", (Stream.SKIN,))])
found = [name for name in sys.modules if name.startswith(("websockets", "skincal.streams.transports", "serial"))]
others = ("yarp", "bota", "robotiq", "rtde", "xela", "papillarray")
makers = [name for name in others if "skincal.devices." + name in sys.modules]
sys.exit(bool(found or makers) or "skincal.devices.netft" not in sys.modules)"""
    assert subprocess.run([sys.executable, "-c", code], check=False, cwd=Path(__file__).parents[3]).returncode == 0
