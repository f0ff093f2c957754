"""The template for a real robot: what only it does, and pokes that count in the physics engine.

`test_both_clients.py` has what every client must do.
"""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from skincal.mesh.load import load_surface
from skincal.model.scene import load_scene, resource
from skincal.physics.effects import Effects
from skincal.physics.robots import make_robot
from skincal.physics.session import RobotSession
from skincal.robot.target_lines import (
    AnswerKind,
    Judged,
    NoTarget,
    PartPlace,
    RobotPace,
    TipPose,
    read_answer_line,
    write_line,
)
from tests.skincal.robot.client_benches import DOWN, PATIENCE_S, FlatPart, load_example, template


@pytest.fixture
def client():
    with template() as example:
        yield example


def test_it_greets_reports_its_tip_and_keeps_its_speed(client):
    client.ask(1).until_answers()
    assert client.answers[0] == RobotPace(0.1, 6.0)
    assert any(isinstance(item, TipPose) for item in client.answers)
    assert np.abs(np.diff(client.heights())).max() <= client.example.TRAVEL * client.example.PERIOD_S + 1e-9
    client.say(NoTarget.ENOUGH)
    client.thread.join(PATIENCE_S)
    assert not client.thread.is_alive()


def test_the_other_side_of_the_part_and_another_frame_are_refused_with_the_reason(client):
    client.ask(1).until_answers().ask(2, push=-DOWN).until_answers(2)
    assert (client.said()[1], client.text()) == ((AnswerKind.SKIP, 2), "out of reach")
    client.ask(3, frame="r_hand").until_answers(3)
    assert client.text() == "the target is in the frame r_hand, the robot works in flat part"


def test_without_any_force_the_arm_stays_where_it_is(client):
    client.silence()
    client.ask(1).until_answers()
    assert (client.said(), client.text()) == ([(AnswerKind.FAULT, 1)], "no fresh force reading")
    assert set(client.arm.course) == {0.2}


@pytest.mark.parametrize("load", [30.0, -30.0])
def test_an_obstacle_in_either_direction_stops_it(client, load):
    client.arm.load = lambda place: load if place[2] < 0.1 else 0.0
    client.ask(1).until_answers()
    assert (client.said(), client.text()) == ([(AnswerKind.FAULT, 1)], "something was met on the way")
    assert client.arm.place[2] > 0.095


def test_a_force_above_the_limit_ends_the_poke(client):
    client.arm.stiffness = 1e6
    client.ask(1).until_answers()
    assert (client.said(), client.text()) == ([(AnswerKind.SKIP, 1)], "")
    assert client.arm.place[2] == pytest.approx(client.standoff_m, abs=3e-3)


def test_after_a_lost_connection_it_first_goes_back(client):
    client.ask(1).until_pressed().lose_skincal()
    assert isinstance(client.ended, ConnectionError)
    assert client.poker.side == tuple(DOWN)


class ArmInBase(FlatPart):
    """The same arm, whose functions are in its base; nobody has measured the part."""

    part = None
    BASE_FROM_PART = np.eye(4)
    BASE_FROM_PART[:3, :3] = Rotation.from_euler("xyz", [20, -35, 70], degrees=True).as_matrix()
    BASE_FROM_PART[:3, 3] = 0.4, -0.3, 0.1

    def read(self):
        place, force, age = super().read()
        return tuple(self.BASE_FROM_PART[:3] @ np.append(place, 1.0)), force, age

    def move_tip(self, place, push):
        np.testing.assert_allclose(push, self.BASE_FROM_PART[:3, :3] @ DOWN, atol=1e-6)
        super().move_tip(tuple(self._in_part(place)), push)

    def can_reach(self, place, push):
        return super().can_reach(tuple(self._in_part(place)), push)

    def _in_part(self, place):
        return self.BASE_FROM_PART[:3, :3].T @ (np.array(place) - self.BASE_FROM_PART[:3, 3])


def test_a_part_that_nobody_measured_is_poked_once_skincal_sends_its_pose():
    with template(ArmInBase()) as client:
        client.ask(1).rest(1.0)
        assert client.arm.course == [], "it waits"
        client.say(PartPlace("another part", np.eye(4))).rest(0.5)
        assert client.arm.course == []
        off = client.arm.BASE_FROM_PART.copy()
        off[:3, 3] += 0.003 * off[:3, 0]
        client.say(PartPlace("flat part", off)).until_answers()
        assert client.said() == [(AnswerKind.REACHED, 1)]
        tips = np.array([item.place for item in client.answers if isinstance(item, TipPose)])
        assert np.abs(tips[:, :2] - [0.01, 0.02]).max() < 0.15, "in the frame of the targets"
        assert client.arm.place[:2] == pytest.approx((0.013, 0.02), abs=1e-6), "3 mm off, as that pose"
        client.say(PartPlace("flat part", client.arm.BASE_FROM_PART)).ask(2).until_answers(2)
        assert client.said()[1] == (AnswerKind.REACHED, 2)
        assert client.arm.place[:2] == pytest.approx((0.01, 0.02), abs=1e-6), "the newest pose is used"


class PhysicsArm:
    """The simulated robot behind the three functions of the template, and the clock of its simulated time."""

    def __init__(self, robot):
        self.robot, self.monotonic, self.frame = robot, lambda: robot.time_s, robot.scene.link
        self.part = 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0

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
    lines = QueueSocket(session.targets, enough=3)
    example, arm = load_example(), PhysicsArm(robot)
    monkeypatch.setattr(example, "time", arm)
    monkeypatch.setattr(example.socket, "create_connection", lambda *_args: lines)
    example.Poker(arm, "127.0.0.1", 7010).run()
    assert sum(not reason for reason in lines.verdicts) >= 2, lines.verdicts
    assert len(session.pipeline.snapshot().pokes) >= 3
