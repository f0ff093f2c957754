"""`skincal demo robot`: the arm in the physics engine pokes by itself, its tip is seen, and a key stops it."""

import numpy as np
import pytest
from PySide6.QtCore import Qt
from PySide6.QtWidgets import QLabel

from app.__main__ import main
from app.panels.first_minute import FirstMinute
from app.run import robot_demo
from app.scene3d.robot_tip import RobotTipLayer
from app.text.demo_text import FIRST_MINUTE_ROBOT
from skincal.robot.target_lines import NoTarget

pytest.importorskip("mujoco")
POKES = 2
POKING_MS = 240_000
STOPPED_MM = 0.05


def tip_layer(bench):
    renderer = bench.window.session_view.workspace.view._renderer
    return None if renderer is None else next(each for each in renderer.layers if isinstance(each, RobotTipLayer))


def tip_of(bench):
    return bench.controller.guided.tip


@pytest.mark.timeout(600)
def test_the_arm_pokes_by_itself_its_tip_moves_in_the_view_and_s_stops_it(bench):
    bench.open(robot_demo())
    (card,) = bench.window.findChildren(FirstMinute)
    assert FIRST_MINUTE_ROBOT[1][0] in " ".join(label.text() for label in card.findChildren(QLabel))
    bench.until(lambda: tip_layer(bench) is not None and not tip_layer(bench).ball.is_empty, POKING_MS)
    seen = []

    def poked():
        if not seen or (tip_layer(bench).ball.mesh.points[0] != seen[-1]).any():
            seen.append(tip_layer(bench).ball.mesh.points[0].copy())
        return len(bench.accepted()) >= POKES

    bench.until(poked, POKING_MS)
    assert np.ptp(np.array(seen), axis=0).max() > 0.01, "the tip moves in the view"
    on_skin = [each for each in bench.snapshot.pokes if each.outcome.poke not in bench.snapshot.at_landmarks]
    assert len(bench.accepted()) >= 0.8 * len(on_skin)
    bench.key(Qt.Key.Key_S)
    assert bench.controller.guided.is_halted
    bench.until(lambda: "stopped" in bench.window.session_view.workspace.now.headline.text(), 10_000)
    still = _wait_until_it_stands(bench)
    bench.qtbot.wait(1500)
    assert np.linalg.norm(tip_of(bench).place - still) < 1e-3 * STOPPED_MM
    bench.key(Qt.Key.Key_S)
    bench.until(lambda: np.linalg.norm(tip_of(bench).place - still) > 0.003, POKING_MS)


def _wait_until_it_stands(bench):
    """Place of a tip that has not moved for some reports."""
    places = []

    def stands():
        if not places or tip_of(bench) is not places[-1]:
            places.append(tip_of(bench))
        last = np.array([each.place for each in places[-5:]])
        return len(last) == 5 and np.ptp(last, axis=0).max() < 1e-3 * STOPPED_MM

    bench.until(stands, 20_000)
    return places[-1].place


def test_stop_is_sent_at_once_and_again_to_a_robot_that_comes_back(bench):
    from tests.app.test_window_demo import demo

    bench.open(demo())
    bench.until(lambda: len(bench.accepted()) >= 1)
    sent, server = [], bench.controller._targets
    send = server.send
    server.send = lambda lines: (sent.extend(lines), send(lines))
    bench.key(Qt.Key.Key_S)
    # The outcome of a poke may follow.
    assert [line for line in sent if isinstance(line, NoTarget)][-2:] == [NoTarget.WAIT, NoTarget.STOP]
    assert server._target is NoTarget.STOP
    sent.clear()
    bench.qtbot.wait(500)
    assert all(not hasattr(line, "place") for line in sent), "no target while it is stopped"


@pytest.mark.parametrize("words", [["demo"], ["demo", "arm"], ["demo", "robot", "now"]])
def test_another_demonstration_is_refused(words, capsys):
    assert main(words) == 2
    assert "expected demo robot" in capsys.readouterr().err


def test_the_demonstration_has_help(capsys):
    assert main(["demo", "robot", "--help"]) == 0
    assert "--sensor below|tool|none" in capsys.readouterr().out
