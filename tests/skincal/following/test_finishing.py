"""When a session is finished: every taxel is touched or lies between touched ones, and enough pokes test the result."""

from collections import Counter
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from skincal.contacts.outcome import Reason, Rejection
from skincal.files.layout_sources import parse_grid
from skincal.following.session_guide import ModulesEnough, SessionGuide, asked_poke
from skincal.guide.guidance import GuidePhase
from skincal.guide.progress import MIN_CHECKED_POKES, Need, Why
from skincal.guide.verdict import Check
from skincal.model.actions import AtLandmark, Exclude, FoundAtLandmark, Redo, SkipPoke, Undo
from skincal.model.scene import Landmark
from skincal.model.skin import read_layout
from skincal.part.part import lay_part
from skincal.rig.correction_fit import LandmarkAgreement
from skincal.session.session import Session
from skincal.simulation.contacts import simulate_contacts
from skincal.simulation.example_parts import forearm
from skincal.simulation.operator import OPERATORS, aimed_presses
from skincal.simulation.rig_errors import RigErrors
from skincal.simulation.simulated_rig import Rig
from skincal.taxels.result import Cause, Method, State
from skincal.words.poke_words import poke_count_words
from skincal.words.verdict_words import verdict_sentence
from tests.approved import approved

MAX_POKES = 150


def rejected(contact, poke, reason):
    """The same press as a rejection, without an answer."""
    return Rejection(
        poke, contact.start_s, contact.end_s, reason, 1.0, 0.5, "", np.array([], dtype=np.int64), True,
        force=contact.force, moment=contact.moment, link_from_sensor=contact.link_from_sensor,
    )  # fmt: skip


class Hand:
    """A careful hand that presses what the guide asks for, on a grid that lies 2.8 mm off its plan."""

    def __init__(
        self,
        grid: str,
        seed: int = 1,
        silent: tuple[int, ...] = (),
        method: Method = Method.MODULES,
        kind: str = "sheet",
        exchanged: tuple[tuple[int, int], ...] = (),
    ):
        size = parse_grid(grid)
        count = size.rows * size.columns
        layout = read_layout(size.layout_text().replace('kind = "sheet"', f'kind = "{kind}"'), Path("grid.modules.toml"), count)
        scene = forearm().scene
        scene = replace(scene, skin=replace(scene.skin, channels=count, layout=layout), landmarks=())
        surface = forearm().surface
        errors = replace(RigErrors.noise(), mount_shift=0.0028, mount_turn=0.0)
        self.rig = Rig(scene, surface, errors, np.random.default_rng([seed, 7]))
        self.session, self.method, self.silent = Session(scene, surface), method, silent
        self.order = np.arange(count)
        for one, other in exchanged:
            self.order[[one, other]] = other, one
        self.guide = SessionGuide(lay_part(scene, surface, ()))
        self.rng, self.pokes = np.random.default_rng([seed, 11]), 0
        self.phases = Counter[GuidePhase]()

    def look(self):
        return self.guide.next_target(self.session.snapshot(), ("", None), self.method, 0.0)

    def poke(self, guidance):
        target = guidance.target
        self.phases[guidance.phase] += 1
        self.session.act(asked_poke(guidance))
        self.pokes += 1
        habits, pose = OPERATORS["careful"], next(iter(self.rig.arm_poses))
        places = target.place[None], target.push[None]
        pressed = aimed_presses(self.rig, np.zeros(1, dtype=np.int64), *places, habits, self.rng)
        for contact in simulate_contacts(self.rig, pressed, self.rng, pose, self.pokes, habits):
            heard = ~np.isin(contact.channels, self.silent)
            channels, responses = self.order[contact.channels[heard]], contact.responses[heard]
            turn = np.argsort(channels)
            part = replace(contact, channels=channels[turn], responses=responses[turn])
            self.session.add(part if heard.any() else rejected(contact, self.pokes, Reason.NO_TAXEL))

    def finish(self):
        while not (guidance := self.look()).enough:
            assert self.pokes < MAX_POKES
            self.poke(guidance)
        return guidance

    def verdict(self):
        return self.guide.verdict(self.session.snapshot(), self.method)


