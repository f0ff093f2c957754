"""Makers' devices from their simulator's process to a solved session; and the script that the page of devices shows."""

import json
import queue
import re
import subprocess
import sys
import time
from contextlib import closing
from pathlib import Path
from socket import create_server

import pytest

from skincal.cli import main
from skincal.model.readings import LinkEvent, Stream
from skincal.model.scene import resource
from skincal.streams.intake import Intake
from skincal.streams.links import LinkSpec, Reader

PATCH = resource("scenes/flat-patch/scene.toml")
PAGE = Path(__file__).parents[2] / "docs" / "devices.md"


def numbers(said):
    return {name: said[name] for name in ("pokes", "accepted", "methods")}


@pytest.mark.parametrize("speakers", ["netft,xela", "yarp"])
def test_a_session_over_makers_devices_is_recorded_and_plays_to_the_same(tmp_path, capsys, speakers):
    command = ["simulate", "--serve", "--operator", "told", "--careful", "--seed", "4", "--scene", str(PATCH), "--as", speakers]
    folder = tmp_path / "live"
    with subprocess.Popen(
        [sys.executable, "-m", "skincal.cli", *command], stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True
    ) as server:
        try:
            links = {link["name"]: link["address"] for link in json.loads(server.stdout.readline())["links"]}
            server.stdin.write("poke 3 0 0 9\npoke 3 25 90 9\n")
            server.stdin.flush()
            arguments = ["--wrench", links["wrench"], "--skin", links["skin"], "--scene", str(PATCH), "--out", str(folder)]
            assert main(["record", *arguments, "--pokes", "2", "--seconds", "30", "--json"]) == 0
        finally:
            server.terminate()
    live = json.loads(capsys.readouterr().out)
    assert live["accepted"] == 2
    assert main(["solve", str(folder), "--replay", "--json", "--out", str(tmp_path / "out")]) == 0
    assert numbers(json.loads(capsys.readouterr().out)) == numbers(live)


def test_the_script_of_the_page_is_read():
    script = re.search(r"```python\n(import socket, time\n.*?)```", PAGE.read_text(encoding="utf-8"), re.DOTALL)[1]
    with closing(create_server(("127.0.0.1", 0))) as free:
        port = free.getsockname()[1]
    link = LinkSpec("wrench", f"lines://127.0.0.1:{port}", (Stream.WRENCH,))
    items = queue.SimpleQueue()
    intake, reader = Intake(64, [link]), Reader(link, items)
    with subprocess.Popen([sys.executable, "-c", script.replace("7000", str(port))]) as program:
        try:
            reader.start()
            end = time.monotonic() + 10
            while intake.health(0)[0].readings < 300:
                assert time.monotonic() < end, intake.health(0)
                item = items.get(timeout=10)
                if not isinstance(item, LinkEvent):
                    intake.feed(item)
        finally:
            reader.stop()
            program.terminate()
    assert not any(intake.health(0)[0].losses.values())
    assert intake.recent_wrench()[1][-1].tolist() == [0, 0, 1, 0, 0, 0]
