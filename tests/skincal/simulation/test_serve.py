import os
import select
import socket
import sys
import time
from contextlib import closing, contextmanager
from io import StringIO

import numpy as np
import pytest
import serial

from skincal.cli import main
from skincal.model.readings import Stream
from skincal.simulation.device import DeviceSettings, DeviceTimeline
from skincal.simulation.operator import AutoOperator, Habits
from skincal.simulation.outlets import PtyOutlet, TcpOutlet
from skincal.simulation.rig_errors import RigErrors
from skincal.simulation.serve import Server
from skincal.streams.decoders.auto_detect import make_decoder
from tests.approved import approved
from tests.skincal.meanwhile import meanwhile
from tests.skincal.sim_support import make_rig

needs_pty = pytest.mark.skipif(sys.platform == "win32", reason="this platform has no pseudo-terminals")
WAIT_S = 10.0
KEY = "Ctrl-Z" if sys.platform == "win32" else "Ctrl-D"


@contextmanager
def serving(*, tcp, form="skb", name="flat-patch"):
    rig = make_rig(RigErrors.noise(), 1, name)
    rng = np.random.default_rng(1)
    line = DeviceTimeline(rig, AutoOperator(rig, Habits.careful(), rng), rng, DeviceSettings(format=form))
    with closing(Server(line, tcp=tcp)) as server, meanwhile(server.run):
        yield server


def connect(server, name):
    address = next(link.address for link in server.links if link.name == name)
    host, port = address.removeprefix("socket://").split(":")
    client = socket.create_connection((host, int(port)))
    client.settimeout(WAIT_S)
    return client


def receive(client, seconds):
    data, end = b"", time.monotonic() + seconds
    while time.monotonic() < end:
        if select.select([client], [], [], 0.05)[0]:
            data += client.recv(65536)
    return data


def receive_some(client, enough):
    data = b""
    while enough not in data:
        data += client.recv(65536)
    return data


def test_one_port_a_link():
    with serving(tcp=True, name="icub-forearm") as server:
        assert [(link.name, link.carries) for link in server.links] == [
            ("wrench", (Stream.WRENCH,)),
            ("skin", (Stream.SKIN,)),
            ("joints", (Stream.JOINTS,)),
        ]
        assert len({link.address for link in server.links}) == 3
        assert all(link.address.startswith("socket://127.0.0.1:") for link in server.links)


def test_readings_come_in_real_time_over_tcp():
    with serving(tcp=True) as server, connect(server, "wrench") as client:
        receive_some(client, b"kind=ft")
        begin = time.monotonic()
        data = receive(client, 1.5)
        elapsed = time.monotonic() - begin
    decoder = make_decoder("skb", 64, (Stream.WRENCH,))
    batches = decoder.feed(data)
    count = sum(len(b.seq) for b in batches)
    assert count == pytest.approx(1000 * elapsed, rel=0.25)
    seq = np.concatenate([b.seq for b in batches])
    assert (np.diff(seq) == 1).all()
    assert decoder.counts.total() == 0


def test_a_client_may_leave_and_come_back():
    with serving(tcp=True) as server:
        decoder = make_decoder("skb", 64, (Stream.WRENCH,))
        with connect(server, "wrench") as client:
            first = np.concatenate([b.seq for b in decoder.feed(receive(client, 0.3))])
        time.sleep(0.3)
        with connect(server, "wrench") as client:
            second = np.concatenate([b.seq for b in make_decoder("skb", 64, (Stream.WRENCH,)).feed(receive(client, 0.3))])
    assert len(first) > 50
    assert second[0] > first[-1] + 100  # what came in between is gone


def test_a_board_answers_and_pauses():
    with serving(tcp=True, form="skt") as server, connect(server, "skin") as client:
        assert receive_some(client, b"\n").startswith(b"H,skt1,")  # as after a boot
        client.sendall(b"P\n")
        while receive(client, 0.2):
            pass  # frames that were on their way
        client.sendall(b"?\n")
        answer = receive_some(client, b"\n") + receive(client, 0.2)
        assert answer.startswith(b"H,skt1,")
        assert answer.count(b"\n") == 1
        client.sendall(b"S\n")
        assert receive_some(client, b"\nT,")


def test_a_slow_client_does_not_hold_up_the_others():
    outlet = TcpOutlet()
    host, port = outlet.address.removeprefix("socket://").split(":")
    with socket.create_connection((host, int(port))) as deaf, socket.create_connection((host, int(port))) as keen:
        while len(outlet._clients) < 2:
            outlet.poll()
        heard = 0
        for _ in range(400):  # 26 MB: more than any kernel buffers
            outlet.write(bytes(65536))
            while select.select([keen], [], [], 0)[0]:
                heard += len(keen.recv(1 << 20))
        assert heard > 20_000_000
        assert len(outlet._clients) == 1
        deaf.settimeout(WAIT_S)
    outlet.close()