@pytest.mark.parametrize(("grid", "corners"), [("6x8@9mm", (0, 7, 40, 47)), ("4x10@6mm", (0, 9, 30, 39))])
def test_the_guide_asks_for_touches_until_no_position_lies_beyond_them(grid, corners):
    hand = Hand(grid, kind="board")
    news = ModulesEnough(hand.guide.plan, hand.session.scene.noise.skin, hand.guide.surroundings)
    beyond = 0
    while not (guidance := hand.look()).enough:
        beyond += any(Need.TOUCH in needs for needs in guidance.needs)
        assert not news.is_news(hand.session.snapshot(), guidance, Method.FREE, streaming=True)
        hand.poke(guidance)
    assert beyond > 3
    assert news.is_news(hand.session.snapshot(), replace(guidance, phase=GuidePhase.OWN), Method.FREE, streaming=True)
    estimates = hand.session.snapshot().estimates[Method.MODULES]
    touched = np.array([estimate.state is State.TOUCHED for estimate in estimates])
    assert touched[list(corners)].all(), "corners lie beyond all others"
    assert 0 < np.sum(~touched) < len(touched)
    assert all(estimate.state is State.INFERRED for estimate in estimates if not estimate.contacts)
    verdict = hand.verdict()
    assert verdict.is_finished
    assert (verdict.done, verdict.used) == (len(estimates), len(estimates))
    assert dict(verdict.states) == {State.TOUCHED: int(touched.sum()), State.INFERRED: int((~touched).sum())}
    assert verdict.check.checked >= MIN_CHECKED_POKES


@pytest.mark.parametrize("kind", ["sheet", "board"])
def test_exchanged_channels_are_not_finished_and_are_named(kind):
    hand = Hand("5x7@9mm", kind=kind, exchanged=((8, 26), (10, 30)))
    guidance = hand.finish()
    verdict = hand.verdict()
    assert verdict.contradicted == (8, 10, 26, 30)
    assert set(guidance.given_up) == {left.channel for left in verdict.left} == {8, 10, 26, 30}
    assert verdict.exchanged == ((8, 26), (10, 30))
    assert verdict.doubted
    agreeing = replace(verdict, check=Check(14, 14), landmarks=LandmarkAgreement(21, 0.94, corrected=True))
    assert not agreeing.believed
    assert replace(agreeing, contradicted=()).believed, "nothing else denies it"
    assert approved("verdict.exchanged") in verdict_sentence(verdict)
    estimates = {each.channel: each for each in hand.session.snapshot().estimates[Method.MODULES]}
    for channel in verdict.contradicted:
        assert estimates[channel].reason.cause in (Cause.CONTRADICTED, Cause.CLAIMED)
        assert (estimates[channel].state, estimates[channel].position, estimates[channel].sd) == (State.BLIND, None, None)


def test_a_corner_that_never_answers_is_given_up_and_the_session_ends():
    hand = Hand("5x5@8mm", silent=(24,))
    guidance = hand.finish()
    assert guidance.given_up == {24: Why.NEVER_FIRED}
    verdict = hand.verdict()
    assert (verdict.done, verdict.used, verdict.is_finished) == (24, 25, True)
    assert verdict.states[State.INFERRED] >= 1


def test_test_pokes_are_asked_for_until_there_are_enough():
    hand = Hand("1x1@9mm", method=Method.SURFACE)
    guidance = hand.finish()
    assert hand.phases[GuidePhase.TEST] >= 1
    assert guidance.is_finished
    assert hand.verdict().check.checked >= MIN_CHECKED_POKES
    few = hand.session.snapshot().contacts[MIN_CHECKED_POKES - 1 :]
    for contact in few:
        hand.session.act(Exclude(contact.poke))
    assert not hand.look().is_finished
    assert not hand.verdict().is_finished


