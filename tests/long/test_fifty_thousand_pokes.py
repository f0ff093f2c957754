"""A robot pokes a whole body for days: memory and cost of a poke, a kill, and the opening after it.

The robot is the program's own client of the target lines, with an arm whose tip meets a spring; its sensors send bytes.

By its name: `python3 -m pytest -s tests/long/test_fifty_thousand_pokes.py`. SKINCAL_POKES=1000 makes it shorter; the kill is
at four fifths of the pokes, and -s shows the figures at each tenth. A poke takes 0.1 to 0.2 s of processor time, all hours.
"""

import json
import os
import signal
import subprocess
import sys
import time
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from skincal.contacts.outcome import Contact
from skincal.following.guided_session import RobotGuide
from skincal.geometry import crossed, length_of
from skincal.journal.documents import DetectorResult, SessionClosed
from skincal.journal.writer import create_session
from skincal.mesh.load import load_surface
from skincal.model.readings import SESSION_START_TIME_NS, Chunk, LinkEvent, LinkState, Stream, Tick
from skincal.model.scene import load_scene, scene_file
from skincal.robot.arm import WrenchReading
from skincal.robot.poking_client import Phase, PokeSettings, PokingClient
from skincal.robot.target_lines import Answer, NoTarget, PokeTarget, RobotLine
from skincal.robot.target_server import RobotChange
from skincal.session.pipeline import Pipeline
from skincal.session.replay import load, resume
from skincal.simulation.board_formats import make_encoder
from skincal.simulation.example_parts import ExamplePart
from skincal.simulation.rig_errors import RigErrors
from skincal.simulation.simulated_rig import PressedPlaces, Rig
from skincal.streams.links import LinkSpec
from skincal.taxels.result import Method
from tests.skincal.robot.plain_arm import PlainArm

CHECKOUT = Path(__file__).resolve().parents[2]
POKES = int(os.environ.get("SKINCAL_POKES", "50000"))
SCENE = "whole-body"
QUICK = PokeSettings(
    clearance=0.02,
    standoff=0.004,
    travel_speed=1.5,
    enter_speed=0.4,
    approach_speed=0.04,
    press_speed=0.03,
    retreat_speed=0.4,
    tare_s=0.1,
    force_gain=8.0,
    across_gain=4.0,
    filter_s=0.01,
    held_wait_s=0.2,
)
"""A quick arm: fifty thousand pokes take 20 hours of its time."""
NEAR_M = 0.02
"""m, from the box around the body, at which a tip may touch it."""
PERIOD_S, PERIODS_PER_FRAME, PERIODS_AT_ONCE = 0.02, 3, 3
"""s, of the robot's control and wrenches; a skin frame every third period, as the guide looks."""
REST_PERIODS = 8
"""Control periods between two pokes without a target of the guide."""
OPENING_MAX_S = 8.0
"""s of processor time to open the session of 40,000 pokes, with its first snapshot."""
GROWTH_MAX_MB = 150.0
"""MB between the first fifth and the last one: pokes, contact table and the journal's index."""
SECONDS_A_POKE = 8.0
"""s of this machine for a poke, at most, until the test gives up."""