@needs_pty
def test_readings_come_over_a_pty_and_go_on_after_it_was_closed():
    with serving(tcp=False, name="icub-forearm") as server:
        port = next(link.address for link in server.links if link.name == "joints")
        for _ in range(2):
            decoder = make_decoder("skb", 384, (Stream.JOINTS,))
            count, end = 0, time.monotonic() + WAIT_S
            with serial.Serial(port, timeout=0.1) as link:
                while count < 30 and time.monotonic() < end:
                    count += sum(len(b.seq) for b in decoder.feed(link.read(256)))
            assert count >= 30
            assert decoder.counts.total() == 0


@needs_pty
def test_bytes_without_a_listener_are_gone():
    outlet = PtyOutlet()
    for _ in range(100):
        outlet.poll()
        outlet.write(b"x" * 1000)
    slave = os.open(outlet.address, os.O_RDWR | os.O_NOCTTY | os.O_NONBLOCK)
    assert outlet.poll()[0]
    outlet.write(b"fresh")
    assert os.read(slave, 100) == b"fresh"
    assert not outlet.poll()[0]
    os.write(slave, b"?\n")
    time.sleep(0.05)
    assert outlet.poll() == (False, b"?\n")
    for _ in range(100):
        outlet.write(b"x" * 1000)  # overrun: never waits
    os.close(slave)
    outlet.close()
    outlet.close()


class Typed:
    """Standard input: lines, and its end once something is so."""

    def __init__(self, *lines, until):
        self._lines, self._until = lines, until

    def __iter__(self):
        yield from self._lines
        end = time.monotonic() + WAIT_S
        while not self._until() and time.monotonic() < end:
            time.sleep(0.05)


@pytest.fixture
def terminal(monkeypatch):
    """Run `simulate` on a terminal, and return what that shows on stderr."""

    def run(*words, typed=()):
        monkeypatch.setattr(sys, "stderr", StringIO())
        monkeypatch.setattr(sys.stderr, "isatty", lambda: True)
        monkeypatch.setattr(sys, "stdin", Typed(*typed, until=lambda: "poke 1" in sys.stderr.getvalue()))
        assert main(["simulate", "--scene", "flat-patch", *words]) == 0
        return sys.stderr.getvalue()

    return run


def test_on_a_terminal_a_session_that_is_made_says_which_poke_of_how_many(terminal, tmp_path):
    said = terminal("--pokes", "3", "--out", str(tmp_path / "s"))
    assert said == "\rpoke 1 of 3 \rpoke 2 of 3 \rpoke 3 of 3 \n"


def test_on_a_terminal_served_devices_say_what_standard_input_is_for_and_which_poke_it_is(terminal):
    first, rest = terminal("--serve", "--tcp").split("\n", 1)
    assert first == approved("commands.auto_end", key=KEY)
    assert rest.startswith("\rpoke 1 ")
    assert rest.endswith(f"\n{approved('commands.input_ended')}\n")
    first, rest = terminal("--serve", "--tcp", "--operator", "told", typed=["poke 0\n"]).split("\n", 1)
    assert first == approved("commands.told_orders", key=KEY)
    assert rest == f"\rpoke 1 \n{approved('commands.input_ended')}\n"


def test_to_a_program_served_devices_say_nothing_but_their_links(monkeypatch, capsys):
    monkeypatch.setattr(sys, "stdin", Typed(until=lambda: True))
    assert main(["simulate", "--scene", "flat-patch", "--serve", "--tcp"]) == 0
    assert capsys.readouterr().err == ""


def test_on_a_terminal_the_addresses_are_given_with_the_commands_that_read_them(monkeypatch, capsys):
    monkeypatch.setattr(sys, "stdin", Typed(until=lambda: True))
    monkeypatch.setattr(sys.stdout, "isatty", lambda: True, raising=False)
    assert main(["simulate", "--scene", "flat-patch", "--serve", "--tcp"]) == 0
    lines = capsys.readouterr().out.splitlines()
    address = {line.rsplit(" ", 1)[0].strip(): line.rsplit(" ", 1)[1] for line in lines[:2]}
    assert set(address) == {"force/torque sensor", "skin"}
    for line, program in zip(lines[-2:], ("skincal --scene", "skincal record --scene"), strict=True):
        assert line.strip().startswith(program)
        assert f"--wrench {address['force/torque sensor']} --skin {address['skin']}" in line
