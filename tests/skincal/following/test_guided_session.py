"""Whole guided sessions over the lines: a robot under the example's client pokes to *enough*; commands play both sides."""

import importlib.util
import json
import subprocess
import sys
import time
from contextlib import closing
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from skincal.contacts.outcome import Contact
from skincal.following.guided_session import RobotGuide
from skincal.model.readings import Chunk, LinkEvent, LinkState
from skincal.model.scene import resource
from skincal.robot.target_lines import Answer, AnswerKind, NoTarget, PokeTarget, write_answer
from skincal.robot.target_server import TargetServer, open_port, parse_port
from skincal.session.pipeline import Pipeline
from skincal.simulation.device import DeviceTimeline
from skincal.simulation.operator import GuidedOperator, Habits
from skincal.simulation.poking_strategies import errors_of
from skincal.simulation.rig_errors import RigErrors
from skincal.streams.links import LinkSpec
from skincal.taxels.result import Method
from tests.approved import approved
from tests.skincal.sim_support import SLOW_DEVICES, make_rig

BLOCKS_AT_ONCE = 5
"""The robot and the guide look ten times a second."""
DEMO_PACE, DEMO_S = 2.0, 170.0
"""The pace of a demo, and the time that is promised for it, three minutes, less what a window takes to open."""


@pytest.fixture(scope="module")
def example():
    """The example node, whose protocol half needs no ROS."""
    spec = importlib.util.spec_from_file_location("ros2_poker", resource("examples/ros2_poker.py"))
    module = importlib.util.module_from_spec(spec)
    sys.modules["ros2_poker"] = module
    spec.loader.exec_module(module)
    yield module
    del sys.modules["ros2_poker"]


class SimulatedRobot:
    """A simulated hand that learns where to poke from the example's connection alone."""

    def __init__(self, rig, example, port):
        self._example, self.lines, self.verdicts, self.enough = example, example.Lines("127.0.0.1", port), [], False
        self.hand = GuidedOperator(rig, Habits().at_pace(DEMO_PACE), np.random.default_rng(3))
        self.hand.show(NoTarget.WAIT)
        self.asked: dict[int, int | None] = {}
        self.hand.answered = lambda answer: self.lines.say(write_answer(answer))

    def step(self):
        for line in self.lines.read():
            word = line.split()[0]
            if word == "target":
                asked = self._example.read_target(line)
                place, push = np.array(asked.place), np.array(asked.push)
                self.hand.show(PokeTarget(asked.number, asked.channel, place, push, asked.known_point))
                self.asked[asked.number] = asked.channel
            elif word in ("wait", "enough"):
                self.enough = word == "enough"
                self.hand.show(NoTarget(word))
            elif word in ("accepted", "rejected"):
                self.verdicts.append(line)


def play(rig, robot, server, method):
    """Play a rig's devices in virtual time, the robot and the guide beside them, to enough; the pipeline."""
    line = DeviceTimeline(rig, robot.hand, np.random.default_rng(4), SLOW_DEVICES)
    links = [LinkSpec(name, f"simulated:{name}", (stream,)) for name, stream in line.links.items()]
    pipeline = Pipeline(rig.scene, links, rig.surface)
    guide = RobotGuide(pipeline, server, method)
    for link in links:
        pipeline.feed(LinkEvent(link.name, 0, LinkState.OPEN))
    begun_s = line.now
    while not (guide.enough and robot.enough):
        assert line.now - begun_s < DEMO_S, robot.verdicts[-5:]
        blocks = line.advance_many(BLOCKS_AT_ONCE)
        pipeline.feed_many([Chunk(link, at_ns, data) for _, arrived in blocks for at_ns, link, data in arrived])
        assert guide.guide_robot(round(line.now * 1e9)) in ([], [f"A robot connected from {server.host}."])
        robot.step()
    return pipeline


class Resting:
    """A rig that nobody pokes, recorded while a robot is asked; what is said to the robot, and its answers, without a port."""

    def __init__(self):
        rig = make_rig(RigErrors.noise(), name="flat-patch")
        hand = GuidedOperator(rig, Habits.careful(), np.random.default_rng(3))
        hand.show(NoTarget.WAIT)
        self.line = DeviceTimeline(rig, hand, np.random.default_rng(4))
        self.links = [LinkSpec(name, f"simulated:{name}", (stream,)) for name, stream in self.line.links.items()]
        self.pipeline = Pipeline(rig.scene, self.links, rig.surface)
        self.said, self.answers = [], []
        server = SimpleNamespace(send=self.said.extend, read_answers=lambda: [self.answers.pop()] if self.answers else [])
        self.guide = RobotGuide(self.pipeline, server, Method.MODULES)

    def hear(self, state=LinkState.OPEN):
        for link in self.links:
            self.pipeline.feed(LinkEvent(link.name, self.now_ns, state))

    def run(self, seconds):
        """The rig's devices send for so long; what was said last."""
        end = self.line.now + seconds
        while self.line.now < end:
            for at_ns, link, data in self.line.advance():
                self.pipeline.feed(Chunk(link, at_ns, data))
            self.guide.guide_robot(self.now_ns)
        return self.said[-1]

    @property
    def now_ns(self):
        return round(self.line.now * 1e9)