class BodyArm(PlainArm):
    """An arm that pokes the simulated body, and the bytes of its two boards."""

    period_s = PERIOD_S

    def __init__(self, rig, surface, seed):
        # Above the body, and farther out than the client travels.
        super().__init__(surface, start=surface.vertices.max(axis=0) + np.array([0.0, 0.0, 0.1]))
        self._rig, self._pose, self._rng = rig, rig.arm_pose(), np.random.default_rng(seed)
        width = rig.scene.skin.channels
        self._boards = {"wrench": make_encoder("skb", 255, 0), "skin": make_encoder("skb", 255, width)}
        self._records = {name: [board.header(0, "", width)] for name, board in self._boards.items()}
        self._periods, self._searched_at, self._last_gap_m = 0, self.position, 0.0
        self._bounds = (surface.vertices.min(axis=0) - NEAR_M).tolist(), (surface.vertices.max(axis=0) + NEAR_M).tolist()

    def link_from_sensor(self):
        return self._pose.reported

    def advance(self):
        self.time_s += self.period_s
        self._periods += 1
        self.move()
        gap, force, near = self.contact() if self.may_touch() else (1.0, np.zeros(3), self.position)
        self.wrench = WrenchReading(self.time_s, force, crossed(near - self._pose.reported[:3, 3], force))
        clock_us = round(self.time_s * 1e6) % 2**32
        wrench = self._rig.true_wrenches(near, force, self._pose) + self._pose.weight + self._rig.offset
        wrench = wrench + self._rng.normal(0.0, [0.02] * 3 + [0.001] * 3)
        self._records["wrench"].append(self._boards["wrench"].record(Stream.WRENCH, clock_us, wrench.tolist()))
        if self._periods % PERIODS_PER_FRAME == 0:
            answers = np.zeros((1, len(self._rig.channels)))
            if gap < 0.0:
                rows, values = self._rig.answers(self._pressed(near, force), np.array([length_of(force)]))
                answers[0, rows[0]] = values[0]
            frame = self._rig.skin_frame(answers, self._rng)[0]
            self._records["skin"].append(self._boards["skin"].record(Stream.SKIN, clock_us, frame.astype(int).tolist()))

    def contact(self):
        found = super().contact()
        self._searched_at, self._last_gap_m = self.position, found[0]
        return found

    def may_touch(self):
        """Whether the tip may touch: it is near the body, and has moved by its last distance from it."""
        low, high = self._bounds
        if length_of(self.position - self._searched_at) < self._last_gap_m:
            return False
        return all(a < x < b for a, x, b in zip(low, self.position.tolist(), high, strict=True))

    def _pressed(self, near, force):
        push = force / length_of(force)
        return PressedPlaces(np.array([-1]), near[None], -push[None], push[None], np.array([1.0]), np.zeros(1))

    def take_bytes(self):
        """Give the records since the last call, by link."""
        found = {name: b"".join(records) for name, records in self._records.items()}
        for records in self._records.values():
            records.clear()
        return found


class Robot:
    """The robot's client with its arm, and the target lines to the guide without a port."""

    def __init__(self, rig, surface, seed):
        self.arm, self._rig = BodyArm(rig, surface, seed), rig
        self._answers: list[RobotLine | RobotChange | str] = [RobotChange.CAME]
        self._client = PokingClient(self.arm, surface, self._answers.append, replace(QUICK, frame=rig.scene.link))
        self._own, self._is_free, self._rested = 1_000_000_000 + seed, False, 0

    def send(self, lines):
        for line in lines:
            self._is_free |= line is NoTarget.ENOUGH
            self._client.receive_line(line)

    def read_answers(self):
        answers, self._answers[:] = list(self._answers), []
        # The guide knows only its own targets.
        return [each for each in answers if not (isinstance(each, Answer) and each.number > 1_000_000_000)]

    def refuse(self, reason):
        raise AssertionError(reason)

    def run(self, periods):
        for _ in range(periods):
            self._rested = self._rested + 1 if self._client.phase is Phase.IDLE else 0
            if self._is_free and self._rested > REST_PERIODS:
                # When the guide has enough, the robot presses one taxel after another. Between them skincal tares.
                self._own += 1
                row = self._own % len(self._rig.channels)
                place, normal = self._rig.places[row], self._rig.normals[row]
                self._client.receive_line(PokeTarget(self._own, None, place, -normal, hold=0.3, frame=self._rig.scene.link))
            self._client.run_period()


def say(**figures):
    sys.stdout.write(json.dumps(figures) + "\n")
    sys.stdout.flush()


def memory_mb():
    """Resident memory of this process."""
    with Path("/proc/self/statm").open() as file:
        return int(file.read().split()[1]) * os.sysconf("SC_PAGE_SIZE") / 1e6


def poke_on(folder, until, step):
    """Begin a session, or go on with it, until it has `until` pokes; print each poke, and figures after each `step`."""
    scene, folder = load_scene(scene_file(Path(SCENE))), Path(folder)
    assert scene.surface is not None
    surface, begun = load_surface(scene.surface)[0], 0
    is_new = not folder.exists()
    if not is_new:
        begun = max(record.outcome.poke for record in load(folder).snapshot().pokes)
    robot = Robot(Rig(scene, surface, RigErrors.noise(), np.random.default_rng(1)), surface, begun)
    links = [LinkSpec(name, f"simulated:{name}", (Stream(name),)) for name in ("wrench", "skin")]
    pipeline = Pipeline(scene, links, surface, create_session(folder, scene, links)) if is_new else resume(folder, links)
    # Each segment has its own beginning on the host's clock; a poke takes less than twenty seconds.
    start_ns = SESSION_START_TIME_NS + begun * 20_000_000_000
    guide = RobotGuide(pipeline, robot, Method.MODULES)
    for link in links:
        pipeline.feed(LinkEvent(link.name, start_ns, LinkState.OPEN))
    last, spent_s, since = begun, 0.0, begun
    while last < until:
        robot.run(PERIODS_AT_ONCE)
        now_ns = start_ns + round(robot.arm.time_s * 1e9)
        items: list[Chunk | LinkEvent | Tick] = [Chunk(name, now_ns, data) for name, data in robot.arm.take_bytes().items()]
        items.append(Tick(now_ns))
        before = time.process_time()
        pipeline.feed_many(items)
        guide.guide_robot(now_ns)
        spent_s += time.process_time() - before
        if pipeline.session.last_poke == last:
            continue
        last = pipeline.session.last_poke
        say(poke=last)
        if last // step > since // step:
            accepted = sum(isinstance(record.outcome, Contact) for record in pipeline.snapshot().pokes)
            cost_ms = 1e3 * spent_s / (last - since)
            say(pokes=last, accepted=accepted, memory_mb=round(memory_mb()), cost_of_a_poke_ms=round(cost_ms, 1))
            since, spent_s = last, 0.0
    pipeline.close()