def test_a_skipped_test_poke_moves_on_and_twice_skipped_taxels_end_it():
    hand = Hand("1x1@9mm", method=Method.SURFACE)
    while (guidance := hand.look()).phase is not GuidePhase.TEST:
        hand.poke(guidance)
    asked = []
    while (guidance := hand.look()).phase is GuidePhase.TEST:
        target = guidance.target
        asked.append(target.channel)
        hand.session.act(SkipPoke("surface", target.channel, tuple(target.place), tuple(target.push)))
    assert asked == [0, 0]
    assert guidance.enough
    assert not guidance.is_finished
    assert guidance.tests_missing == MIN_CHECKED_POKES - hand.verdict().check.checked


def test_a_single_taxel_as_a_module_ends_without_being_finished():
    """Its turn is not determined, so no poke can be predicted from the others."""
    hand = Hand("1x1@9mm", kind="board")
    guidance = hand.finish()
    assert hand.pokes < 3 * MIN_CHECKED_POKES
    assert not guidance.is_finished
    assert not hand.verdict().is_finished


def test_every_poke_is_counted_once_and_an_undone_landmark_poke_is_excluded():
    scene = replace(forearm().scene, landmarks=(Landmark("tip", np.zeros(3), None),))
    session = Session(scene, None)
    hand = Hand("4x4@8mm")
    while len(hand.session.snapshot().contacts) < 4:
        hand.poke(hand.look())
    on_skin = hand.session.snapshot().contacts[:3]
    for number, contact in enumerate(on_skin, start=1):
        session.add(replace(contact, poke=number))
    for poke, reason in ((4, Reason.NO_TAXEL), (5, Reason.SLID)):
        session.add(rejected(on_skin[0], poke, reason))

    def counted() -> str:
        return poke_count_words(session.snapshot().poke_counts)

    def numbers() -> tuple[int, ...]:
        found = session.snapshot().poke_counts
        assert found.pokes == 5
        return found.on_skin, found.at_landmarks, found.on_both, found.rejections, found.excluded

    assert numbers() == (3, 0, 0, 2, 0)
    session.act(FoundAtLandmark(4, "tip"))
    assert numbers() == (3, 1, 0, 1, 0)
    assert counted() == approved("counts.with_landmark")
    session.act(Undo())
    assert numbers() == (3, 0, 0, 1, 1), "the operator took it out: it is not a rejected one"
    session.act(Redo())
    assert numbers() == (3, 1, 0, 1, 0)
    session.act(AtLandmark(4, ""))
    session.act(Exclude(2))
    assert numbers() == (2, 0, 0, 1, 2)
    session.act(AtLandmark(1, "tip"))
    assert numbers() == (1, 0, 1, 1, 2)
    assert counted() == approved("counts.on_both")


def test_a_verdict_is_a_question_and_changes_nothing():
    """A verdict on an older moment let the guide forget a skip, and count it a second time with the next poke."""
    asking, silent = (Hand("4x4@9mm", method=Method.SURFACE) for _ in range(2))
    for _ in range(6):
        for hand in (asking, silent):
            hand.poke(hand.look())
    before = asking.session.snapshot()
    skipped = asking.look().target.channel
    for hand in (asking, silent):
        hand.look()
        hand.session.act(hand.guide.skip())
        hand.look()
    for method in (Method.SURFACE, Method.FREE):
        asking.guide.verdict(before, method)
        asking.guide.verdict(asking.session.snapshot(), method)
    for hand in (asking, silent):
        hand.poke(hand.look())
    asked, unasked = asking.look(), silent.look()
    assert asked.target.channel == unasked.target.channel
    assert np.array_equal(asked.places, unasked.places)
    worth = [hand.guide.axis_diversity(skipped).worth for hand in (asking, silent)]
    assert np.array_equal(*worth), "the skipped side"
