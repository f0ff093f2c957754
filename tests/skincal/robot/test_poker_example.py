"""The template for a real robot, against the real target server: one poke, and what ends one early."""

import importlib.util
import threading
import time
from contextlib import closing

import numpy as np
import pytest

from skincal.model.scene import resource
from skincal.robot.target_lines import Answer, Held, NoTarget, PokeTarget, RobotPace, TipPose, write_answer
from skincal.robot.target_server import TargetServer, parse_port

PATIENCE_S = 60.0
DOWN = np.array([0.0, 0.0, -1.0])
STIFFNESS = 2000.0


def load_example():
    spec = importlib.util.spec_from_file_location("poker", resource("examples/poker.py"))
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


class FlatPart:
    """An arm above a flat part at height 0, in its own time, four times as fast: faster, its reports were a flood."""

    def __init__(self):
        self.now_s, self.place, self.force_age_s, self.stiffness = 0.0, (0.0, 0.0, 0.2), 0.0, STIFFNESS
        self.course, self.reach = [], lambda _place: True

    def monotonic(self):
        return self.now_s

    def sleep(self, seconds):
        self.now_s += seconds
        time.sleep(seconds / 4.0)

    def read(self):
        return self.place, 3.0 + self.stiffness * max(0.0, -self.place[2]), self.force_age_s

    def move_tip(self, place, _push):
        self.course.append(place[2])
        self.place = place

    def can_reach(self, place, _push):
        return self.reach(place)


class Bench:
    """The example, running; the server that asks it, and what it answers."""

    def __init__(self, server):
        self.server, self.arm, self.answers, self.ended = server, FlatPart(), [], None
        example = load_example()
        example.time = self.arm
        self.example, self.poker = example, example.Poker(self.arm, server.host, server.port)
        self.thread = threading.Thread(target=self._run, daemon=True)
        self.thread.start()

    def _run(self):
        try:
            self.poker.run()
        except ConnectionError as error:
            self.ended = error

    def ask(self, number, place=(0.01, 0.02, 0.0), push=DOWN):
        self.server.send([PokeTarget(number, 3, np.array(place), push, force=9.5, hold=0.6)])
        return self

    def until(self, condition):
        end = time.monotonic() + PATIENCE_S
        while not condition():
            assert time.monotonic() < end, (self.arm.place, self.answers)
            self.answers += [item for item in self.server.take() if isinstance(item, (Answer, RobotPace, TipPose))]
            time.sleep(0.005)
        return self

    @property
    def said(self):
        return [write_answer(item) for item in self.answers if isinstance(item, Answer)]

    def until_pressed(self):
        return self.until(lambda: self.arm.place[2] < -0.001)


@pytest.fixture
def bench():
    with closing(TargetServer(*parse_port("0"))) as server:
        bench = Bench(server)
        yield bench
        server.send([NoTarget.ENOUGH])
        bench.thread.join(PATIENCE_S)


def test_it_greets_presses_as_asked_and_lets_go_when_held(bench):
    bench.ask(1).until(lambda: -STIFFNESS * bench.arm.place[2] > 0.94 * 9.5)
    bench.server.send([Held(1)])
    bench.until(lambda: bench.said)
    assert bench.said == ["reached 1"]
    assert bench.answers[0] == RobotPace(0.1, 6.0)
    assert any(isinstance(item, TipPose) for item in bench.answers)
    assert bench.arm.place[2] == pytest.approx(bench.example.STANDOFF, abs=3e-3)
    assert -STIFFNESS * min(bench.arm.course) < 1.1 * 9.5
    assert np.abs(np.diff(bench.arm.course)).max() <= bench.example.TRAVEL * bench.example.PERIOD_S + 1e-9
    bench.ask(2).until(lambda: len(bench.said) == 2)
    assert bench.said[1] == "reached 2", "without held it ends, too"
    bench.server.send([NoTarget.ENOUGH])
    bench.thread.join(PATIENCE_S)
    assert not bench.thread.is_alive()


def test_what_it_cannot_reach_it_skips_with_the_reason(bench):
    bench.arm.reach = lambda place: place[0] < 0.05
    bench.ask(1, (0.06, 0.0, 0.0)).until(lambda: bench.said)
    bench.ask(2).until(lambda: len(bench.said) == 2)
    bench.ask(3, push=-DOWN).until(lambda: len(bench.said) == 3)
    assert bench.said == ["skip 1 out of reach", "reached 2", "skip 3 out of reach"]


@pytest.mark.parametrize("line", [NoTarget.STOP, NoTarget.WAIT])
def test_a_stop_lets_go_and_stays(bench, line):
    bench.ask(1).until_pressed()
    bench.server.send([line])
    bench.until(lambda: bench.arm.place[2] > bench.example.STANDOFF - 1e-9)
    count = len(bench.arm.course)
    time.sleep(0.1)
    assert len(bench.arm.course) == count
    bench.until(lambda: True)
    assert bench.said == []


def test_nothing_moves_towards_the_part_without_a_fresh_force(bench):
    bench.ask(1).until(lambda: 0.0 < bench.arm.place[2] < 0.02)
    bench.arm.force_age_s = 1.0
    count = len(bench.arm.course) + 1
    bench.until(lambda: len(bench.arm.course) > count + 50)
    assert (np.diff(bench.arm.course[count:]) >= 0.0).all()
    bench.arm.force_age_s = 0.0
    bench.until(lambda: bench.said)
    assert bench.said == ["reached 1"]


def test_a_force_above_the_limit_ends_the_poke(bench):
    bench.arm.stiffness = 1e6
    bench.ask(1).until(lambda: bench.said)
    assert bench.said == ["skip 1"]
    assert bench.arm.place[2] == pytest.approx(bench.example.STANDOFF, abs=3e-3)


def test_without_skincal_it_lets_go(bench):
    bench.ask(1).until_pressed()
    bench.server.close()
    bench.thread.join(PATIENCE_S)
    assert isinstance(bench.ended, ConnectionError)
    assert bench.arm.place[2] == pytest.approx(bench.example.STANDOFF, abs=3e-3)
