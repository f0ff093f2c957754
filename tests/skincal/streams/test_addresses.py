"""Addresses of other programs, datagrams, servers that wait for a request, and part of a board: each read to its numbers."""

from __future__ import annotations

import json
import re
import socket
import struct
import sys
import threading
import time
from contextlib import closing
from pathlib import Path

import numpy as np
import pytest

from skincal.devices.datagrams import OTHER_SENDER_KIND, READING_KIND, DatagramDecoder, write_head
from skincal.devices.decoding import pack
from skincal.devices.link import FailureKind, LinkError
from skincal.model.errors import InputError
from skincal.model.readings import Chunk, LinkAnswer, LinkEvent, LinkState, Loss, Stream
from skincal.streams.expected_readings import ExpectedReadings
from skincal.streams.intake import LinkIntake
from skincal.streams.links import LinkSpec, open_link, parse_address

PATIENCE_S = 8.0
SKIN, WRENCH = (Stream.SKIN,), (Stream.WRENCH,)


def free_port(kind=socket.SOCK_STREAM):
    with closing(socket.socket(socket.AF_INET, kind)) as found:
        found.bind(("127.0.0.1", 0))
        return found.getsockname()[1]


def read_link(address, channels, count, carries=SKIN, send=None):
    """The first readings of a link, as many as asked for, and its intake. `send` is called again and again."""
    link, intake, rows = (
        open_link(LinkSpec("link", address, carries)),
        LinkIntake(ExpectedReadings(channels), LinkSpec("link", address, carries)),
        [],
    )
    intake.feed(LinkEvent("link", 1, LinkState.OPEN))
    end_s = time.monotonic() + PATIENCE_S
    try:
        while len(rows) < count and time.monotonic() < end_s:
            if send is not None:
                send()
            if data := link.read(0.02):
                rows += [
                    row for arrived in intake.feed(Chunk("link", time.monotonic_ns(), data)) for row in arrived.batch.values
                ]
    finally:
        link.close()
    return np.array(rows), intake


# ------------------------------------------------------------------ what to type instead


@pytest.mark.parametrize("address", ["/tf?frame=tool0&base=base", "/skin", "/ft_sensor/wrench", "/tf?frame=tool0"])
def test_a_topic_without_its_scheme_is_no_port(address):
    with pytest.raises(
        InputError, match=re.escape(f"no such port or file. A topic of ROS 2 begins with ros2: (type ros2:{address})")
    ):
        parse_address(address)
    assert parse_address(f"ros2:{address}").route.scheme == "ros2"


def test_a_port_that_may_still_come_is_no_topic(tmp_path):
    (tmp_path / "there").touch()
    for path in ("/dev/ttyUSB7", "/dev/serial/by-id/usb-1", "COM3", f"{tmp_path}/pty", f"{tmp_path}/there", str(tmp_path)):
        assert parse_address(path).path == path


@pytest.mark.parametrize(
    ("address", "typed"),
    [
        ("tcp://192.168.1.5:7000", "socket://192.168.1.5:7000"),
        ("tcp:192.168.1.5:7000", "socket://192.168.1.5:7000"),
        ("telnet://esp32.local:23", "socket://esp32.local:23"),
        ("tcp:7000", "socket://127.0.0.1:7000"),
        ("192.168.1.5:7000", "socket://192.168.1.5:7000"),
        ("localhost:7000", "socket://localhost:7000"),
        ("[::1]:7000", "socket://[::1]:7000"),
        ("COM3:115200", "COM3@115200"),
        ("/dev/ttyUSB0:115200", "/dev/ttyUSB0@115200"),
        ("/dev/ttyACM0,9600", "/dev/ttyACM0@9600"),
        ("udp://192.168.1.5:7000?format=float32", "udp://:7000?format=float32"),
        ("ws://robot:9090", "rosbridge://HOST:PORT/TOPIC"),
    ],
)
def test_an_address_of_another_program_names_the_one_to_type(address, typed):
    with pytest.raises(InputError) as error:
        parse_address(address)
    assert typed in str(error.value)
    # The advice followed.
    assert parse_address(typed.replace("HOST:PORT/TOPIC", "h:9090/a")).route.transport in ("tcp", "serial", "udp", "websocket")