def test_nobody_is_asked_to_press_while_nothing_measures():
    rig = Resting()
    rig.hear(LinkState.LOST)
    rig.guide.guide_robot(rig.now_ns)
    assert rig.said == [NoTarget.WAIT], "no device was ever there"
    rig.hear()
    assert isinstance(rig.run(1.0), PokeTarget)
    rig.pipeline.feed(LinkEvent(rig.links[0].name, rig.now_ns, LinkState.LOST))
    rig.guide.guide_robot(rig.now_ns + 30_000_000)
    assert rig.said[-1] is NoTarget.WAIT
    rig.hear()
    assert isinstance(rig.run(1.0), PokeTarget), "again"
    rig.guide.guide_robot(rig.now_ns + 2_100_000_000)
    assert rig.said[-1] is NoTarget.WAIT, "silent"


def test_a_robot_that_skips_is_asked_for_another_poke():
    rig = Resting()
    rig.hear()
    first = rig.run(1.0)
    rig.answers.append(Answer(AnswerKind.SKIP, first.number))
    second = rig.run(0.2)
    assert second.number == first.number + 1
    assert second.channel != first.channel
    assert len(rig.pipeline.snapshot().decisions.skips) == 1, "in the session, as from the window"


def is_counted(outcome, snapshot):
    return isinstance(outcome, Contact) or outcome.poke in snapshot.at_landmarks


@pytest.mark.timeout(900)
def test_a_robot_pokes_the_shipped_demo_to_enough_over_the_lines(example):
    rig = make_rig(RigErrors.noise())
    with closing(TargetServer(open_port(*parse_port("0")))) as server:
        robot = SimulatedRobot(rig, example, server.port)
        with closing(robot.lines):
            pipeline = play(rig, robot, server, Method.MODULES)
    snapshot = pipeline.snapshot()
    assert snapshot.decisions.closings, "some of the first places were poked once more"
    accepted = [verdict for verdict in robot.verdicts if verdict.startswith("accepted ")]
    numbers = [int(verdict.split()[1]) for verdict in robot.verdicts]
    assert numbers == sorted(set(numbers)), "each number has one verdict"
    counted = [each.outcome for each in snapshot.pokes if each.outcome.final and is_counted(each.outcome, snapshot)]
    assert len(accepted) == len(counted), "a verdict for each poke that counts, and for no other"
    assert len(robot.verdicts) == len(snapshot.pokes)
    asked = [robot.asked[int(verdict.split()[1])] for verdict in accepted]
    hits = [at in each.channels for each, at in zip(counted, asked, strict=True) if at is not None]
    assert np.mean(hits) >= 0.8, "the taxel that was asked for answers nearly always; by chance three of 84 do"
    assert errors_of(snapshot.estimates[Method.MODULES], rig).mean() < 0.0035


def test_the_example_approaches_presses_as_wished_holds_lets_go_and_goes_back(example):
    with closing(TargetServer(open_port(*parse_port("0")))) as server:
        lines = example.Lines("127.0.0.1", server.port)
        with closing(lines):
            poker, push = example.Poker(lines), np.array([0.0, 0.6, -0.8])
            asked = PokeTarget(3, 7, np.array([0.1, 0.2, 0.3]), push, False, "r_forearm", "94 deg, 0 deg", 8.0, 0.6)
            server.send([asked])
            end = time.monotonic() + 10.0
            while poker.step(0.0) is None:
                assert time.monotonic() < end
            course = [poker.step(now_s) for now_s in np.arange(0.0, 4.0, 0.02)]
            points = [point for point in course if point is not None]
            places, forces = np.array([point.place for point in points]), np.array([point.force for point in points])
            before = (asked.place - places) @ push
            assert {point.frame for point in points} == {"r_forearm"}
            np.testing.assert_allclose(places, asked.place - before[:, None] * push, atol=1e-12)
            assert before[0] == pytest.approx(example.STANDOFF)
            assert before[-1] == pytest.approx(example.STANDOFF)
            assert np.abs(np.diff(before)).max() <= example.SPEED * 0.02 + 1e-9
            assert (forces[before > 1e-9] == 0.0).all(), "no force but on the skin"
            assert forces.max() == 8.0
            assert (forces == 8.0).sum() * 0.02 == pytest.approx(0.6, abs=0.05)
            x, y, z, w = points[0].quaternion()
            turned = np.array([2 * (x * z + w * y), 2 * (y * z - w * x), 1 - 2 * (x * x + y * y)])
            np.testing.assert_allclose(turned, push, atol=1e-12)
            said = []
            # In one call or in several.
            while len(said) < 2:
                said += [item for item in server.read_answers() if not isinstance(item, str)]
                assert time.monotonic() < end
            assert (said[1].kind.value, said[1].number) == ("reached", 3)


