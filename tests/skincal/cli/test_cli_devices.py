"""`devices` and `watch`: on a pseudo-terminal, over sockets, and where nothing answers."""

import json
import os
import time
from contextlib import closing, contextmanager

import pytest

from skincal.cli import devices, main
from skincal.devices.link import FailureKind, LinkError
from skincal.devices.registry import parse_device
from skincal.model.errors import plain_text
from skincal.model.readings import Chunk, Stream
from skincal.simulation.emulated_devices import MAKERS
from skincal.simulation.emulated_transports import MakerOutlets
from skincal.simulation.outlets import PtyOutlet
from skincal.streams import links
from skincal.streams.transports import baud_search
from tests.approved import approved
from tests.skincal.meanwhile import meanwhile

needs_pty = pytest.mark.skipif(not hasattr(os, "openpty"), reason="this platform has no pty")


@contextmanager
def sending(maker, stream):
    """A device that sends a hundred readings a second; its address."""
    outlet, encoder = MakerOutlets(64).open(maker, stream, tcp=False), MAKERS[maker].encoder()

    def send(over):
        count = 0
        while not over.wait(0.01):
            outlet.poll()
            count += 1
            if stream is Stream.WRENCH:
                # A sensor that repeats one reading is taken for frozen.
                force = 1.0 + 1e-3 * (count % 2)
                outlet.write(encoder.record(stream, count * 10_000, [force, 2, 3, 0.1, 0.2, 0.3]))
            else:
                outlet.write(encoder.record(stream, count * 10_000, [0.0, 1.0, 2.0, 3.0]))

    with closing(outlet), meanwhile(send):
        yield outlet.address


def watched(capsys, maker, stream, *options):
    """What `watch` prints of such a device."""
    with sending(maker, stream) as address:
        assert main(["watch", f"bota:{address}" if maker == "bota" else address, *options]) == 0
    return capsys.readouterr().out


def test_watch_shows_a_wrench_with_its_units_and_rate(capsys):
    out = watched(capsys, "netft", Stream.WRENCH, "--seconds", "1.5")
    assert "F 1.00 2.00 3.00 N, M 0.100 0.200 0.300 N m (Fx Fy Fz in N, Mx My Mz in N m)" in out
    assert "ATI RDT" in out


def test_watch_shows_all_that_a_robot_sends_over_one_link(capsys):
    line = watched(capsys, "rtde", Stream.WRENCH, "--seconds", "1")
    assert "wrench" in line
    assert "0.0 0.0 0.0 0.0 0.0 0.0 deg (base, shoulder, elbow and the three of the wrist in degrees)" in line
    assert "lost" not in line


@needs_pty
def test_watch_shows_the_temperature_of_a_sensor(capsys):
    figures = json.loads(watched(capsys, "bota", Stream.WRENCH, "--seconds", "1", "--json").splitlines()[0])
    assert figures["format"] == "Bota gen0"
    assert figures["beside"] == {"temperature, degC": {"least": 31.5, "most": 31.5, "now": 31.5}}
    assert figures["rates"]["wrench"] > 30
    assert figures["losses"] == {}


def test_watch_shows_a_skin(capsys):
    out = watched(capsys, "xela", Stream.SKIN, "--seconds", "1")
    assert "4 values, 0 to 3 (the force across the skin of each taxel, as raw words)" in out


def test_watch_says_that_a_skin_is_no_wrench(capsys):
    lines = watched(capsys, "yarp", Stream.SKIN, "--carries", "wrench", "--seconds", "2.5", "--json").splitlines()
    assert json.loads(lines[-1])["verdict"] == approved(
        "links.other_width", width=4, of="a force/torque sensor has", expected=6
    )


@needs_pty
def test_devices_says_which_rates_were_tried(capsys, monkeypatch):
    monkeypatch.setattr(baud_search, "BAUD_RATE_TRIAL_MAX_S", 0.6)
    outlet = PtyOutlet()

    def send(over):
        while not over.wait(0.01):
            outlet.poll()
            outlet.write(bytes(range(128, 168)))

    with closing(outlet), meanwhile(send):
        monkeypatch.setattr(devices, "_ports", lambda: [(outlet.address, "USB serial")])
        assert main(["devices"]) == 0
    said = approved("links.no_reading_tried", tried="115200, 460800")
    assert said[: said.index(")")] in capsys.readouterr().out  # a busy machine tries more of them


@pytest.mark.parametrize("address", ["socket://127.0.0.1:1", "/dev/ttyNone1"])
def test_watch_of_what_is_never_opened_ends_as_the_users_fault(address, capsys):
    assert main(["watch", address, "--seconds", "0.5"]) == 2
    assert approved("links.never_opened", address=address) in capsys.readouterr().err


def test_watch_refuses_what_is_no_address(capsys):
    assert main(["watch", "spy://x"]) == 2
    assert "begin with spy:" in capsys.readouterr().err


ORDER = "\x1b[2Jgone\u202e\rnot there"
"""Clears a screen, turns the letters that follow, and writes over the line."""


