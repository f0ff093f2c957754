"""The closing check: when it is asked for, what it finds, and that a session that is played again finds the same."""

from __future__ import annotations

import json
from dataclasses import replace

import numpy as np
import pytest

from skincal.contacts.outcome import Reason, Rejection
from skincal.files.export import json_text
from skincal.guide.guidance import GuidePhase
from skincal.journal.writer import create_session
from skincal.model.actions import BeginClosing, FoundAtLandmark, from_json, to_json
from skincal.rig.closing import ClosingPlaces, closing_check
from skincal.sentences import closing_sentence
from skincal.session.closing_pokes import at_taxels, closing_of
from skincal.session.guiding import SessionGuide
from skincal.session.part import lay_part
from skincal.session.pipeline import Pipeline
from skincal.session.replay import load, replay
from skincal.session.session import Session
from skincal.simulate.contacts import aim, poke_landmarks, simulate_contacts, unguided
from skincal.simulate.faults import RigErrors
from skincal.simulate.operator import Habits
from skincal.taxels.result import Method
from tests.approved import approved
from tests.skincal.poke_script import LINKS, as_chunks, some_pokes, write_scene
from tests.skincal.sim_support import make_rig

NOWHERE = np.empty(0, dtype=np.int64)


class Sessions:
    """A session on a simulated rig, and the guide that follows it."""

    def __init__(self, errors: RigErrors, *, landmarks: bool = True) -> None:
        self.rng = np.random.default_rng(3)
        self.rig = make_rig(errors, 1)
        scene = self.rig.scene if landmarks else replace(self.rig.scene, landmarks=())
        self.session = Session(scene, self.rig.surface)
        self.guide = SessionGuide(lay_part(scene, self.rig.surface, ()))
        self.slip, self.number = np.zeros(3), 0
        stance = self.rig.stance()
        self.session.set_current_pose(stance.name, stance.reported)
        for name in [landmark.name for landmark in scene.landmarks]:
            self.poke_landmark(name)
        for contact in simulate_contacts(self.rig, unguided(self.rig, 2, self.rng), self.rng, first_poke=self.number + 1):
            self.session.add(contact)

    def slipped(self, poke):
        """The poke as it is after the part moved by `slip`, link frame, metres."""
        turn = poke.link_from_sensor[:3, :3]
        return replace(poke, moment=poke.moment + np.cross(turn.T @ self.slip, poke.force))

    def poke_landmark(self, name: str) -> None:
        self.number = self.session.last_poke + 1
        landmark = next(each for each in self.session.landmarks if each.name == name)
        poke = self.slipped(poke_landmarks(self.rig, (landmark,), 1, self.rng, self.number)[0])
        where = poke.force, poke.moment, poke.link_from_sensor, poke.pose
        self.session.add(Rejection(self.number, 0.0, 0.3, Reason.NO_TAXEL, 0.0, 1.0, "", NOWHERE, True, *where))
        self.session.act(FoundAtLandmark(self.number, name))

    def poke_taxel(self, channel: int) -> None:
        """Poke it until it is the one that answers most."""
        for _ in range(20):
            pressed = aim(self.rig, np.array([channel]), Habits(aim=0.0005), self.rng)
            for contact in simulate_contacts(self.rig, pressed, self.rng, first_poke=self.session.last_poke + 1):
                if int(contact.channels[contact.responses.argmax()]) == channel:
                    self.session.add(self.slipped(contact))
                    return
        raise AssertionError(channel)

    def look(self):
        snapshot = self.session.snapshot()
        return self.guide.follow(snapshot, snapshot.generation, Method.MODULES, self.session.evidence, 100.0)

    def close(self) -> list[str]:
        """Poke what the closing check asks for; return what that was."""
        asked: list[str] = []
        while (guidance := self.look()).phase is GuidePhase.CLOSING:
            if self.session.closing_after is None:
                self.session.act(BeginClosing())
            assert guidance.closing == (len(asked), 3)
            if guidance.landmark is not None:
                asked.append(guidance.landmark.landmark.name)
                self.poke_landmark(asked[-1])
            else:
                asked.append(str(guidance.target.channel))
                self.poke_taxel(guidance.target.channel)
        assert guidance.phase is GuidePhase.ENOUGH
        return asked

    def verdict(self):
        return self.guide.verdict(self.look(), self.session.snapshot(), self.session.evidence)


