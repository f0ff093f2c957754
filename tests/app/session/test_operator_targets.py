"""The simulated operator is told what the window shows: the lines, who sends them and when, and what comes of them."""

from __future__ import annotations

import json
import subprocess
import sys
import threading
from contextlib import closing

import numpy as np
import pytest
from PySide6.QtCore import Qt

from app.__main__ import main
from app.session.controller import MAX_UNSOLVED_TAXELS
from app.session.opening import Addresses, OpenRequest, server_command
from app.workers.device_process import DeviceProcess
from skincal.cli.record import OrderLine, _loop
from skincal.geometry import axis_point, move_wrench
from skincal.journal.reader import SessionLog
from skincal.mesh.load import load_surface
from skincal.model.actions import FoundAtLandmark, TimedAction, action_to_json
from skincal.model.readings import Chunk, LinkEvent
from skincal.model.scene import resource
from skincal.rig.correction import RIG, Correction, UsedCorrection
from skincal.robot.target_client import read_line
from skincal.robot.target_lines import GREETING
from skincal.session.corrections import correct_action
from skincal.session.pipeline import Pipeline
from skincal.session.session import Session
from skincal.streams.links import ChunkQueue
from skincal.taxels.poke_figures import peak_channel
from tests.app.whole_window import OPEN_MS
from tests.approved import approved
from tests.skincal.poke_script import outcome_key, same_estimates
from tests.skincal.robot.robot_support import Peer

LINKS = '{"links": [{"name": "skin", "address": "socket://127.0.0.1:9", "carries": ["skin"]}]}'


def test_a_line_reaches_the_process_without_waiting(qtbot, tmp_path):
    heard = tmp_path / "heard"
    server = DeviceProcess()
    listen = f"import sys; print('{LINKS}', flush=True); open({str(heard)!r}, 'w').write(sys.stdin.read())"
    with qtbot.waitSignal(server.served, timeout=OPEN_MS):
        server.start((sys.executable, "-c", listen))
        server.listen()
    for line in ("pace 2", "pace 1"):
        server.send_line(line)
    server.stop()
    assert heard.read_text() == "pace 2\npace 1\n"
    server.send_line("pace 2")  # nobody is there any more: nothing happens


def test_a_process_that_never_reads_holds_nothing_up(qtbot):
    server = DeviceProcess()
    with qtbot.waitSignal(server.served, timeout=OPEN_MS):
        server.start((sys.executable, "-c", f"import time; print('{LINKS}', flush=True); time.sleep(60)"))
        server.listen()
    for _ in range(5000):
        server.send_line("x" * 100)  # eight times what a pipe holds
    server.stop()
    assert not server.is_running


def test_the_rig_that_opens_by_default_follows():
    command = server_command(None)
    assert command[command.index("--operator") + 1] == "guided"


def test_pokes_come_where_the_window_asks_for_them(bench, said):
    bench.open_served("flat-patch")
    asked: dict[int, int] = {}

    def poked(count: int) -> bool:
        shown = bench.window.session_view.state.target
        asked.setdefault(len(bench.accepted()), shown.channel)
        return len(bench.accepted()) >= count

    bench.until(lambda: poked(6))
    contacts = bench.accepted()
    hits = [peak_channel(contact) == asked[i] for i, contact in enumerate(contacts[:6])]
    # With an aim of 2 mm among taxels 6 mm apart; by itself it would be one of 64.
    assert sum(hits) >= 2
    numbers = [int(line.split()[1]) for line in said if line.startswith("target ")]
    assert numbers == list(range(1, len(numbers) + 1)), "each has a number of its own"
    judged = [int(line.split()[1]) for line in said if line.startswith(("accepted ", "rejected "))]
    assert len(judged) >= 5
    assert judged == sorted(set(judged)), "and one verdict"

    def last_request():
        """The last line that is not about a poke in progress, which the hand may just make."""
        return next(line for line in reversed(said) if line.partition(" ")[0] not in ("held", "accepted", "rejected"))

    asked_now = [line for line in said if line.startswith("target ")]
    bench.key(Qt.Key.Key_N)
    bench.until(lambda: last_request().startswith("target ") and last_request() != asked_now[-1], 5000)
    assert read_line(last_request()).channel == bench.window.session_view.state.target.channel
    bench.key(Qt.Key.Key_G)
    assert last_request() == "any"
    bench.key(Qt.Key.Key_G)
    assert last_request().startswith("target ")
    bench.key(Qt.Key.Key_Space)
    assert last_request() == "wait"
    bench.key(Qt.Key.Key_Space)
    bench.until(lambda: last_request().startswith("target "), 5000)
    known = len(bench.snapshot.pokes)
    bench.until(lambda: len(bench.snapshot.pokes) > known)