@pytest.fixture
def hostile(monkeypatch):
    """A device whose driver gives an order to the terminal as its reason."""

    def refuse(*_):
        raise LinkError(FailureKind.ADDRESS, ORDER)

    monkeypatch.setattr(links, "open_link", refuse)
    monkeypatch.setattr(devices, "_ports", lambda: [(f"/dev/tty{ORDER}", f"by {ORDER}")])
    monkeypatch.setattr(devices, "_yarp_ports", lambda: ([(f"/{ORDER}", ("host", 1))], ORDER))
    monkeypatch.setattr(devices, "_ros_topics", lambda: ([(f"ros2:/{ORDER}", ORDER)], {"wrench": ORDER}, ORDER))


@pytest.mark.parametrize("words", [
    ["watch", "/dev/ttyNone1", "--seconds", "1"],
    ["devices"],
    ["record", "--wrench", "/dev/ttyNone1", "--skin", "/dev/ttyNone2", "--scene", "flat-patch", "--out", "s"],
    ["record", "--wrench", "/dev/ttyNone1", "--skin", f"/dev/{ORDER}", "--scene", "flat-patch", "--out", "s", "--json"],
])  # fmt: skip
@pytest.mark.usefixtures("hostile")
def test_no_word_of_a_device_is_an_order_to_the_terminal(words, capsys, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    main(words)
    said = capsys.readouterr()
    assert "?[2Jgone??not there" in said.err + said.out
    assert all(plain_text(line) == line for line in (said.out + said.err).split("\n"))


@needs_pty
def test_devices_says_what_answers_on_a_port_and_what_to_type(capsys, monkeypatch):
    monkeypatch.setattr(devices, "LISTEN_TIME_PER_PORT_S", 1.0)
    with sending("bota", Stream.WRENCH) as address:
        monkeypatch.setattr(devices, "_ports", lambda: [(address, "USB serial"), ("/dev/nothing-there", "gone")])
        begun = time.monotonic()
        assert main(["devices"]) == 0
        assert time.monotonic() - begun < 10
    said = capsys.readouterr()
    assert f"{address}@115200  USB serial: Bota gen0, wrench" in said.out  # a pty has every rate
    assert "gone: There is no port" in said.out
    assert "skincal watch ADDRESS" in said.out


def test_devices_names_what_a_silent_port_may_need_and_each_of_these_starts_its_device(capsys, monkeypatch):
    monkeypatch.setattr(devices, "LISTEN_TIME_PER_PORT_S", 0.3)
    outlet = MakerOutlets(4).open("leptrino", Stream.WRENCH, tcp=False)
    port = outlet.address.removeprefix("leptrino:")
    monkeypatch.setattr(devices, "_ports", lambda: [(port, "USB serial")])
    try:
        assert main(["devices"]) == 0
    finally:
        outlet.close()
    said = capsys.readouterr().out
    assert f"robotiq:{port}, bota:{port}, leptrino:{port}, tsf85:{port}, paxini:{port}" in said
    for scheme in devices.STARTED_SCHEMES:
        route = parse_device(f"{scheme}:{port}").route
        handshake = route.handshake((Stream.WRENCH, Stream.SKIN))
        assert handshake.opening() or handshake.on_silence()


def test_devices_lists_the_ports_of_a_yarp_network(capsys, monkeypatch, tmp_path):
    monkeypatch.setattr(devices, "_ports", list)
    monkeypatch.setattr(devices, "_ros_topics", lambda: ([], {}, ""))  # other tests publish meanwhile
    monkeypatch.setenv("YARP_CONFIG_HOME", str(tmp_path))
    with sending("yarp", Stream.SKIN) as address:
        host, port = address.removeprefix("yarp://").partition("/")[0].split(":")
        (tmp_path / "yarp.conf").write_text(f"{host} {port} yarp\n", encoding="utf-8")
        assert main(["devices", "--json"]) == 0
    found = json.loads(capsys.readouterr().out)
    assert [each["address"] for each in found["devices"]] == ["yarp:/icub/skin/right_forearm", "yarp:/skinManager/rpc"]
    assert found["yarp"] == ""


def test_devices_says_that_nothing_is_plugged_in_and_that_there_is_no_yarp(capsys, monkeypatch, tmp_path):
    monkeypatch.setattr(devices, "_ports", list)
    monkeypatch.setattr(devices, "_ros_topics", lambda: ([], {}, ""))  # other tests publish meanwhile
    monkeypatch.setenv("YARP_CONFIG_HOME", str(tmp_path))
    (tmp_path / "yarp.conf").write_text("127.0.0.1 1 yarp\n", encoding="utf-8")
    assert main(["devices"]) == 0
    said = capsys.readouterr().err
    assert approved("links.no_port_at_all") in said
    assert said.count("YARP") == 1


def test_watch_keeps_no_more_than_it_can_read(capsys, monkeypatch):
    """A link that sends faster than it is read: the rest is dropped, and said."""

    class Flood:
        def __init__(self, _spec, items):
            self.items, self.end_s = items, time.monotonic() + 2.0

        def start(self):
            for _ in range(40):
                self.items.put(Chunk("link", time.monotonic_ns(), bytes(65536)))

        @property
        def running(self):
            return time.monotonic() < self.end_s

        def stop(self):
            pass

    monkeypatch.setattr(links, "Reader", Flood)
    assert main(["watch", "COM3"]) == 0
    assert "bytes were dropped" in capsys.readouterr().err
