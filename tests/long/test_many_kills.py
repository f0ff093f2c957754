"""kill -9 many times, with a second opener all the while: no accepted poke is lost. `python3 -m pytest tests/long`."""

import os
import random
import re
import signal
import subprocess
import sys
import threading
import time
from pathlib import Path

import pytest

from skincal.session.replay import resume
from tests.skincal.journal.journal_support import ROOT
from tests.skincal.journal.kill_support import assert_kept, killed_in_a_row, second_opener
from tests.skincal.record_support import recorder, write_devices

pytestmark = pytest.mark.skipif(not hasattr(signal, "SIGKILL"), reason="this system has no kill -9")
AT_ONCE, ROUNDS = 6, 5
LONGEST_S = 8.0
"""s until a recording is killed: seven pokes."""
WINDOWS = 6
POKE_S = 3.0
"""s of a poke of the simulated operator: a window is killed at some instant of it."""
WINDOW_S = 60.0
"""s. A window has shown its first pokes after ten."""
WINDOW = """
import runpy, sys
from app.workspace import Workspace
from skincal.contacts.outcome import Contact
from tests.skincal.journal.kill_support import key_of
show, told = Workspace.show_state, set()
def show_and_tell(workspace, state, *words):
    show(workspace, state, *words)
    for record in state.snapshot.pokes:
        outcome = record.outcome
        if isinstance(outcome, Contact) and (outcome.poke, outcome.final) not in told:
            told.add((outcome.poke, outcome.final))
            print("poke", outcome.poke, key_of(outcome) if outcome.final else "", flush=True)
Workspace.show_state = show_and_tell
runpy.run_module("app", run_name="__main__", alter_sys=True)
"""
"""The program as it starts, which says what it shows: a poke when it is first accepted, and again when that is final."""


def killed_recordings(folder, rng):
    """Kill recordings at random instants; return for each its folder and the pokes that it said were accepted."""
    options = write_devices(folder, 12, seed=rng.randrange(1000))
    sessions = [folder / f"s{k}" for k in range(AT_ONCE)]
    processes = [recorder(options, session) for session in sessions]
    for process in processes:
        assert process.stderr.readline()  # a link is open: the session is made
    begun_s, told = time.monotonic(), {}
    with second_opener(*sessions):
        moments = sorted((rng.uniform(0, LONGEST_S), k) for k in range(AT_ONCE))
        for at_s, k in moments:
            time.sleep(max(0.0, begun_s + at_s - time.monotonic()))
            process, session = processes[k], sessions[k]
            process.kill()
            said = process.communicate()[1]
            assert process.returncode == -signal.SIGKILL, said
            told[session] = [int(poke) for poke in re.findall(r"^poke (\d+): accepted.*\n", said, re.MULTILINE)]
    return told


@pytest.mark.timeout(600)
def test_thirty_recordings_killed_at_random_instants_lose_no_accepted_poke(tmp_path):
    rng, accepted = random.Random(30), 0
    for turn in range(ROUNDS):
        for session, told in killed_recordings(tmp_path / str(turn), rng).items():
            kept = assert_kept(session, [])
            assert {contact.poke for contact in kept.session.contacts} >= set(told)
            resume(session).close()
            accepted += len(told)
    assert accepted > ROUNDS * AT_ONCE


@pytest.mark.timeout(600)
def test_twenty_kills_in_a_row_lose_no_accepted_poke(tmp_path):
    assert killed_in_a_row(tmp_path, 20, seed=20) > 20


def killed_window(session: Path, rng: random.Random) -> list[tuple[int, str]]:
    """Kill a window, and all that it started, in the middle of its simulated session; return the pokes that it showed.

    Each is its number, and what it finally was, where the window knew that.
    """
    own = {"XDG_CONFIG_HOME": str(session.parent), "XDG_DATA_HOME": str(session.parent), "PYTHONPATH": str(ROOT)}
    process = subprocess.Popen(
        [sys.executable, "-P", "-X", "faulthandler", "-c", WINDOW, "--scene", "flat-patch", "--new", str(session)],
        stdout=subprocess.PIPE,
        text=True,
        env=os.environ | own,
        start_new_session=True,
    )
    assert process.stdout is not None
    # One that shows nothing must not be waited for.
    end = threading.Timer(WINDOW_S, os.killpg, (process.pid, signal.SIGKILL))
    end.start()
    lines = []
    try:
        for _ in range(rng.randrange(1, 4)):
            lines.append(process.stdout.readline())
        # Every other one dies as soon as a poke is seen: what is written a moment later is lost.
        time.sleep(rng.choice((0.0, rng.uniform(0.0, POKE_S))))
    finally:
        end.cancel()
        os.killpg(process.pid, signal.SIGKILL)
    lines += process.communicate()[0].splitlines(keepends=True)
    assert process.returncode == -signal.SIGKILL, "it was alive until it was killed"
    # A torn line is of a poke that nobody was told of.
    words = [line.split() for line in lines if line.endswith("\n")]
    return [(int(number), "".join(key)) for _, number, *key in words]


@pytest.mark.timeout(900)
@pytest.mark.skipif(not sys.platform.startswith("linux"), reason="it needs a virtual display")
def test_six_windows_killed_at_random_instants_lose_no_poke_that_they_showed(tmp_path):
    rng = random.Random(6)
    for turn in range(WINDOWS):
        session = tmp_path / f"s{turn}"
        with second_opener(session):
            shown = killed_window(session, rng)
        assert shown, "no poke was accepted before the kill"
        resume(session).close()
        kept = assert_kept(session, [key for _, key in shown if key])
        assert {contact.poke for contact in kept.session.contacts} >= {number for number, _ in shown}
