"""The guide looks at what changed alone: it says what it would say if it looked at everything, at a cost that does not grow."""

import sys
from collections import Counter
from dataclasses import fields, replace
from functools import partial

import numpy as np
import pytest

from skincal.following.session_guide import SessionGuide, asked_poke
from skincal.guide.guidance import GuidePhase
from skincal.guide.predictable_pokes import PredictablePokes
from skincal.guide.progress import ContactFacts, find_needs
from skincal.guide.verdict import check
from skincal.model.actions import AtLandmark, BeginClosing, Exclude, MarkDead, Redo, Restore, Uncorrect, Undo
from skincal.model.errors import InputError
from skincal.part.part import lay_part
from skincal.rig.correction import RIG, Correction, UsedCorrection
from skincal.session.corrections import correct_action
from skincal.session.session import Session
from skincal.simulation.example_parts import ExamplePart
from skincal.simulation.poking_strategies import Conditions, Hand, MeantPokes, displaced_rig
from skincal.taxels.result import Method

PART = ExamplePart()
METHODS = (Method.MODULES, Method.SURFACE, Method.FREE)


def without_changes(snapshot, step):
    """The same moment without a list of changes, columns or table; each second time the estimates are in another order."""
    order = slice(None, None, -1 if step % 2 else 1)
    estimates = {method: every[order] for method, every in snapshot.estimates.items()}
    return replace(snapshot, estimates=estimates, changes=None, columns_now=None, table=None)


def all_needs(guide):
    """The needs of each taxel, all computed now."""
    know, own = guide._statistics, guide._own()
    return [
        find_needs(estimate, ContactFacts(*facts), guide.method, guide.settings, PART.scene.noise.skin)
        for estimate, *facts in zip(
            *(guide._own_estimates.estimates, own, know.diversity, know.offset_size, know.depth_bias, know.last_shift),
            guide._surroundings.touched_or_surrounded(guide._own_estimates.touched)
            if guide._surroundings is not None
            else np.ones(len(own), dtype=bool),
            strict=True,
        )
    ]


def content(value):
    """What a guidance says, its arrays as bytes."""
    if isinstance(value, np.ndarray):
        return value.tobytes()
    if hasattr(value, "__dataclass_fields__"):
        return {field.name: content(getattr(value, field.name)) for field in fields(value)}
    return value


class RandomOperator:
    """A hand that follows the guide, and an operator who changes much."""

    def __init__(self, seed):
        self.rng, self.session = np.random.default_rng(seed), Session(PART.scene, PART.surface)
        self.hand = Hand(displaced_rig(PART, Conditions(), seed), Conditions(), np.random.default_rng([seed, 1]))
        self.method = METHODS[seed % len(METHODS)]

    def poke(self, guidance):
        number, target = self.session.last_poke + 1, guidance.target
        row = int(self.rng.integers(len(PART.plan.channels)))
        place, push = PART.plan.places[row], -PART.plan.normals[row]
        if target is not None and target.channel is not None:
            place, push = target.place, target.push
        self.session.act(asked_poke(guidance))
        for contact in self.hand.poke(MeantPokes(place[None], push[None]), number)[0]:
            self.session.add(contact)
            if self.rng.random() < 0.5:
                self.session.add(replace(contact, tare_change=0.02))

    def correct(self):
        if RIG in self.session.decisions.corrections:
            return self.session.act(Uncorrect(RIG))
        moved = np.eye(4)
        moved[:3, 3] = self.rng.normal(0.0, 0.001, 3)
        return self.session.act(correct_action(UsedCorrection(RIG, Correction(np.eye(6), moved), 0.004, 0.002, 7, 1.0)))

    def step(self, guidance):
        session, last = self.session, self.session.last_poke
        number = int(self.rng.integers(1, max(last, 2)))
        acts = (
            *(partial(session.act, action) for action in (Exclude(number), Restore(number), Undo(), Redo())),
            *(self.correct, partial(session.act, MarkDead(int(self.rng.choice(PART.plan.channels))))),
        )
        if guidance.closing is not None and len(session.decisions.closings) < guidance.closing.number:
            session.act(BeginClosing())
        if last > 5 and self.rng.random() < 0.3:
            try:
                acts[self.rng.choice(len(acts), p=(0.25, 0.2, 0.25, 0.2, 0.05, 0.05))]()
            except InputError:
                return
        else:
            for _ in range(self.rng.integers(1, 6)):
                self.poke(guidance)
        if self.rng.random() < 0.1:
            self.method = METHODS[self.rng.integers(len(METHODS))]


