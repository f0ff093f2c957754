"""`record` seen from outside: a folder that vanishes, a device that sends garbage as fast as a network."""

import contextlib
import json
import os
import random
import re
import shutil
import socket
import sys
import time
from pathlib import Path

import numpy as np
import pytest

from skincal.journal.reader import SessionLog
from skincal.model.readings import Chunk, Loss
from tests.approved import approved
from tests.skincal.meanwhile import meanwhile
from tests.skincal.record_support import recorder, write_devices


@pytest.mark.skipif(os.name == "nt", reason="open files cannot be taken away there")
def test_a_folder_that_vanishes_ends_the_recording_with_2(tmp_path):
    with recorder(write_devices(tmp_path, 30), tmp_path / "s") as process:
        try:
            for line in process.stderr:
                if "accepted" in line:
                    break
            shutil.rmtree(tmp_path / "s")
            said = process.stderr.read().splitlines()
            assert process.wait(10) == 2
        finally:
            process.kill()
    assert approved("session.folder_gone") in said[-1]
    assert "export" not in said[-1]
    assert sum("accepted" in line for line in said) <= 2, "a poke takes a second"
    assert not (tmp_path / "s").exists()


FLOOD_S = 3.0


IN_BUFFERS = 64 << 20
"""Bytes that the system may hold of a connection that is read no more."""


def is_of(item, link):
    return isinstance(item, Chunk) and item.link == link


def most_memory(pid):
    """Most memory that a process had so far, kB; 0 where it has ended."""
    with contextlib.suppress(OSError):
        found = re.search(r"VmHWM:\s*(\d+) kB", Path(f"/proc/{pid}/status").read_text(encoding="ascii"))
        return int(found[1]) if found else 0
    return 0


@contextlib.contextmanager
def flooding():
    """A server that sends garbage as fast as the loopback takes it, for a few seconds; its port, and what it sent."""
    garbage, sent = random.Random(1).randbytes(1 << 20), [0]
    server = socket.create_server(("127.0.0.1", 0))
    # A busy machine starts the recorder late; nobody comes where it does not start.
    server.settimeout(60.0)

    def flood(over):
        with contextlib.suppress(OSError):
            connection, _ = server.accept()
            end_s = time.monotonic() + FLOOD_S
            with connection:
                while time.monotonic() < end_s and not over.is_set():
                    sent[0] += connection.send(garbage)

    with contextlib.closing(server), meanwhile(flood):
        yield server.getsockname()[1], sent


@pytest.mark.skipif(not sys.platform.startswith("linux"), reason="only there a process's memory is told so")
@pytest.mark.quiet
def test_garbage_at_the_speed_of_a_network_is_dropped_by_link_and_costs_the_others_nothing(tmp_path):
    options = write_devices(tmp_path, 10)
    with flooding() as (port, sent):
        options[1] = f"socket://127.0.0.1:{port}"
        with recorder([*options, "--seconds", str(FLOOD_S), "--json"], tmp_path / "s") as process:
            told, most = "", 0
            for line in process.stderr:
                told, most = told + line, max(most, most_memory(process.pid))
            result = json.loads(process.stdout.read())["links"]
    assert process.returncode == 2, "the wrench gave no reading"
    assert sent[0] > 100 << 20
    recorded = sum(len(item.data) for item in SessionLog(tmp_path / "s").items() if is_of(item, "wrench"))
    dropped = result["wrench"]["lost"][Loss.DROPPED.value]
    assert sent[0] - IN_BUFFERS <= recorded + dropped <= sent[0]
    # How much is recorded is told by the machine's speed: that memory stays small, and others are read, is told below.
    assert dropped > 0
    assert told.count("bytes were dropped") <= 2 * FLOOD_S + 2
    assert Loss.DROPPED.value not in result["skin"]["lost"]
    frames = [item.host_ns for item in SessionLog(tmp_path / "s").items() if is_of(item, "skin")]
    assert np.median(np.diff(frames)) < 0.1e9, "what comes every 60 ms is read at its time"
    assert np.max(np.diff(frames)) < 1e9
    assert 0 < most < 200_000
