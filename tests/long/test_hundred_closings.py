"""A window that is closed at random instants of a poke, 100 times, leaves 100 closed sessions.

By its name: `python3 -m pytest tests/long/test_hundred_closings.py`; SKINCAL_CLOSINGS=10 makes it shorter.
"""

import os
import random
import subprocess
import sys

import pytest

from skincal.session.replay import load
from tests.skincal.journal.journal_support import ROOT
from tests.skincal.journal.kill_support import assert_kept

CLOSINGS = int(os.environ.get("SKINCAL_CLOSINGS", "100"))
POKE_S = 3.0
"""s of a poke of the simulated operator: a window is closed at some instant of it."""
WINDOW_S = 120.0
"""s until a window that does not close fails the test. On a busy machine it has shown its first poke after 20."""
WINDOW = """
import runpy, sys
from PySide6.QtCore import QTimer
from app.workspace import Workspace
show, delay_ms, is_closing = Workspace.show_state, int(sys.argv.pop()), []
def show_and_close(workspace, state, *words):
    show(workspace, state, *words)
    if state.snapshot.pokes and not is_closing:
        is_closing.append(True)
        QTimer.singleShot(delay_ms, workspace.window().close)
Workspace.show_state = show_and_close
runpy.run_module("app", run_name="__main__", alter_sys=True)
"""
"""The program as it starts, whose window is closed by its own cross some time after the first poke."""


@pytest.mark.timeout(WINDOW_S * CLOSINGS)
@pytest.mark.skipif(not sys.platform.startswith("linux"), reason="it needs a virtual display")
def test_windows_closed_while_poking_leave_closed_sessions(tmp_path):
    rng, open_sessions = random.Random(100), []
    for turn in range(CLOSINGS):
        session = tmp_path / f"s{turn}"
        own = {"XDG_CONFIG_HOME": str(tmp_path), "XDG_DATA_HOME": str(tmp_path), "PYTHONPATH": str(ROOT)}
        delay = str(round(1e3 * rng.uniform(0.0, POKE_S)))
        window = [sys.executable, "-P", "-c", WINDOW, "--scene", "flat-patch", "--new", str(session), delay]
        subprocess.run(window, env=os.environ | own, timeout=WINDOW_S, check=True)
        loaded = load(session)
        assert loaded.session.last_poke > 0
        if loaded.findings:
            open_sessions.append((turn, loaded.findings))
        assert_kept(session, [])
    assert not open_sessions