@pytest.mark.parametrize(
    ("address", "path", "baud"),
    [
        ("robotiq:/dev/ttyUSB0", "/dev/ttyUSB0", 0),
        ("robotiq:/dev/ttyUSB0@115200", "/dev/ttyUSB0", 115200),
        ("robotiq:/dev/ttyUSB0?baud=115200", "/dev/ttyUSB0", 115200),
        ("robotiq:COM4@19200?baud=19200", "COM4", 19200),
        ("bota:/dev/ttyUSB0", "/dev/ttyUSB0", 460800),
        ("bota:/dev/ttyUSB0@230400", "/dev/ttyUSB0", 230400),
        ("papillarray:COM3?baud=", "COM3", 115200),
        ("robotiq:/dev/a@b", "/dev/a@b", 0),
    ],
)
def test_a_serial_device_takes_a_baud_rate_in_both_forms(address, path, baud):
    device = parse_address(address)
    assert (device.path, device.baud, dict(device.options)) == (path, baud, {})


def test_a_baud_rate_of_the_makers_driver_has_both_forms_too():
    for address in ("bota:///dev/ttyACM0@230400", "bota:///dev/ttyACM0?baud=230400"):
        device = parse_address(address)
        assert (device.path, dict(device.options)) == ("/dev/ttyACM0", {"baud": "230400"})


@pytest.mark.parametrize(
    ("address", "words"),
    [
        ("robotiq:COM4?baud=fast", "baud is 'fast'; expected a whole number such as 115200"),
        ("robotiq:COM4?baud=0", "baud is '0'"),
        ("robotiq:COM4@19200?baud=115200", "names two baud rates, 19200 and 115200; keep one"),
        ("robotiq:COM4?speed=1", "unknown option 'speed'. Allowed options: baud."),
    ],
)
def test_a_wrong_baud_rate_is_refused_with_the_one_expected(address, words):
    with pytest.raises(InputError) as error:
        parse_address(address)
    assert words in str(error.value)


@pytest.mark.parametrize("scheme", ["osc", "mqtt", "lsl", "ws"])
def test_a_protocol_that_needs_a_program_names_it_and_the_manual_has_it(scheme):
    with pytest.raises(InputError) as error:
        parse_address(f"{scheme}://127.0.0.1:9000/skin")
    assert f'type "run:python3 {scheme}_lines.py"' in str(error.value)
    with pytest.raises(InputError, match=f"run:python3 {scheme}_lines.py"):
        parse_address(f"{scheme}:9000")
    assert program(scheme)


# ------------------------------------------------------------------ programs of the manual


def program(scheme):
    """The manual's program for a protocol."""
    page = (Path(__file__).resolve().parents[3] / "docs" / "devices.md").read_text(encoding="utf-8")
    (found,) = re.findall(rf"```python\n(# {scheme}_lines\.py\n.*?)```", page, re.DOTALL)
    assert found.count("\n") <= 12
    return found


def run_program(tmp_path, scheme, changes, count, send=None):
    text = program(scheme)
    for old, new in changes.items():
        assert old in text
        text = text.replace(old, new)
    path = tmp_path / f"{scheme}_lines.py"
    path.write_text(text, encoding="utf-8")
    return read_link(f'run:"{sys.executable}" "{path}"', 3, count, send=send)[0]


def test_osc_is_read(tmp_path):
    pytest.importorskip("pythonosc", reason="python-osc is not installed")
    port = free_port(socket.SOCK_DGRAM)
    message = b"/skin\0\0\0,fif\0\0\0\0" + struct.pack(">fif", 1.5, 2, 3)
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as board:
        rows = run_program(
            tmp_path,
            "osc",
            {"9000": str(port), '""': '"127.0.0.1"'},
            3,
            lambda: board.sendto(message, ("127.0.0.1", port)),
        )
    assert rows[:3].tolist() == [[1.5, 2, 3]] * 3