def test_at_enough_three_landmarks_are_asked_for_once_more_and_nothing_moved():
    it = Sessions(RigErrors.noise())
    assert it.look().enough
    assert it.verdict().closing is None
    first = [poke.name for poke in it.session.landmark_pokes][:3]
    assert it.close() == first
    closing = it.verdict().closing
    assert (closing.at, closing.names) == (ClosingPlaces.LANDMARKS, tuple(sorted(first)))
    assert not closing.moved
    assert closing.shift < closing.limit < 0.012
    assert it.session.calibration().closing == closing
    assert closing_sentence(closing) == approved(
        "closing.still", shift=f"{closing.shift * 1e3:.1f}", limit=f"{closing.limit * 1e3:.1f}", count=3, places="landmarks"
    )
    written = json.loads(json_text(it.session.calibration()))["closing_check"]
    assert (written["at"], written["shift_m"], written["moved"]) == ("landmarks", closing.shift, False)


def test_what_slipped_meanwhile_is_told_with_its_number():
    it = Sessions(RigErrors.noise())
    it.slip = np.array([0.0, 0.012, 0.0])
    it.close()
    verdict = it.verdict()
    assert verdict.closing.moved
    assert verdict.closing.shift == pytest.approx(0.012, abs=0.005)
    assert verdict.doubted
    assert closing_sentence(verdict.closing).startswith(
        approved("closing.moved_begin", what="the sensor or the arm", shift=f"{verdict.closing.shift * 1e3:.1f}")
    )


def test_a_rig_that_is_wrong_all_along_has_not_moved():
    it = Sessions(RigErrors.paper())
    it.session.act(BeginClosing())
    for name in [poke.name for poke in it.session.landmark_pokes][:3]:
        it.poke_landmark(name)
    closing = closing_of(it.session.snapshot(), it.rig.scene.noise)
    assert len(closing.names) == 3
    assert not closing.moved


def test_without_landmarks_three_of_the_first_taxels_are_poked_once_more():
    it = Sessions(RigErrors.noise(), landmarks=False)
    first = list(dict.fromkeys(poke.name for poke in at_taxels(it.session.snapshot())))[:3]
    assert it.close() == first
    closing = it.verdict().closing
    assert (closing.at, set(closing.names)) == (ClosingPlaces.TAXELS, set(first))
    assert not closing.moved
    it.session.snapshot()
    moved = replace(closing, chance=0.001)
    assert approved("closing.skin_clause") in closing_sentence(moved)


def test_one_is_skipped_or_all_of_it():
    it = Sessions(RigErrors.noise())
    first = it.look().landmark.landmark.name
    it.guide.skip()
    assert it.look().landmark.landmark.name != first
    it.guide.skip_landmarks()
    assert it.look().phase is GuidePhase.ENOUGH


def test_who_pokes_elsewhere_is_not_asked_for_ever():
    it = Sessions(RigErrors.noise())
    it.session.act(BeginClosing())
    other = next(reversed(it.session.landmark_pokes)).name
    for _ in range(9):
        assert it.look().phase is GuidePhase.CLOSING
        it.poke_landmark(other)
    assert it.look().phase is GuidePhase.ENOUGH


def test_the_chance_is_what_it_says():
    """Of 60 rigs with the paper's errors, about one in ten shows a chance below a tenth, and hardly one below a hundredth."""
    chances = []
    for seed in range(60):
        rig, rng = make_rig(RigErrors.paper(), seed), np.random.default_rng(seed)
        pokes = poke_landmarks(rig, rig.scene.landmarks, 9, rng, 1)[:9]
        found = closing_check(pokes[:6], pokes[6:], ClosingPlaces.LANDMARKS, rig.scene.noise)
        chances.append(found.chance)
    assert np.mean(np.array(chances) < 0.1) < 0.2
    assert np.mean(np.array(chances) < 0.01) < 0.06
    assert 0.3 < np.mean(np.array(chances) < 0.5) < 0.7


@pytest.mark.parametrize("again", [replay, load])
def test_a_session_played_again_began_it_after_the_same_poke(tmp_path, again):
    assert from_json(json.loads(json.dumps(to_json(BeginClosing())))) == BeginClosing()
    scene = write_scene(tmp_path / "source")
    pipeline = Pipeline(scene, LINKS, None, create_session(tmp_path / "s", scene, LINKS))
    items = as_chunks(some_pokes(scene, 4).samples)
    half = len(items) // 2
    for item in items[:half]:
        pipeline.feed(item)
    pipeline.act(BeginClosing(), items[half].host_ns)
    for item in items[half:]:
        pipeline.feed(item)
    pipeline.act(BeginClosing(), items[-1].host_ns)
    pipeline.close()
    assert 0 < pipeline.snapshot().closing_after < 4
    other = again(tmp_path / "s")
    assert other.snapshot().closing_after == pipeline.snapshot().closing_after
    assert closing_of(other.snapshot(), scene.noise) == closing_of(pipeline.snapshot(), scene.noise)
