"""A whole session with a tool over sockets, from the served devices to the positions. By its name, half a minute to one each:
`python3 -m pytest tests/long/test_tool_sessions.py`.

The UR controller sends wrench and pose of its flange by one link, its pose with the tool centre point of the pendant. Trackers
send a lost body beside the tool. The limits are some 1.5 times the errors of one run on a quiet machine (2.1, 3.7, 3.4 and 3.7
mm): few pokes, aimed to 2 mm, and errors of the rig as in `--errors noise`.
"""

from __future__ import annotations

import json
import signal
import subprocess
import sys
import time

import numpy as np
import pytest

from skincal.session.replay import load
from skincal.taxels.result import Method, State

CLI = [sys.executable, "-P", "-m", "skincal.cli"]
PATIENCE_S = 300.0


def record(maker, scene, out, pokes):
    """Record so many accepted pokes from devices in another process; the true positions by channel, and the addresses."""
    serve = [*CLI, "simulate", "--scene", scene, "--serve", "--as", maker, "--pokes", "400", "--careful", "--pace", "3"]
    with subprocess.Popen([*serve, "--json", "--tcp"], stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True) as devices:
        served = json.loads(devices.stdout.readline())
        addresses = {stream: link["address"] for link in served["links"] for stream in link["carries"]}
        options = [word for stream, address in addresses.items() for word in (f"--{stream}", address)]
        command = [*CLI, "record", *options, "--scene", scene, "--out", str(out)]
        with subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True) as recorder:
            accepted, end_s = 0, time.monotonic() + PATIENCE_S
            for line in recorder.stderr:
                accepted += ": accepted" in line
                if accepted >= pokes or time.monotonic() > end_s:
                    break
            recorder.send_signal(signal.SIGINT)
            recorder.communicate(timeout=PATIENCE_S)
        devices.stdin.close()
        devices.terminate()
    return {each["channel"]: np.array(each["position_m"]) for each in served["taxels"]}, addresses


@pytest.mark.parametrize(
    ("maker", "scene", "pokes", "limit_mm"),
    [
        ("rtde", "cobot-forearm", 25, 3.5),
        ("qtm", "cobot-tip", 12, 6.0),
        ("natnet", "cobot-tip", 12, 6.0),
        ("ndi", "cobot-tip", 12, 6.0),
    ],
)
def test_a_session_over_sockets_gives_true_positions(tmp_path, maker, scene, pokes, limit_mm):
    truth, addresses = record(maker, scene, tmp_path / "session", pokes)
    assert addresses["tool"].startswith(f"{maker}://")
    if maker == "rtde":
        assert addresses["tool"] == addresses["wrench"], "one link"
    snapshot = load(tmp_path / "session").snapshot()
    assert len(snapshot.contacts) >= pokes
    touched = [each for each in snapshot.estimates[Method.SURFACE] if each.state is State.TOUCHED and each.channel in truth]
    errors = np.array([np.linalg.norm(each.position - truth[each.channel]) for each in touched]) * 1e3
    assert len(errors) >= pokes
    assert np.median(errors) < limit_mm
    assert errors.max() < 4 * limit_mm