def run_poker(folder, until, step, kill_at=None):
    """Let another process poke; return its figures and the last poke that it named. It is killed after `kill_at` pokes."""
    code = f"from tests.long.test_fifty_thousand_pokes import poke_on; poke_on({str(folder)!r}, {until}, {step})"
    figures, last = [], 0
    with subprocess.Popen([sys.executable, "-c", code], stdout=subprocess.PIPE, text=True, cwd=CHECKOUT) as process:
        assert process.stdout is not None
        for text in process.stdout:
            found = json.loads(text)
            if "poke" in found:
                last = found["poke"]
                if kill_at is not None and last >= kill_at:
                    process.kill()
                    break
            else:
                sys.stdout.write(text)
                sys.stdout.flush()
                figures.append(found)
    assert process.returncode in (0, -signal.SIGKILL)
    return figures, last


@pytest.mark.timeout(POKES * SECONDS_A_POKE + 300)
@pytest.mark.skipif(not sys.platform.startswith("linux"), reason="memory is read as Linux says it, and processes are killed")
def test_a_whole_body_is_poked_killed_opened_and_poked_on(tmp_path):
    folder, step, kill_at = tmp_path / "s", POKES // 10, POKES * 4 // 5 + 3
    figures, named = run_poker(folder, POKES, step, kill_at)
    begin = time.process_time()
    pipeline = load(folder)
    kept = [record.outcome.poke for record in pipeline.snapshot().pokes]
    opening_s = time.process_time() - begin
    say(killed_at=named, kept=len(kept), opening_s=round(opening_s, 2))
    # The poke that was named is in the journal: only the one in progress may be lost.
    assert kept == list(range(1, len(kept) + 1))
    assert len(kept) >= named
    assert opening_s <= OPENING_MAX_S
    more, last = run_poker(folder, POKES, step)
    assert last >= POKES
    every = [*figures, *more]
    assert every[-1]["accepted"] > 0.8 * POKES
    assert every[-1]["memory_mb"] - every[0]["memory_mb"] < GROWTH_MAX_MB


def write_pokes(folder, scene, contacts):
    """Write a session as its recording leaves it, but for the readings: both outcomes of each poke, and an end."""
    links = [LinkSpec(name, f"simulated:{name}", (Stream(name),)) for name in ("wrench", "skin")]
    journal, at_ns = create_session(folder, scene, links), SESSION_START_TIME_NS
    for contact in contacts:
        at_ns = SESSION_START_TIME_NS + round(2e9 * contact.poke)
        first = replace(contact, tare_change=float("nan"), final=False)
        journal.write(Chunk("skin", at_ns, b"x" * 400), [DetectorResult([first])])
        journal.write(Chunk("skin", at_ns + 10**9, b"x" * 400), [DetectorResult([contact])])
    journal.write(SessionClosed(at_ns + 2 * 10**9))
    journal.close()


@pytest.mark.timeout(600)
def test_a_written_session_of_forty_thousand_pokes_opens_in_8_s(tmp_path):
    part, count = ExamplePart(SCENE), 40_000
    every = part.contacts(-(-count // len(part.channels)), seed=3)
    order = np.random.default_rng(0).permutation(len(every))[:count].tolist()
    write_pokes(tmp_path / "s", part.scene, [replace(every[at], poke=number) for number, at in enumerate(order, start=1)])
    begin = time.process_time()
    pipeline = load(tmp_path / "s")
    loaded_s = time.process_time() - begin
    snapshot = pipeline.snapshot()
    opening_s = time.process_time() - begin
    say(pokes=len(snapshot.pokes), loaded_s=round(loaded_s, 2), opening_s=round(opening_s, 2), memory_mb=round(memory_mb()))
    assert len(snapshot.pokes) == count
    assert opening_s <= OPENING_MAX_S