def test_landmarks_are_poked_where_the_window_asks_and_named_after_what_it_asked_for(bench, said, tmp_path):
    folder = tmp_path / "mine"
    bench.open_served(folder=folder)
    session_view = bench.window.session_view
    bench.until(lambda: session_view.state.target is not None and session_view.state.target.landmark != "")
    bench.until(lambda: len(bench.snapshot.at_landmarks) >= 3)
    lived = bench.recording.pipeline
    order = read_line(next(line for line in reversed(said) if line.startswith("target ")))
    assert order.known == (bench.window.session_view.state.target.landmark != "")
    made = bench.recording.pipeline.session.landmark_pokes
    assert len({poke.name for poke in made}) == len(made) >= 3, "one after another, each once"
    for poke in made:
        force, moment = move_wrench(poke.link_from_sensor, poke.force, poke.moment)
        away = np.cross(poke.place - axis_point(force, moment), force) / np.linalg.norm(force)
        assert np.linalg.norm(away) < 0.006, "sensor noise and 0.7 mm of the hand: the axis passes its landmark"
    assert bench.controller.act(correct_action(UsedCorrection(RIG, Correction(1.02 * np.eye(6)), 7e-3, 2e-3, len(made))))
    bench.until(lambda: RIG in bench.snapshot.decisions.corrections)
    bench.window.close()
    without_a_window(folder, lived)


def without_a_window(folder, lived) -> None:
    """From the same bytes and orders `record` makes the same session as the window."""
    log = SessionLog(folder)
    items = ChunkQueue()
    for item in log.items():
        if isinstance(item, Chunk | LinkEvent):
            items.put(item)
        elif isinstance(item, TimedAction) and not isinstance(item.action, FoundAtLandmark):
            items.put(OrderLine(item.host_ns, json.dumps(action_to_json(item.action)).encode()))
    surface = load_surface(log.scene.surface)[0]
    headless = Pipeline(log.scene, log.links, surface)
    _loop(headless, items, {}, (None, None), threading.Event())
    headless.close()
    here, there = headless.snapshot(), lived.snapshot()
    assert here.at_landmarks == there.at_landmarks
    assert len(here.at_landmarks) >= 3
    assert here.decisions.corrections.keys() == there.decisions.corrections.keys() == {RIG}
    assert [outcome_key(poke.outcome) for poke in here.pokes] == [outcome_key(poke.outcome) for poke in there.pokes]
    assert same_estimates(here, there)
    assert here.can_undo == there.can_undo


FLAT = resource("scenes/flat-patch/scene.toml")


def test_nobody_is_asked_to_press_where_no_device_answers(bench, said):
    nobody = "socket://127.0.0.1:9"
    bench.open(OpenRequest(scene=FLAT, addresses=Addresses(nobody, nobody.replace("9", "10")), targets="0"))
    bench.until(lambda: bench.window.session_view.state.target is not None)
    bench.until(lambda: bool(said))
    bench.qtbot.wait(300)
    assert said == ["wait"]


@pytest.fixture
def resting():
    """The addresses of devices that nobody touches."""
    command = [sys.executable, "-P", "-m", "skincal.cli", "simulate", "--scene", "flat-patch", "--serve", "--tcp"]
    devices = subprocess.Popen([*command, "--operator", "told"], stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True)
    with devices:
        links = json.loads(devices.stdout.readline())["links"]
        yield Addresses(*(link["address"] for link in links))
        devices.stdin.close()


def test_a_robot_beside_the_window_hears_skips_stops_and_comes_back(bench, resting, monkeypatch):
    bench.open(OpenRequest(scene=FLAT, addresses=resting, targets="0"))
    port = bench.controller._targets.port
    with closing(Peer(port)) as peer:
        assert peer.line() == GREETING

        def targets(line):
            while not line.startswith("target "):
                assert line == "wait"
                line = on_the_side(bench, peer.line)
            return read_line(line)

        first = targets(on_the_side(bench, peer.line))
        assert (first.frame, first.channel) == ("patch", bench.window.session_view.state.target.channel)
        with monkeypatch.context() as solving:
            solving.setattr(Session, "unsolved", MAX_UNSOLVED_TAXELS + 1)
            peer.say(f"skip {first.number}")
            bench.qtbot.wait(300)
        # What it says while all taxels are being solved is done once they are.
        second = read_line(on_the_side(bench, peer.line))
        assert (second.number, second.channel != first.channel) == (first.number + 1, True)
        peer.say(f"fault {second.number} joint 3 at its end")
        assert on_the_side(bench, peer.line) == "wait"
        why = approved("targets.stopped", number=second.number, why="joint 3 at its end")
        bench.until(lambda: any(why in message.text for message in bench.messages), 5000)
    with closing(Peer(port)) as peer:
        assert peer.line() == GREETING
        again = targets(on_the_side(bench, peer.line))
        assert (again.number, again.channel) == (second.number + 1, second.channel)
    # As from the set-up page, which asks for no port.
    bench.open(OpenRequest(scene=FLAT, addresses=resting))
    port = bench.controller._targets.port
    with closing(Peer(port)) as peer:
        assert peer.line() == GREETING
        assert targets(on_the_side(bench, peer.line)).number == 1
    bench.window.close()
    with pytest.raises(OSError, match="refused"):
        Peer(port)


def on_the_side(bench, read):
    """What `read` returns, while the window goes on."""
    found = []
    thread = threading.Thread(target=lambda: found.append(read()))
    thread.start()
    bench.until(lambda: bool(found), 10_000)
    thread.join()
    return found[0]


WITHOUT = {
    "--targets 7010": "no device is named",
    "--targets x": approved("targets.no_port"),
    "--headless --targets 1": "--headless",
}


@pytest.mark.parametrize("options", WITHOUT)
def test_targets_without_devices_are_refused(options, capsys):
    assert main(options.split()) == 2
    assert WITHOUT[options] in capsys.readouterr().err
