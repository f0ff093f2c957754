"""The template for a real robot, against the real target server: one poke, and what ends one early."""

import importlib.util
import threading
import time
from contextlib import closing

import numpy as np
import pytest

from skincal.mesh.load import load_surface
from skincal.model.scene import load_scene, resource
from skincal.physics.effects import Effects
from skincal.physics.layouts import make_robot
from skincal.physics.session import RobotSession
from skincal.robot.target_lines import (
    Answer,
    Held,
    Judged,
    NoTarget,
    PokeTarget,
    RobotPace,
    TipPose,
    read_answer_line,
    write_answer,
    write_line,
)
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

    frame = "flat part"

    def __init__(self):
        self.now_s, self.place, self.force_age_s, self.stiffness = 0.0, (0.0, 0.0, 0.2), 0.0, STIFFNESS
        self.course, self.reach, self.load = [], lambda _place: True, lambda _place: 0.0

    def monotonic(self):
        return self.now_s

    def sleep(self, seconds):
        self.now_s += seconds
        time.sleep(seconds / 4.0)

    def read(self):
        force = 3.0 + self.stiffness * max(0.0, -self.place[2]) + self.load(self.place)
        return self.place, force, self.force_age_s

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

    def ask(self, number, place=(0.01, 0.02, 0.0), push=DOWN, frame="flat part"):
        self.server.send([PokeTarget(number, 3, np.array(place), push, frame=frame, force=9.5, hold=0.6)])
        return self

    def until(self, condition):
        end = time.monotonic() + PATIENCE_S
        while not condition():
            assert time.monotonic() < end, (self.arm.place, self.answers)
            self.answers += [item for item in self.server.read_answers() if isinstance(item, (Answer, RobotPace, TipPose))]
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


def test_a_target_in_another_frame_is_a_fault_without_a_motion(bench):
    bench.ask(1, frame="r_hand").until(lambda: bench.said)
    assert bench.said == ["fault 1 the target is in the frame r_hand, the robot works in flat part"]
    assert not bench.arm.course
    bench.ask(2).until(lambda: len(bench.said) == 2)
    assert bench.said[1] == "reached 2"


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


def test_a_pressing_tip_lets_go_once_the_force_is_old(bench):
    bench.ask(1).until_pressed()
    bench.arm.force_age_s = 1.0
    bench.until(lambda: bench.said)
    assert bench.said == ["fault 1 no fresh force reading"]
    assert bench.arm.place[2] == pytest.approx(bench.example.STANDOFF, abs=3e-3)


def test_without_any_force_the_arm_stays_where_it_is(bench):
    bench.arm.force_age_s = 1.0
    bench.ask(1).until(lambda: bench.said)
    assert bench.said == ["fault 1 no fresh force reading"]
    assert set(bench.arm.course) == {0.2}


@pytest.mark.parametrize("load", [30.0, -30.0])
def test_what_is_met_on_the_way_stops_it(bench, load):
    bench.arm.load = lambda place: load if place[2] < 0.1 else 0.0
    bench.ask(1).until(lambda: bench.said)
    assert bench.said == ["fault 1 something was met on the way"]
    assert bench.arm.place[2] > 0.095


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
    assert bench.poker.side == tuple(DOWN), "after the next connection it first goes back"
    assert bench.arm.place[2] == pytest.approx(bench.example.STANDOFF, abs=3e-3)


class PhysicsArm:
    """The simulated robot behind the three functions of the template, and the clock of its simulated time."""

    def __init__(self, robot):
        self.robot, self.monotonic, self.frame = robot, lambda: robot.time_s, robot.scene.link

    def sleep(self, seconds):
        for _ in range(round(seconds / self.robot.period_s)):
            self.robot.advance()

    def read(self):
        tip, wrench = self.robot.read_tip(), self.robot.read_wrench()
        end = tip.position + self.robot.tip_radius_m * tip.direction
        return tuple(end), float(wrench.force @ tip.direction), self.robot.time_s - wrench.time_s

    def move_tip(self, place, push):
        self.robot.command(np.array(place) - self.robot.tip_radius_m * np.array(push), np.array(push), 0.5)

    def can_reach(self, place, push):
        return self.robot.is_reachable(np.array(place), np.array(push))


class QueueSocket:
    """The lines of a guided session in simulated time, as a socket; it ends after so many verdicts."""

    def __init__(self, targets, enough):
        self.targets, self.enough, self.verdicts = targets, enough, []

    def setblocking(self, _flag):
        pass

    def sendall(self, data):
        for line in data.decode().splitlines():
            self.targets.answer(read_answer_line(line))

    def recv(self, _size):
        line = NoTarget.ENOUGH if len(self.verdicts) == self.enough else self.targets.poll()
        if line is None:
            raise BlockingIOError
        self.verdicts += [line.reason] if isinstance(line, Judged) else []
        return f"{write_line(line)}\n".encode()

    def __enter__(self):
        return self

    def __exit__(self, *_args):
        pass


def test_it_pokes_a_part_in_the_physics_engine_and_its_pokes_count(monkeypatch):
    pytest.importorskip("mujoco")
    scene = load_scene(resource("scenes/icub-forearm/scene.toml"))
    surface = load_surface(scene.surface)[0]
    robot = make_robot(scene, surface, Effects(base=0.0), 1)
    session = RobotSession(scene, surface, robot)
    lines = QueueSocket(session.targets, enough=6)
    example, arm = load_example(), PhysicsArm(robot)
    monkeypatch.setattr(example, "time", arm)
    monkeypatch.setattr(example.socket, "create_connection", lambda *_args: lines)
    example.Poker(arm, "127.0.0.1", 7010).run()
    assert sum(not reason for reason in lines.verdicts) >= 5, lines.verdicts
    assert len(session.pipeline.snapshot().pokes) >= 6