@pytest.mark.parametrize("seed", [1, 2])
def test_it_says_what_it_would_say_if_it_looked_at_everything(seed):
    part = lay_part(replace(PART.scene, landmarks=()), PART.surface, ())
    at, following, anew = RandomOperator(seed), SessionGuide(part), SessionGuide(part)
    phases = Counter()
    for step in range(40):
        snapshot = at.session.snapshot()
        pose = (snapshot.contacts[-1].pose, snapshot.contacts[-1].link_from_sensor) if snapshot.contacts else ("", None)
        guidance = following.next_target(snapshot, pose, at.method, float(step))
        assert content(guidance) == content(anew.next_target(without_changes(snapshot, step), pose, at.method, float(step)))
        guide = following._guides[at.method]
        assert guide._needs == all_needs(guide)
        phases[guidance.phase] += 1
        at.step(guidance)
    assert len(phases) >= 2, phases


@pytest.mark.parametrize("method", METHODS)
def test_held_out_pokes_are_counted_as_the_verdict_counts_them(method):
    session, noise = Session(PART.scene, PART.surface), PART.scene.noise
    counted = PredictablePokes(PART.plan.channels, method, noise, PART.surface, PART.model)
    contacts = PART.contacts(2, 3)
    found = set()
    for number in range(0, len(contacts), 31):
        for contact in contacts[number : number + 31]:
            session.add(contact)
        snapshot = session.snapshot()
        of = {estimate.channel: estimate for estimate in snapshot.estimates[method]}
        checked = check(snapshot, PART.plan.channels.tolist(), method, noise, PART.surface, PART.model).checked
        assert counted.count_held_out(snapshot, of.get, 10**6) == checked
        assert min(counted.count_held_out(snapshot, of.get, 10), 10) == min(checked, 10)
        found.add(checked)
    assert len(found) > 2


def test_the_gain_of_landmark_pokes_follows_a_poke_that_gets_another_landmark():
    session, part = Session(PART.scene, PART.surface), lay_part(PART.scene, PART.surface, ())
    every = PART.contacts(1, 3)
    contacts = [each for each in every if each.pose == every[0].pose][:9]
    for number, contact in enumerate(contacts, start=1):
        session.add(replace(contact, poke=number))
    first, second, *_ = names = [landmark.name for landmark in PART.scene.landmarks]
    for number in range(1, 6):
        session.act(AtLandmark(number, names[(number - 1) % len(names)]))
    guide, pose = SessionGuide(part), (contacts[0].pose, contacts[0].link_from_sensor)
    gains = []
    for renamed in ((), ((1, second), (2, first))):
        for number, name in renamed:
            session.act(AtLandmark(number, name))
        snapshot = session.snapshot()
        gain = guide.next_target(snapshot, pose, Method.MODULES, 0.0).gain
        assert gain == SessionGuide(part).next_target(snapshot, pose, Method.MODULES, 0.0).gain
        gains.append(gain)
    assert gains[0] != gains[1]


def calls_of_a_poke(pokes):
    """Python calls of one poke, its snapshot and its target, in a session of so many; the median of nine."""
    session, guide = Session(PART.scene, PART.surface), SessionGuide(lay_part(PART.scene, PART.surface, ()))
    contacts = PART.contacts(-(-(pokes + 9) // len(PART.plan.channels)), 3)
    order = np.random.default_rng(0).permutation(len(contacts))
    every = [replace(contacts[index], poke=number) for number, index in enumerate(order.tolist(), start=1)]
    for contact in every[:pokes]:
        session.add(contact)
    guide.next_target(session.snapshot(), ("", None), Method.MODULES, 0.0)
    counts = []
    for contact in every[pokes : pokes + 9]:
        calls = 0

        def count(*_):
            nonlocal calls
            calls += 1

        sys.setprofile(count)
        session.add(contact)
        guidance = guide.next_target(session.snapshot(), (contact.pose, contact.link_from_sensor), Method.MODULES, 1.0)
        sys.setprofile(None)
        counts.append(calls)
    assert guidance.phase is not GuidePhase.SWEEP
    return float(np.median(counts))


def test_a_poke_takes_as_many_steps_in_a_long_session_as_in_a_short_one():
    assert calls_of_a_poke(3000) < 1.5 * calls_of_a_poke(300)
