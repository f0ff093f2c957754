"""A robot at the port for targets, over real TCP: it comes, goes and comes back, lies, floods, and takes nothing."""

import errno
import socket
import time
from contextlib import closing, contextmanager, suppress

import numpy as np
import pytest

from skincal.model.errors import InputError
from skincal.robot.target_client import TargetClient
from skincal.robot.target_lines import GREETING, Answer, AnswerKind, Judged, NoTarget, PokeTarget, write_line
from skincal.robot.target_server import (
    ACCEPT_ROBOT_AGAIN_AFTER_S,
    ROBOT_LINES_PER_S_MAX,
    RobotChange,
    TargetServer,
    open_port,
    parse_port,
)
from tests.approved import approved, approved_pattern
from tests.skincal.robot.robot_support import Peer

PATIENCE_S = 10.0


def target(number):
    return PokeTarget(number, 3, np.array([0.01, 0.02, 0.03]), np.array([0.0, 0.0, -1.0]))


@pytest.fixture
def server():
    with closing(TargetServer(open_port(*parse_port("0")))) as server:
        yield server


@contextmanager
def robot(server):
    with closing(Peer(server.port)) as peer:
        yield peer


def wait_for(condition):
    """The first true value of a condition."""
    end = time.monotonic() + PATIENCE_S
    while not (found := condition()):
        assert time.monotonic() < end
        time.sleep(0.01)
    return found


def taken(server, count=1, but=RobotChange):
    """What the server heard, once there is so much of it."""
    found = []

    def enough():
        found.extend(item for item in server.read_answers() if not isinstance(item, but))
        return len(found) >= count

    wait_for(enough)
    return found


def answers(server):
    return wait_for(lambda: [item for item in server.read_answers() if isinstance(item, Answer)])


def test_a_robot_hears_what_is_asked_and_answers(server):
    server.send([target(1)])
    with robot(server) as peer:
        assert [peer.line(), peer.line()] == [GREETING, write_line(target(1))]
        peer.say("reached 1")
        assert taken(server, 2) == [f"A robot connected from {server.host}.", Answer(AnswerKind.REACHED, 1)]
        server.send([Judged(1, "too soft"), target(2), Judged(2), NoTarget.ENOUGH])
        said = [peer.line() for _ in range(4)]
        assert said == ["rejected 1 too soft", write_line(target(2)), "accepted 2", "enough"]


def test_who_comes_back_hears_again_what_is_asked_for_now(server):
    with robot(server) as peer:
        assert [peer.line(), peer.line()] == [GREETING, "wait"], "nothing yet"
        server.send([target(1)])
        assert peer.line() == write_line(target(1))
    server.send([Judged(1), target(2)])
    with robot(server) as peer:
        assert [peer.line(), peer.line()] == [GREETING, write_line(target(2))]
    assert sum(item is RobotChange.CAME for item in taken(server, 3, but=())) == 2


def test_a_robot_that_left_before_it_was_taken_ends_nothing(server, monkeypatch):
    """On macOS a socket whose peer has closed already takes no options."""

    def refuse(_connection):
        monkeypatch.undo()
        raise OSError(errno.EINVAL, "Invalid argument")

    monkeypatch.setattr("skincal.robot.target_server.enable_keepalive", refuse)
    with robot(server) as peer, suppress(OSError):
        peer.line()
    with robot(server) as peer:
        assert peer.line() == GREETING


def test_one_robot_at_a_time(server):
    with robot(server) as first:
        assert [first.line(), first.line()] == [GREETING, "wait"]
        with robot(server) as second:
            assert [second.line(), second.line(), second.line()] == [GREETING, "refused another robot is connected", None]
        server.send([target(1)])
        assert first.line() == write_line(target(1))

    def third_hears():
        # Until the server has noticed that the first one left, it refuses another.
        with robot(server) as third:
            heard = [third.line(), third.line()]
        return heard if heard[1] != "refused another robot is connected" else None

    assert wait_for(third_hears) == [GREETING, write_line(target(1))]


LIES = {
    "no answer": b"hello\n",
    "another protocol": b"GET / HTTP/1.1\r\nHost: x\r\n\r\n",
    "no text": bytes(range(256)) + b"\n",
    "never ends": b"reached " * 100_000,
    "a flood": b"reached 1\n" * 10 * ROBOT_LINES_PER_S_MAX,
}


