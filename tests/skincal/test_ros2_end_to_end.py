"""A simulated robot with ROS 2, in a process of its own: recorded live, calibrated, and equal to the same rig over TCP."""

import json
import subprocess
import sys

import numpy as np
import pytest

pytest.importorskip("cyclonedds", reason="the extra ros2 is not installed")

from skincal.cli import main
from skincal.methods import estimate_taxels
from skincal.model.scene import resource
from skincal.part.part import load_part
from skincal.session.replay import load
from skincal.taxels.result import Method, State
from tests.skincal.record_support import told_to_poke

FOREARM = resource("scenes/icub-forearm/scene.toml")
CHANNEL = 204
POKES = [f"{CHANNEL} {tilt} {azimuth} 9" for tilt, azimuth in ((0, 0), (25, 90), (25, 210))] * 4
NEEDED = 3
"""Pokes that count; on a busy machine some do not."""
POSITION_MAX_DIFFERENCE_M = 0.0005
"""m. The same pokes of the same rig: only the rounding of a board and the instants of the frames differ."""


def record(folder, way):
    """Record ordered pokes of a simulated rig in another process; return the addresses of its links, and the contacts."""
    rig = ["--operator", "told", "--careful", "--pace", "4", "--seed", "4", "--errors", "none", "--scene", str(FOREARM)]
    command = [sys.executable, "-m", "skincal.cli", "simulate", "--serve", *rig, way]
    with subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True) as server:
        try:
            links = {link["name"]: link["address"] for link in json.loads(server.stdout.readline())["links"]}
            addresses = [word for name in ("wrench", "skin", "joints") for word in (f"--{name}", links[name])]
            with told_to_poke(server, *POKES, accepted=NEEDED):
                main(["record", *addresses, "--scene", str(FOREARM), "--out", str(folder), "--seconds", "120", "--json"])
        finally:
            server.terminate()
    return links, {contact.poke: contact for contact in load(folder).session.contacts}


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
    # Of the pokes that count in both.
    common = by_ros.keys() & by_tcp.keys()
    part = load_part(FOREARM)
    ros, tcp = (
        estimate_taxels([those[poke] for poke in common], [CHANNEL], [Method.SURFACE], part.scene.noise, part.surface)[
            Method.SURFACE
        ][CHANNEL]
        for those in (by_ros, by_tcp)
    )
    assert (ros.state, tcp.state) == (State.TOUCHED, State.TOUCHED)
    assert np.linalg.norm(ros.position - tcp.position) < POSITION_MAX_DIFFERENCE_M
