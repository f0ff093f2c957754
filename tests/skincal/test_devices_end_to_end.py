"""Makers' devices from their simulator's process to a solved session; and the examples that the page of devices shows."""

import json
import queue
import re
import shutil
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
from skincal.streams.expected_readings import ExpectedReadings
from skincal.streams.intake import Intake
from skincal.streams.links import LinkSpec, Reader
from tests.skincal.record_support import told_to_poke

PATCH = resource("scenes/flat-patch/scene.toml")
PAGE = Path(__file__).parents[2] / "docs" / "devices.md"


def numbers(said):
    return {name: said[name] for name in ("pokes", "accepted", "methods")}


@pytest.mark.parametrize("speakers", ["netft,xela", "yarp"])
def test_a_session_over_makers_devices_is_recorded_and_plays_to_the_same(tmp_path, capsys, speakers):
    command = ["simulate", "--serve", "--operator", "told", "--careful", "--pace", "4", "--scene", str(PATCH), "--as", speakers]
    folder = tmp_path / "live"
    with subprocess.Popen(
        [sys.executable, "-m", "skincal.cli", *command], stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True
    ) as server:
        try:
            links = {link["name"]: link["address"] for link in json.loads(server.stdout.readline())["links"]}
            arguments = ["--wrench", links["wrench"], "--skin", links["skin"], "--scene", str(PATCH), "--out", str(folder)]
            with told_to_poke(server, *["3 0 0 9", "3 25 90 9"] * 6, accepted=2):
                assert main(["record", *arguments, "--seconds", "120", "--json"]) == 0
        finally:
            server.terminate()
    live = json.loads(capsys.readouterr().out)
    assert live["accepted"] >= 2
    assert main(["solve", str(folder), "--replay", "--json", "--out", str(tmp_path / "out")]) == 0
    assert numbers(json.loads(capsys.readouterr().out)) == numbers(live)


ROS = {
    "rclpy.py": """
import time
def init(): pass
def create_node(name): return Node()
def spin(node):
    for count in range(10**6):
        node.hear(message(count))
        time.sleep(0.001)
class Node:
    def create_subscription(self, kind, topic, hear, depth): self.hear = hear
class Fields:
    def __init__(self, **fields): self.__dict__ |= fields
def message(count):
    wrench = Fields(force=Fields(x=0.0, y=0.0, z=1.0), torque=Fields(x=0.0, y=0.0, z=0.0))
    return Fields(wrench=wrench, header=Fields(stamp=Fields(sec=count // 1000, nanosec=count % 1000 * 1_000_000)))
""",
    "geometry_msgs/msg.py": "WrenchStamped = object\n",
}
"""As much of ROS 2 as the page's example uses."""


def free_port():
    with closing(create_server(("127.0.0.1", 0))) as free:
        return str(free.getsockname()[1])


def example(language, beginning, port):
    found = re.search(rf"```{language}\n({re.escape(beginning)}.*?)```", PAGE.read_text(encoding="utf-8"), re.DOTALL)
    return found[1].replace("7000", port)


def python_script(_folder, port):
    return [sys.executable, "-c", example("python", "import socket, time", port)]


def ros_node(folder, port):
    for name, content in ROS.items():
        (folder / name).parent.mkdir(exist_ok=True)
        (folder / name).write_text(content, encoding="utf-8")
    text = example("python", "import socket, rclpy", port)
    return [sys.executable, "-c", f"import sys; sys.path.insert(0, {str(folder)!r})\n{text}"]


def cpp_program(folder, port):
    compiler = shutil.which("g++") or shutil.which("clang++")
    if compiler is None or sys.platform == "win32":
        pytest.skip("no compiler of C++ for POSIX here")
    (folder / "sensor.cpp").write_text(example("cpp", "#include <arpa/inet.h>", port), encoding="utf-8")
    subprocess.run([compiler, "-Wall", "-Werror", "-o", folder / "sensor", folder / "sensor.cpp"], check=True)
    return [folder / "sensor"]


@pytest.mark.parametrize("made", [python_script, ros_node, cpp_program])
def test_each_example_of_the_page_is_read(made, tmp_path):
    port = free_port()
    command = made(tmp_path, port)
    link = LinkSpec("wrench", f"lines://127.0.0.1:{port}", (Stream.WRENCH,))
    items = queue.SimpleQueue()
    intake, reader = Intake(ExpectedReadings(64), [link]), Reader(link, items)
    with subprocess.Popen(command) as program:
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