@pytest.mark.parametrize("lie", LIES)
def test_who_lies_or_floods_is_hung_up_on_for_one_sentence(server, lie):
    server.send([target(1)])
    for _ in range(2):
        with robot(server) as peer:
            assert peer.line() == GREETING
            with suppress(ConnectionError):
                peer.say(LIES[lie])
            said = peer.line()
            while said is not None and not said.startswith("refused "):
                said = peer.line()
            assert said is not None or len(LIES[lie]) > 1000, "a sender that is far ahead may miss why"
        time.sleep(ACCEPT_ROBOT_AGAIN_AFTER_S + 0.1)
    sentences = [item for item in taken(server) if isinstance(item, str) and approved("targets.hung_up_on") in item]
    assert len(sentences) == 1, "twice the same is said once"
    with robot(server) as peer:
        peer.say("reached 1")
        assert taken(server)[-1] == Answer(AnswerKind.REACHED, 1), "another one is heard"


def test_what_is_refused_elsewhere_hangs_up_too(server):
    with robot(server) as peer:
        peer.line(), peer.line()
        server.refuse("it answers 'reached 9', " + approved("targets.was_asked", most=1))
        assert peer.line() == "refused it answers 'reached 9', " + approved("targets.was_asked", most=1)
        assert peer.line() is None


def test_a_robot_that_takes_nothing_is_let_go_and_memory_stays_bounded(server):
    with robot(server) as peer:
        peer.line()
        end = time.monotonic() + PATIENCE_S
        said = []
        while not any("does not read its lines" in str(item) for item in said):
            assert time.monotonic() < end
            server.send([Judged(1, "x" * 190)] * 1000)
            said += server.read_answers()
            time.sleep(0.005)
        assert len(server._pending) == 0


@pytest.mark.parametrize(
    ("text", "place"), [("7010", ("127.0.0.1", 7010)), ("0.0.0.0:80", ("0.0.0.0", 80)), ("[::1]:7010", ("::1", 7010))]
)  # fmt: skip
def test_a_port_is_of_this_machine_alone_unless_a_host_is_told(text, place):
    assert parse_port(text) == place


@pytest.mark.parametrize("text", ["", "x", "70100", "-1", ":7010", "localhost", "7010:", "1.5"])
def test_what_is_no_port_is_refused(text):
    with pytest.raises(InputError, match=approved_pattern("targets.no_port")):
        parse_port(text)


def test_a_port_that_is_taken_or_a_host_that_is_not_ours_is_said(server):
    for host, port in ((server.host, server.port), ("192.0.2.1", 7010), ("x" * 300, 7010)):
        with pytest.raises(InputError, match="name another port"):
            TargetServer(open_port(host, port)).close()


def test_the_client_finds_the_server_when_it_comes_and_again_after_it_went():
    with socket.create_server(("127.0.0.1", 0)) as free:
        port = free.getsockname()[1]
    heard = []
    with closing(TargetClient("127.0.0.1", port, heard.append)) as client:
        for number in (1, 2):
            with closing(TargetServer(open_port("127.0.0.1", port))) as server:
                server.send([target(number)])
                wait_for(lambda: any(isinstance(line, PokeTarget) and line.number == number for line in heard))  # noqa: B023
                client.say(Answer(AnswerKind.REACHED, number))
                assert answers(server) == [Answer(AnswerKind.REACHED, number)]


def test_a_target_that_the_client_cannot_take_is_a_fault(server):
    def refuse(line):
        if isinstance(line, PokeTarget):
            raise InputError("no such taxel")

    with closing(TargetClient(server.host, server.port, refuse)):
        server.send([target(1)])
        assert answers(server) == [Answer(AnswerKind.FAULT, 1, "no such taxel")]


@pytest.mark.parametrize("garbage", [b"x" * 2000, b"target 1 2\n"])
def test_the_client_comes_again_after_what_is_no_line(garbage):
    heard = []
    with (
        socket.create_server(("127.0.0.1", 0)) as listening,
        closing(TargetClient("127.0.0.1", listening.getsockname()[1], heard.append)),
    ):
        listening.settimeout(PATIENCE_S)
        with listening.accept()[0] as first:
            first.sendall(garbage)
            with listening.accept()[0] as second:
                second.sendall(b"wait\n")
                wait_for(lambda: heard == [NoTarget.WAIT])