class Broker:
    """MQTT 3.1.1, as much of it as one subscriber needs: it publishes lines on the topic that is asked for."""

    def __init__(self):
        self.server = socket.create_server(("127.0.0.1", 0))
        self.port = self.server.getsockname()[1]
        self.topics = []
        threading.Thread(target=self._serve, daemon=True).start()

    def _serve(self):
        client, _ = self.server.accept()
        with client:
            for kind in (0x10, 0x82):
                head = client.recv(2)
                body = client.recv(head[1])
                assert head[0] == kind
                if kind == 0x82:
                    self.topics.append(body[4 : 4 + body[3]].decode())
                client.sendall(b"\x90\x03" + body[:2] + b"\x00" if kind == 0x82 else b"\x20\x02\x00\x00")
            payload = b"\x00\x04skin1.5,2,3"
            try:
                while True:
                    client.sendall(bytes([0x30, len(payload)]) + payload)
                    time.sleep(0.02)
            except OSError:
                return


def test_mqtt_is_read(tmp_path):
    pytest.importorskip("paho.mqtt.client", reason="paho-mqtt is not installed")
    broker = Broker()
    with broker.server:
        rows = run_program(tmp_path, "mqtt", {"1883": str(broker.port), "192.168.1.5": "127.0.0.1"}, 3)
    assert broker.topics == ["skin"]
    assert rows[:3].tolist() == [[1.5, 2, 3]] * 3


def test_lab_streaming_layer_is_read(tmp_path):
    lsl = pytest.importorskip("pylsl", reason="pylsl is not installed", exc_type=Exception)
    outlet = lsl.StreamOutlet(lsl.StreamInfo("Skin", "taxels", 3, 50, "float32", "skincal-test"))
    rows = run_program(tmp_path, "lsl", {}, 3, lambda: outlet.push_sample([1.5, 2, 3]))
    assert rows[:3].tolist() == [[1.5, 2, 3]] * 3


def test_websockets_are_read(tmp_path):
    from websockets.sync.server import serve

    def handle(connection):
        for k in range(200):
            connection.send(json.dumps({"ms": 20 * k, "skin": [1.5, 2, 3]}))
            time.sleep(0.02)

    with serve(handle, "127.0.0.1", 0) as server:
        thread = threading.Thread(target=server.serve_forever, daemon=True)
        thread.start()
        port = server.socket.getsockname()[1]
        rows = run_program(tmp_path, "ws", {"192.168.1.5:8080": f"127.0.0.1:{port}"}, 3)
        server.shutdown()
        thread.join(PATIENCE_S)
    assert rows[:3].tolist() == [[1.5, 2, 3]] * 3


# ------------------------------------------------------------------ datagrams


@pytest.mark.parametrize(
    ("query", "code"),
    [
        ("format=float32&endian=little", "<f"),
        ("format=float32", "<f"),
        ("format=float64&endian=big", ">d"),
        ("format=uint16&endian=big", ">H"),
        ("format=int8", "<b"),
    ],
)
def test_datagrams_of_numbers_are_read(query, code):
    port = free_port(socket.SOCK_DGRAM)
    sent = [[1, 2, 3, 40], [5, 6, 7, 80]]
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as board:

        def send():
            for row in sent:
                board.sendto(struct.pack(f"{code[0]}4{code[1]}", *row), ("127.0.0.1", port))

        rows, intake = read_link(f"udp://:{port}?{query}", 4, 4, send=send)
    assert rows[:4].tolist() == sent * 2
    assert query.split("&")[0].removeprefix("format=") in intake.health(time.monotonic_ns()).units


def test_datagrams_of_text_are_lines():
    port = free_port(socket.SOCK_DGRAM)
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as board:
        rows, _ = read_link(f"udp://:{port}", 3, 4, send=lambda: board.sendto(b"1.5,2,3", ("127.0.0.1", port)))
    assert rows[0].tolist() == [1.5, 2, 3]


