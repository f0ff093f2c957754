"""A whole guided session over each pair of protocols: real transports, the guide's targets, a hand that pokes them, estimates.

Not in real time: the rig stands while bytes travel. The skin is one board of four taxels, and the hand is a good tool in a good
rig, as the scene says, so that a dozen pokes are enough.
"""

from contextlib import closing
from dataclasses import replace

import numpy as np
import pytest

from skincal.contacts.outcome import Contact
from skincal.following.robot_dialogue import RobotDialogue
from skincal.following.session_guide import SessionGuide
from skincal.guide.guidance import GuidePhase
from skincal.model.readings import LinkState, Loss
from skincal.model.scene import resource
from skincal.part.part import load_part
from skincal.robot.target_client import read_line
from skincal.robot.target_lines import write_line
from skincal.session.pipeline import Pipeline
from skincal.simulation.device import DeviceSettings, DeviceTimeline
from skincal.simulation.operator import GuidedOperator, Habits
from skincal.simulation.rig_errors import RigErrors
from skincal.simulation.simulated_rig import Rig
from skincal.studies.error_numbers import inside_95_ellipsoid
from skincal.taxels.result import Method
from tests.skincal.simulation.orchestra_support import (
    FINGERS,
    NARROW_SKINS,
    SKINS,
    WRENCHES,
    Brought,
    Orchestra,
    pairs_of_each,
    reading,
)

MOST = 40
"""Pokes. A protocol that spoils them makes the guide ask for more."""
MOST_S = 120.0
"""s of the rig's own time. Where nothing is asked for any more the hand would wait for ever, and the rig with it."""
BOARD = """
[kinds.square]
pads_mm = [[-3.0, -3.0], [3.0, -3.0], [-3.0, 3.0], [3.0, 3.0]]
outline_mm = [[-6.0, -6.0], [6.0, -6.0], [6.0, 6.0], [-6.0, 6.0]]
centre_pad = 0

[[modules]]
id = 1
kind = "square"
first_channel = 0
place_mm = [0.0, 0.0]
"""
NOISE = "contact = 0.001\nreach = 0.002\nskin = 0.0005\nforce = 0.03\nmoment = 0.001\n"


PAIRS_OF_SMALL_SKINS = [("leptrino", "paxini"), ("justfloat", "tsf85"), ("netft", "paxini-module")]


@pytest.fixture(scope="module")
def parts(tmp_path_factory):
    """The part for skins of 12 bits, and the same for skins of 8 bits, without a threshold of its own."""
    found = {}
    for name in ("wide", "narrow"):
        folder = tmp_path_factory.mktemp(name)
        text = (resource("scenes/flat-patch") / "scene.toml").read_text(encoding="utf-8")
        text = text.replace("channels = 64", "channels = 4") + NOISE
        if name == "narrow":
            text = text.replace("4095", "255").replace("response_min", "# response_min")
        (folder / "scene.toml").write_text(text, encoding="utf-8")
        (folder / "modules.toml").write_text(BOARD, encoding="utf-8")
        found[name] = load_part(folder / "scene.toml")
    return found


def guided_to_the_end(part, wrench, skin):
    """The pipeline and the rig at the end of a session, and the guide's last word."""
    rig = Rig(part.scene, part.surface, RigErrors.none(), np.random.default_rng(3))
    hand = replace(Habits.careful().at_pace(4.0), ignores=0.0, aim=0.001)
    operator = GuidedOperator(rig, hand, np.random.default_rng([3, 1]), MOST)
    line = DeviceTimeline(rig, operator, np.random.default_rng([3, 2]), DeviceSettings(block_s=0.02))
    orchestra, brought, guidance, known, taken = Orchestra(line, (wrench,), (skin,)), Brought(), None, None, 0
    links, robot = tuple(orchestra.links.values()), RobotDialogue(part.scene)
    operator.answered = lambda answer: robot.handle_answer(answer, line.now)
    pipeline, guide = Pipeline(part.scene, links, part.surface), SessionGuide(part)
    with closing(orchestra), reading(links, brought):
        begun_s = line.now
        while not line.finished:
            assert line.now - begun_s < MOST_S, (guidance, pipeline.live(round(line.now * 1e9)).links)
            orchestra.step(brought)
            while taken < len(brought.items):
                pipeline.feed(brought.items[taken])
                taken += 1
            snapshot = pipeline.snapshot()
            if snapshot is not known:
                known = snapshot
                pose = pipeline.poses.current
                guidance = guide.next_target(snapshot, pose, Method.MODULES, line.now)
            if guidance.phase in (GuidePhase.CLOSING, GuidePhase.ENOUGH):
                break
            # As the line that another process gets.
            for said in robot.lines_to_send(guidance, snapshot, pose[0], line.now, measuring=True):
                operator.show(read_line(write_line(said) + "\n"))
    return pipeline, rig, guidance


def all_pairs():
    return [(wrench, skin) for wrench in WRENCHES for skin in (*SKINS, *dict.fromkeys((*NARROW_SKINS, *FINGERS)))]


@pytest.mark.parametrize(
    ("wrench", "skin"), [*pairs_of_each()[::2], ("leptrino", "paxini"), ("justfloat", "tsf85"), ("netft", "paxini-module")]
)
def test_a_guided_session_over_a_pair_comes_to_its_end(parts, wrench, skin):
    come_to_the_end(parts, wrench, skin)


def come_to_the_end(parts, wrench, skin):
    """A whole session over two protocols: nothing lost, all done, each estimate within what it predicts."""
    part = parts["narrow" if skin in NARROW_SKINS else "wide"]
    pipeline, rig, guidance = guided_to_the_end(part, wrench, skin)
    snapshot = pipeline.snapshot()
    outcomes = [record.outcome for record in snapshot.pokes]
    assert guidance.phase is GuidePhase.CLOSING, outcomes  # all that is left are the first places once more
    assert not any(guidance.needs)
    assert 4 <= len(outcomes) < MOST
    assert all(isinstance(outcome, Contact) for outcome in outcomes), outcomes
    for estimate in snapshot.estimates[Method.MODULES]:
        off = estimate.position - rig.places[rig.row_of(estimate.channel)]
        assert inside_95_ellipsoid(off, estimate.covariance), (estimate, off)
        assert np.linalg.norm(off) < 0.003
    for link in pipeline.live(0).links:
        assert link.state is LinkState.OPEN
        assert {loss for loss, count in link.losses.items() if count} <= {Loss.UNPAIRED, Loss.LATE}