@pytest.mark.parametrize("end", ["wait", "stop", "another", "lost"])
def test_the_example_lets_go_at_once_and_goes_back(example, end):
    with (
        closing(TargetServer(open_port(*parse_port("0")))) as server,
        closing(example.Lines("127.0.0.1", server.port)) as lines,
    ):
        poker, now_s, late_s = example.Poker(lines), 0.0, time.monotonic() + 60.0
        asked = PokeTarget(1, 7, np.array([0.1, 0.2, 0.3]), np.array([0.0, 0.0, -1.0]), force=8.0, hold=60.0)

        def step_until(condition, period_s=0.02):
            nonlocal now_s
            while not condition(point := poker.step(now_s)):
                assert time.monotonic() < late_s
                now_s += period_s * (point is not None)
            return point

        server.send([asked])
        step_until(lambda point: point is not None and point.force == 8.0)
        lines_to_send = {"wait": [NoTarget.WAIT], "stop": [NoTarget.STOP], "another": [replace(asked, number=2)]}
        server.send(lines_to_send[end]) if end != "lost" else server.close()
        # The time stands until the line has arrived.
        released = step_until(lambda point: point is None or point.force == 0.0, 0.0)
        assert released.place[2] == pytest.approx(0.3, abs=0.002)
        away = step_until(lambda point: point is None or point.place[2] >= 0.3 + example.STANDOFF - 1e-9)
        assert away.force == 0.0
        assert poker.lost is (end == "lost")
        follows = poker.step(now_s + 0.02)
        assert (follows is not None) is (end == "another"), "the next target begins before the skin"
        assert not any(isinstance(item, Answer) for item in server.read_answers())


def test_the_commands_play_both_sides(tmp_path):
    """`record --targets` asks, `simulate --targets` pokes: two processes, whatever starts first."""
    with closing(TargetServer(open_port(*parse_port("0")))) as free:
        port = str(free.port)
    command = [sys.executable, "-P", "-m", "skincal.cli"]
    options = ["--serve", "--tcp", "--operator", "guided", "--careful", "--pace", "4", "--targets", port]
    simulating = subprocess.Popen(
        [*command, "simulate", "--scene", "flat-patch", *options], stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True
    )
    with simulating:
        wrench, skin = (link["address"] for link in json.loads(simulating.stdout.readline())["links"])
        out = tmp_path / "session"
        asked = ["--wrench", wrench, "--skin", skin, "--scene", "flat-patch", "--out", str(out)]
        recorded = subprocess.run(
            [*command, "record", *asked, "--targets", port, "--method", "modules", "--pokes", "4", "--json"],
            capture_output=True, text=True, timeout=90, check=False,
        )  # fmt: skip
        simulating.stdin.close()
    assert recorded.returncode == 0, recorded.stderr
    assert json.loads(recorded.stdout)["pokes"] >= 4
    assert f"a robot is asked at 127.0.0.1:{port}" in recorded.stderr
    assert "A robot connected from 127.0.0.1." in recorded.stderr


def test_guided_and_targets_need_each_other(tmp_path, capsys):
    from skincal.cli import main

    for options in (["--operator", "guided"], ["--targets", "7010"]):
        assert main(["simulate", "--scene", "flat-patch", "--serve", *options]) == 2
        assert approved("operator.each_other") in capsys.readouterr().err
    record = ["record", "--wrench", "x", "--skin", "y", "--scene", "flat-patch", "--out", str(tmp_path / "s")]
    assert main([*record, "--method", "free"]) == 2
    assert main([*record, "--targets", "no port"]) == 2
    assert main([*record, "--targets", "0", "--method", "surface"]) == 2
    assert "the scene has no surface method" in capsys.readouterr().err
    assert not (tmp_path / "s").exists()
