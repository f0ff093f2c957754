"""A whole body is poked for days: memory and cost of a poke, a kill, and the opening after it.

By its name: `python3 -m pytest -s tests/long/test_fifty_thousand_pokes.py`. SKINCAL_POKES=1000 makes it shorter; the kill is
at four fifths of the pokes, and -s shows the figures at each fifth. A poke takes 0.4 s of processor time: all take hours.
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
from skincal.journal.documents import DetectorResult, SessionClosed
from skincal.journal.writer import create_session
from skincal.mesh.load import load_surface
from skincal.model.readings import SESSION_START_TIME_NS, Chunk, LinkEvent, LinkState, Stream, Tick
from skincal.model.scene import load_scene, scene_file
from skincal.robot.target_lines import NoTarget
from skincal.session.pipeline import Pipeline
from skincal.session.replay import load, resume
from skincal.simulation.device import DeviceSettings, DeviceTimeline
from skincal.simulation.example_parts import ExamplePart
from skincal.simulation.operator import GuidedOperator, Habits
from skincal.simulation.rig_errors import RigErrors
from skincal.simulation.simulated_rig import Rig
from skincal.streams.links import LinkSpec
from skincal.taxels.result import Method

CHECKOUT = Path(__file__).resolve().parents[2]
POKES = int(os.environ.get("SKINCAL_POKES", "50000"))
SCENE = "whole-body"
DEVICES = DeviceSettings(block_s=0.02, wrench_hz=200.0, skin_hz=50.0, joints_hz=50.0)
PACE = 4.0
"""Of the hand, over that of a person."""
BLOCKS_AT_ONCE = 2
"""Blocks of readings between two looks of the guide."""
OPENING_MAX_S = 8.0
"""s of processor time to open the session of 40,000 pokes, with its first snapshot."""
GROWTH_MAX_MB = 150.0
"""MB between the first fifth and the last one: pokes, contact table and the journal's index."""
SECONDS_A_POKE = 8.0
"""s of this machine for a poke, at most, until the test gives up."""


class DirectTargets:
    """Target lines between the guide and a simulated hand, without a port."""

    def __init__(self, hand):
        self._hand, self._answers = hand, []
        hand.answered = self._answers.append

    def send(self, lines):
        for line in lines:
            # When the guide has enough, the hand presses where it likes.
            self._hand.show(NoTarget.ANY if line is NoTarget.ENOUGH else line)

    def read_answers(self):
        answers, self._answers[:] = list(self._answers), []
        return answers

    def refuse(self, reason):
        raise AssertionError(reason)


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
    surface, begun = load_surface(scene.surface)[0], 0
    is_new = not folder.exists()
    rig = Rig(scene, surface, RigErrors.noise(), np.random.default_rng(1))
    if not is_new:
        begun = max(record.outcome.poke for record in load(folder).snapshot().pokes)
    hand = GuidedOperator(rig, replace(Habits.careful().at_pace(PACE), ignores=0.0), np.random.default_rng([2, begun]))
    line = DeviceTimeline(rig, hand, np.random.default_rng([3, begun]), DEVICES)
    links = [LinkSpec(name, f"simulated:{name}", (stream,)) for name, stream in line.links.items()]
    pipeline = Pipeline(scene, links, surface, create_session(folder, scene, links)) if is_new else resume(folder, links)
    # Each segment has its own beginning on the host's clock; a poke takes less than ten seconds.
    start_ns = SESSION_START_TIME_NS + begun * 10_000_000_000
    guide = RobotGuide(pipeline, DirectTargets(hand), Method.MODULES)
    for link in links:
        pipeline.feed(LinkEvent(link.name, start_ns, LinkState.OPEN))
    last, spent_s, since = begun, 0.0, begun
    while last < until:
        items = []
        for end_s, arrived in line.advance_many(BLOCKS_AT_ONCE):
            items += [Chunk(link, start_ns + at_ns, data) for at_ns, link, data in arrived]
            items.append(Tick(start_ns + round(end_s * 1e9)))
        before = time.process_time()
        pipeline.feed_many(items)
        guide.guide_robot(items[-1].host_ns)
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
    folder, step, kill_at = tmp_path / "s", POKES // 5, POKES * 4 // 5 + 3
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
