"""A simulated robot with ROS 2, in a process of its own: recorded live, calibrated, and equal to the same rig over TCP."""

import json
import subprocess
import sys

import numpy as np
import pytest

pytest.importorskip("cyclonedds", reason="the extra ros2 is not installed")

from skincal.cli import main
from skincal.model.scene import resource
from skincal.session.replay import load
from skincal.taxels.result import Method, State

FOREARM = resource("scenes/icub-forearm/scene.toml")
CHANNELS = (204, 205)
ORDERS = [
    f"poke {channel} {tilt} {azimuth} 9\n" for channel in CHANNELS for tilt, azimuth in ((0, 0), (25, 90), (25, 210), (25, 330))
]
POSITION_MAX_DIFFERENCE_M = 0.0005
"""m. The same pokes of the same rig: only the rounding of a board and the instants of the frames differ."""


def record(folder, way):
    """Record the ordered pokes from a simulated rig in another process; return the estimates by channel."""
    rig = ["--operator", "told", "--careful", "--seed", "4", "--errors", "none", "--scene", str(FOREARM)]
    command = [sys.executable, "-m", "skincal.cli", "simulate", "--serve", *rig, way]
    with subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True) as server:
        try:
            links = {link["name"]: link["address"] for link in json.loads(server.stdout.readline())["links"]}
            server.stdin.write("".join(ORDERS))
            server.stdin.flush()
            addresses = [word for name in ("wrench", "skin", "joints") for word in (f"--{name}", links[name])]
            main(["record", *addresses, "--scene", str(FOREARM), "--out", str(folder), "--pokes", str(len(ORDERS)), "--json"])
        finally:
            server.terminate()
    return links, {each.channel: each for each in load(folder).snapshot().estimates[Method.SURFACE]}


@pytest.mark.timeout(300)
def test_a_session_by_ros_2_is_the_one_by_tcp(tmp_path, capsys):
    links, by_ros = record(tmp_path / "ros", "--ros2")
    live = json.loads(capsys.readouterr().out)
    assert all(address.startswith("ros2:/") for address in links.values())
    assert main(["solve", str(tmp_path / "ros"), "--replay", "--json", "--out", str(tmp_path / "out")]) == 0
    replayed = json.loads(capsys.readouterr().out)
    assert {name: replayed[name] for name in ("pokes", "accepted", "methods")} == {
        name: live[name] for name in ("pokes", "accepted", "methods")
    }
    _, by_tcp = record(tmp_path / "tcp", "--tcp")
    for channel in CHANNELS:
        ros, tcp = by_ros[channel], by_tcp[channel]
        assert (ros.state, tcp.state) == (State.TOUCHED, State.TOUCHED)
        assert np.linalg.norm(ros.position - tcp.position) < POSITION_MAX_DIFFERENCE_M