def test_two_boards_on_one_port_are_not_mixed_and_the_second_is_named():
    port = free_port(socket.SOCK_DGRAM)
    with (
        socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as board,
        socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as other,
    ):

        def send():
            board.sendto(struct.pack("<4f", 1, 2, 3, 40), ("127.0.0.1", port))
            other.sendto(struct.pack("<4f", 9, 9, 9, 9), ("127.0.0.1", port))

        rows, intake = read_link(f"udp://:{port}?format=float32", 4, 10, send=send)
        name = f"127.0.0.1:{other.getsockname()[1]}"
    assert rows.tolist() == [[1, 2, 3, 40]] * len(rows)
    assert intake.health(time.monotonic_ns()).text == f"{name} sends to this port, too, and is not read"


def decode(payloads, channels, carries=SKIN, head=("float32", "little")):
    decoder = DatagramDecoder(channels, carries)
    batches = decoder.feed(write_head(*head) + b"".join(pack(READING_KIND, each) for each in payloads))
    return [row for batch in batches for row in batch.values.tolist()], decoder


def test_floats_of_another_byte_order_or_type_are_no_readings_and_the_advice_reads_them():
    payloads = [struct.pack(">4f", 200 + k, 201, 202, 203) for k in range(3)]
    rows, decoder = decode(payloads, 4)
    assert rows == []
    assert decoder.counts[Loss.UNREADABLE] == 3
    assert decoder.device_message.endswith("check ?format= and &endian=")
    assert decode(payloads, 4, head=("float32", "big"))[0] == [[200 + k, 201, 202, 203] for k in range(3)]
    # Whole numbers are no floats.
    assert decode([struct.pack("<4i", 200, 201, 202, 203)], 4)[0] == []
    rows, decoder = decode([b"\0" * 15], 4)
    assert rows == []
    assert "15 bytes" in decoder.device_message


def test_a_clock_in_a_datagram_is_no_taxel():
    rng = np.random.default_rng(2)
    frames = rng.integers(190, 210, (60, 4)).astype(float).tolist()
    payloads = [struct.pack("<5f", 1000 + 20 * k, *frame) for k, frame in enumerate(frames)]
    rows, decoder = decode(payloads, 4)
    assert rows == frames[30:]
    assert "only rises" in decoder.units[Stream.SKIN]
    assert "only rises" in decode(payloads, 5)[1].device_message
    assert decode([struct.pack("<4f", 1, 2, 3, 4)] * 6, 16)[0] == []


def test_a_packet_that_names_another_sender_is_no_reading():
    decoder = DatagramDecoder(4, SKIN)
    assert decoder.feed(write_head("float32", "little") + pack(OTHER_SENDER_KIND, b"10.0.0.7:5000")) == []
    assert decoder.device_message.startswith("10.0.0.7:5000 ")


@pytest.mark.parametrize(
    "address",
    [
        "udp://:7000?format=float",
        "udp://:7000?endian=middle&format=int16",
        "udp://",
        "udp://:0",
        "udp:7000",
        "udp://:7000/skin",
    ],
)
def test_wrong_addresses_of_datagrams_are_refused_with_an_example(address):
    with pytest.raises(InputError, match=r"udp://:7000\?format=float32|expected one of text, float32"):
        parse_address(address)


# ------------------------------------------------------------------ requests


@pytest.mark.parametrize(("query", "is_polled"), [("send=START", False), ("send=READ%3F&after=line", True)])
def test_a_server_that_waits_for_a_request_gets_it(query, is_polled):
    got = []

    def serve():
        client, _ = server.accept()
        with client:
            text = client.makefile("r")
            for k in range(50):
                if is_polled or not k:
                    got.append(text.readline())
                time.sleep(0.02)
                try:
                    client.sendall(f"{k},2,3\n".encode())
                except OSError:
                    return

    with socket.create_server(("127.0.0.1", 0)) as server:
        thread = threading.Thread(target=serve, daemon=True)
        thread.start()
        rows, _ = read_link(f"lines://127.0.0.1:{server.getsockname()[1]}?{query}", 3, 20)
        thread.join(PATIENCE_S)
    assert rows[:20, 0].tolist() == list(range(1, 21))
    assert set(got) <= {"READ?\n" if is_polled else "START\n", ""}


