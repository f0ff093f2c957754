"""What waits to be worked on has an end, link by link; a server that lost its power is noticed."""

import json
import queue
import socket
import sys
import time

import pytest

from skincal.journal.documents import event_to_json, read_document
from skincal.model.readings import Chunk, LinkEvent, LinkState, Loss, Stream
from skincal.streams.expected_readings import ExpectedReadings
from skincal.streams.intake import Intake
from skincal.streams.links import (
    BYTES_AT_ONCE,
    DROP_BYTES_AFTER_OVERFLOW_FOR_NS,
    QUEUED_MAX_BYTES,
    ChunkQueue,
    LinkSpec,
    Reader,
)
from skincal.streams.transports.tcp import TcpLink

BLOCK = bytes(65536)
SECOND = 1_000_000_000


def test_a_flood_is_dropped_counted_and_costs_the_other_link_nothing():
    """2.5 GB in ten seconds on one link, a reading every ten milliseconds on the other."""
    inbox, taken, others, most = ChunkQueue(), 0, [], 0
    events = []
    begun_ns = time.monotonic_ns() + 1000 * SECOND  # a clock of its own: these ten seconds pass in a moment
    for k in range(40_000):
        now_ns = begun_ns + k * 10 * SECOND // 40_000
        inbox.put(Chunk("garbage", now_ns, BLOCK))
        if k % 40 == 0:
            inbox.put(Chunk("skin", now_ns, b"frame"))
        if k % 130 == 0:  # a tick
            late = []
            while not inbox.empty():
                item = inbox.get()
                late.append(now_ns - item.host_ns)
                if isinstance(item, LinkEvent):
                    events.append(item)
                elif item.link == "skin":
                    others.append(item)
                else:
                    taken += len(item.data)
            most = max(most, *late)
    inbox.put(Chunk("garbage", now_ns + SECOND, b""))
    while not inbox.empty():
        item = inbox.get()
        taken += len(item.data) if isinstance(item, Chunk) and item.link == "garbage" else 0
        others += [item] if isinstance(item, Chunk) and item.link == "skin" else []
        events += [item] if isinstance(item, LinkEvent) else []
    assert len(others) == 1000
    assert most < 0.1 * SECOND, "nothing that is shown is from long ago"
    assert {event.link for event in events} == {"garbage"}
    assert 2 <= len(events) <= 20, "said twice a second at most"
    assert taken + sum(event.dropped for event in events) == 40_000 * len(BLOCK)


def test_memory_is_bounded_for_many_small_pieces():
    inbox = ChunkQueue()
    for k in range(100_000):
        inbox.put(Chunk("wrench", k, b"x"))
    kept = 0
    while True:
        try:
            inbox.get(timeout=0)
        except queue.Empty:
            break
        kept += 1
    assert 1000 < kept < QUEUED_MAX_BYTES // 200 + 1


def test_what_was_dropped_is_said_when_the_link_falls_silent():
    inbox = ChunkQueue()
    for _ in range(20):
        inbox.put(Chunk("wrench", time.monotonic_ns(), BLOCK))
    while not inbox.empty():
        inbox.get()
    time.sleep(DROP_BYTES_AFTER_OVERFLOW_FOR_NS * 1e-9 + 0.05)
    assert not inbox.empty()
    event = inbox.get()
    assert event.dropped == 5 * len(BLOCK)
    assert str(event.dropped) in event.text
    assert inbox.empty()


def flooded():
    inbox = ChunkQueue()
    for _ in range(20):
        inbox.put(Chunk("wrench", time.monotonic_ns(), BLOCK))
    return inbox


def rest_of(inbox):
    items = []
    while not inbox.empty():
        items.append(inbox.get())
    return [item for item in items if isinstance(item, LinkEvent)]


def test_what_was_dropped_is_said_before_the_link_is_lost_or_nothing_comes_any_more():
    """In half a second a network brings a gigabyte."""
    inbox = flooded()
    inbox.put(LinkEvent("wrench", time.monotonic_ns(), LinkState.LOST, "gone"))
    dropped, lost = rest_of(inbox)
    assert (dropped.dropped, lost.state) == (5 * len(BLOCK), LinkState.LOST)
    inbox = flooded()
    inbox.finish()
    (dropped,) = rest_of(inbox)
    assert dropped.dropped == 5 * len(BLOCK)


def test_dropped_bytes_are_a_loss_of_the_link_and_come_back_from_the_journal(tmp_path):
    links = (LinkSpec("wrench", "file:none", (Stream.WRENCH,), "skt"),)
    event = LinkEvent("wrench", 5, LinkState.OPEN, "dropped", 1234)
    assert read_document(json.dumps(event_to_json(event)).encode(), tmp_path) == event
    plain = LinkEvent("wrench", 5, LinkState.OPEN)
    assert "dropped" not in event_to_json(plain)
    intake = Intake(ExpectedReadings(4), links)
    intake.feed(event)
    (health,) = intake.health(6)
    assert health.losses[Loss.DROPPED] == 1234


def served():
    server = socket.create_server(("127.0.0.1", 0))
    return server, server.getsockname()[1]


def test_a_silent_server_is_asked_within_ten_seconds():
    server, port = served()
    link = TcpLink("socket://x", "127.0.0.1", port)
    try:
        option = link._socket.getsockopt
        assert option(socket.SOL_SOCKET, socket.SO_KEEPALIVE)
        idle = getattr(socket, "TCP_KEEPIDLE", getattr(socket, "TCP_KEEPALIVE", None))
        if None in (idle, getattr(socket, "TCP_KEEPINTVL", None), getattr(socket, "TCP_KEEPCNT", None)):
            pytest.skip("this system has other names for it")
        numbers = [option(socket.IPPROTO_TCP, name) for name in (idle, socket.TCP_KEEPINTVL, socket.TCP_KEEPCNT)]
        assert numbers[0] + numbers[1] * numbers[2] < 10
    finally:
        link.close()
        server.close()


@pytest.mark.skipif(not sys.platform.startswith("linux"), reason="only there a connection can end without a word")
def test_a_server_that_lost_its_power_is_noticed_and_connected_anew():
    """A socket in repair mode is closed without a packet: the other end has a connection to nobody."""
    server, port = served()
    inbox = ChunkQueue()
    reader = Reader(LinkSpec("wrench", f"socket://127.0.0.1:{port}", (Stream.WRENCH,)), inbox)
    reader.start()
    connection, _ = server.accept()
    try:
        try:
            connection.setsockopt(socket.IPPROTO_TCP, 19, 1)
        except OSError:
            pytest.skip("it needs the rights of an administrator")
        began = time.monotonic()
        connection.close()
        server.settimeout(10)
        again, _ = server.accept()
        again.close()
        assert time.monotonic() - began < 10
        states = []
        while not inbox.empty():
            states.append(inbox.get().state)
        assert LinkState.LOST in states
    finally:
        reader.stop()
        connection.close()
        server.close()


def test_wide_frames_are_given_in_turns_of_some_milliseconds_of_work():
    inbox = ChunkQueue()
    for _ in range(60):
        inbox.put(Chunk("skin", 0, b"x" * 12_000))
        inbox.put(Chunk("wrench", 0, b"y" * 40))
    turns = []
    while not inbox.empty():
        turns.append(inbox.get_many(0.0))
    assert max(sum(len(item.data) for item in turn) for turn in turns) < BYTES_AT_ONCE + 12_000
    assert [item.link for turn in turns for item in turn] == ["skin", "wrench"] * 60
