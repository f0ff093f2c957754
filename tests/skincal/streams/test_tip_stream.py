"""The tip's stream, from its bytes to a poke of a session, and back from the journal."""

import socket
import time
from contextlib import closing

import numpy as np
import pytest

from skincal.devices.link import LinkError
from skincal.journal.writer import create_session
from skincal.model.readings import Chunk, LinkAnswer, LinkEvent, LinkState, Stream
from skincal.robot.target_server import TargetServer, open_port
from skincal.session.pipeline import Pipeline
from skincal.session.replay import load, replay
from skincal.streams.links import LinkSpec, open_link
from skincal.streams.transports.target_tips import report_tip
from tests.skincal.poke_script import LINKS, PERIOD_S, as_chunks, outcome_key, skt_line, some_pokes, write_scene

PLACE = np.array([0.7, -0.25, 0.125])
TIP = LinkSpec("tip", "file:none", (Stream.TIP,), "skt")
TEXT_TIP = LinkSpec("tip", "file:none", (Stream.TIP,), "text")


def with_tip(items, lines, until=np.inf):
    """Add a reading of the tip before each skin frame, until a time of the host, seconds."""
    out = [LinkEvent("tip", items[0].host_ns, LinkState.OPEN)]
    for number, item in enumerate(items):
        if isinstance(item, Chunk) and item.link == "skin" and item.host_ns * 1e-9 < until:
            values = ",".join(f"{value:.6f}" for value in PLACE)
            now_us = round((item.host_ns - items[0].host_ns) / 1e3)
            line = skt_line(f"P,{number & 0xFFFF},{now_us},{values}") if lines == "skt" else f"{values}\n".encode()
            out.append(Chunk("tip", item.host_ns - 1_100_000, line))
        out.append(item)
    return out


@pytest.fixture
def scene(tmp_path):
    return write_scene(tmp_path)


@pytest.mark.parametrize(("link", "lines"), [(TIP, "skt"), (TEXT_TIP, "text")])
def test_each_poke_has_the_position_of_the_tip(scene, tmp_path, link, lines):
    items = with_tip(as_chunks(some_pokes(scene, 3).samples), lines)
    links = (*LINKS, link)
    pipeline = Pipeline(scene, links, None, create_session(tmp_path / "s", scene, links))
    for item in items:
        pipeline.feed(item)
    verdicts = {each.link: each.verdict.answer for each in pipeline.live(items[-1].host_ns).links}
    assert verdicts["tip"] is LinkAnswer.GOOD
    pipeline.close()
    contacts = pipeline.session.contacts
    assert len(contacts) == 3
    for contact in contacts:
        np.testing.assert_allclose(contact.tip, PLACE, atol=1e-9)
    for again in (load(tmp_path / "s"), replay(tmp_path / "s")):
        assert list(map(outcome_key, again.session.contacts)) == list(map(outcome_key, contacts))


def test_the_tip_that_a_robot_reports_with_its_answers_is_a_device():
    server = TargetServer(open_port("127.0.0.1", 0))
    tip = LinkSpec("tip", "targets:/tip", (Stream.TIP,))
    with closing(server), closing(open_link(tip)) as link, socket.create_connection((server.host, server.port)) as robot:
        robot.sendall(b"tip 0.5 -0.25 0.125 0 0 -1\ntip 0.5 -0.25 0.0625 0 0 -1\n")
        data, end_s = b"", time.monotonic() + 30.0
        while data.count(b"\n") < 2 and time.monotonic() < end_s:
            data += link.read(0.1)
    assert data == b"0.500000 -0.250000 0.125000\n0.500000 -0.250000 0.062500\n"
    report_tip(np.zeros(3))
    assert link.read(0.0) == b"", "a closed link gets nothing"
    with pytest.raises(LinkError, match="targets:/tip"):
        open_link(LinkSpec("tip", "targets:/hand", (Stream.TIP,)))


def test_a_stream_that_stopped_gives_no_position_and_stops_no_poke(scene):
    samples = some_pokes(scene, 3).samples
    items = with_tip(as_chunks(samples), "skt", until=samples[0].host_s + 60 * PERIOD_S)
    pipeline = Pipeline(scene, (*LINKS, TIP), None)
    for item in items:
        pipeline.feed(item)
    assert [contact.tip is None for contact in pipeline.session.contacts] == [False, True, True]
    assert pipeline.can_measure(items[-1].host_ns)


def test_without_a_tip_a_poke_is_written_as_before(scene, tmp_path):
    pipeline = Pipeline(scene, LINKS, None, create_session(tmp_path / "s", scene, LINKS))
    for item in as_chunks(some_pokes(scene, 2).samples):
        pipeline.feed(item)
    pipeline.close()
    written = b"".join(path.read_bytes() for path in (tmp_path / "s").rglob("*") if path.is_file())
    assert b'"tare_change"' in written
    assert b'"tip"' not in written