def test_wrong_requests_are_refused():
    for query in ("send=", "after=line", "send=A&after=each", "ask=A", "send=A%0D%0AB", f"send={'A' * 101}"):
        with pytest.raises(InputError):
            parse_address(f"socket://h:1?{query}")


# ------------------------------------------------------------------ part of a board


def feed_lines(address, lines, channels):
    intake = LinkIntake(ExpectedReadings(channels), LinkSpec("skin", address, SKIN))
    intake.feed(LinkEvent("skin", 1, LinkState.OPEN))
    rows = []
    for k, line in enumerate(lines):
        arrived = intake.feed(Chunk("skin", 10**9 + k * 20_000_000, line.encode()))
        rows += [row for each in arrived for row in each.batch.values.tolist()]
    return rows, intake


@pytest.mark.parametrize(
    "place", ["/dev/ttyUSB0", "/dev/ttyUSB0@115200", "COM3@115200", "socket://h:1", "lines://h:1", "udp://:7"]
)
@pytest.mark.parametrize(("of", "clock"), [("", ""), ("&of=8", ""), ("", "{k},")])
def test_part_of_a_board_is_read(place, of, clock):
    frames = [[200 + (7 * k + n) % 40 for n in range(8)] for k in range(80)]
    lines = [clock.format(k=k) + ",".join(map(str, frame)) + "\n" for k, frame in enumerate(frames)]
    rows, intake = feed_lines(f"{place}?channels=4-6,1{of}", lines, 4)
    assert rows == [[*frame[4:7], frame[1]] for frame in frames[1:]]
    assert intake.health(10**9 + 80 * 20_000_000).verdict.answer is LinkAnswer.GOOD
    assert parse_address(f"{place}?channels=4-6,1{of}").path == place.partition("@")[0] or "://" in place


def test_a_reader_goes_on_trying_a_port_whose_folder_went_away(tmp_path):
    with pytest.raises(LinkError) as failed:
        open_link(LinkSpec("skin", f"{tmp_path}/gone/pty", SKIN))
    assert failed.value.kind is FailureKind.ABSENT


@pytest.mark.parametrize("place", ["{}/pty", "file:{}/log.csv", "{}/log.csv"])
def test_a_session_is_read_by_its_part_where_its_port_or_file_is_gone(tmp_path, place):
    place = place.format(tmp_path / "of another machine")
    frames = [[200 + (7 * k + n) % 40 for n in range(8)] for k in range(80)]
    rows, _ = feed_lines(f"{place}?channels=4-6,1", [",".join(map(str, frame)) + "\n" for frame in frames], 4)
    assert rows == [[*frame[4:7], frame[1]] for frame in frames[-len(rows) :]]
    assert len(rows) > 70


def test_a_part_that_does_not_fit_gives_no_reading_and_says_why():
    lines = [f"{7 * k % 9},2,3,4\n" for k in range(80)]
    for query, channels in (("channels=0-7", 8), ("channels=0-1", 3)):
        rows, intake = feed_lines(f"/dev/ttyUSB0?{query}", lines, channels)
        assert rows == []
        assert f"the board sends 4, and the scene has {channels}" in intake.health(3 * 10**9).text


@pytest.mark.parametrize(
    "query", ["channels=", "channels=a", "channels=3-1", "channels=1,1", "channels=0-15&of=8", "channels=-1"]
)
def test_a_wrong_part_is_refused(query):
    for place in ("/dev/ttyUSB0", "socket://h:1"):
        with pytest.raises(InputError, match="channels"):
            parse_address(f"{place}?{query}")
