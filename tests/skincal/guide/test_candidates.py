"""What the guide makes of pokes: where they were, whom they were meant for, how they ended."""

from dataclasses import replace

import numpy as np
import pytest

from skincal.contacts.outcome import Contact, Reason, Rejection
from skincal.guide import candidates
from skincal.guide.candidates import ASTRAY, SPACING, Cover, spread_over
from skincal.guide.guidance import GuidePhase
from skincal.guide.guide import Guide
from skincal.guide.knowledge import SPACING as TAXELS_APART
from skincal.guide.knowledge import PlannedPlaces, plan_without_positions
from skincal.guide.poke_history import PokeAxis, PokeHistory, axis_of
from skincal.guide.progress import GuideSettings, Need, Why
from skincal.mesh.search import nearest_points
from skincal.model.actions import Exclude, Restore
from skincal.session.session import Session
from skincal.simulate.benches import Bench
from skincal.simulate.courses import Conditions, MeantPokes, poked, rig_beside
from skincal.simulate.simulated_rig import tangents
from skincal.taxels.result import Cause, Estimate, Method, State, StateReason

STEADY = Conditions(aim=0.0, hand=0.0)
PART = Bench()
SETTINGS = GuideSettings()
SOLVED = (Method.FREE, Method.SURFACE)
STUCK = StateReason(Cause.GIVEN, text="stuck")


class PokedBench:
    """A guide, a rig, and a hand that pokes where the test says."""

    def __init__(self, method=Method.SURFACE, seed=1, conditions=STEADY):
        self.session, self.conditions = Session(PART.scene, PART.surface, SOLVED), conditions
        self.guide = Guide(PART.plan, PART.scene.noise, method, PART.spacing)
        self.rig, self.rng = rig_beside(PART, conditions, seed), np.random.default_rng(seed)
        self.contacts, self.rejections, self.count = {}, {}, 0
        self.look()

    def look(self):
        estimates = self.session.snapshot().estimates
        self.guidance = self.guide.update(self.contacts, estimates, self.session.evidence, self.rejections)
        return self.guidance

    def poke_at(self, place, push):
        self.count += 1
        return poked(PART, self.rig, MeantPokes(place[None], push[None]), self.conditions, self.rng, self.count)[0]

    def poke(self, place, push):
        for contact in self.poke_at(place, push):
            self.session.add(contact)
            self.contacts[contact.poke] = contact
        return self.look()

    def reject(self, reason, place, push, channels=()):
        """End a poke as rejected, its force known."""
        self.count += 1
        force = 8.0 * push
        self.rejections[self.count] = Rejection(
            self.count, 0.0, 1.0, reason, 1.0, 0.5, "", np.array(channels, dtype=np.int64), True,
            force=force, moment=np.cross(place, force), link_from_sensor=np.eye(4),
        )  # fmt: skip
        return self.look()

    def true(self, channel):
        row = self.rig.row_of(channel)
        return self.rig.places[row], self.rig.normals[row]

    def beside(self, row):
        """Where the middle of a taxel's contacts lies beside it."""
        return self.guide.axis_diversity(int(PART.plan.channels[row]), self.session.evidence).beside


def edge_taxel():
    """The taxel whose neighbours lie most on one side, and how far beside it their middle is."""
    neighbours = candidates.find_answering(PART.plan.places, PART.spacing, PART.scene.noise)
    pulls = np.linalg.norm(candidates.answer_offsets(PART.plan.places, neighbours), axis=1)
    return int(pulls.argmax()), pulls.max()


def test_a_taxel_at_the_edge_that_is_poked_at_its_place_is_balanced():
    bench, (row, pull) = PokedBench(), edge_taxel()
    place, normal = bench.true(int(PART.plan.channels[row]))
    for _ in range(4):
        bench.poke(place, -normal)
    assert bench.guidance.own[row] == 4
    assert np.linalg.norm(bench.beside(row)) < SETTINGS.balance
    # The middle of those that answer lies well inside.
    assert pull > SETTINGS.balance


def test_pokes_on_one_half_of_a_taxel_are_seen_to_be_beside_it():
    bench = PokedBench()
    channel = int(PART.plan.channels[40])
    place, normal = bench.true(channel)
    aside = np.cross(normal, [1.0, 0.0, 0.0])
    aside /= np.linalg.norm(aside)
    for _ in range(4):
        bench.poke(place + 0.002 * aside, -normal)
    beside = bench.beside(40)
    assert beside @ aside > 0.0007
    assert abs(beside @ aside) > np.linalg.norm(beside - (beside @ aside) * aside)


@pytest.mark.parametrize("meets", ["below", "above"])
def test_pokes_that_lean_as_they_lie_want_one_beside_the_taxel_that_pulls_its_depth_back(meets):
    """Axes that meet below the skin, or above it."""
    bench = PokedBench(Method.FREE)
    channel, sign = int(PART.plan.channels[40]), -1.0 if meets == "below" else 1.0
    place, normal = bench.true(channel)
    (e1,), (e2,) = tangents(normal[None])
    for turn in np.arange(12) * np.pi / 6:
        aside = np.cos(turn) * e1 + np.sin(turn) * e2
        push = 0.45 * sign * aside - normal
        bench.poke(place + 0.0015 * aside, push / np.linalg.norm(push))
    estimates = bench.session.snapshot().estimates
    assert (estimates[Method.FREE][40].position - place) @ normal * sign > 0.002
    # The others need nothing: it is asked for this taxel.
    others = [
        estimate if estimate.channel == channel else Estimate(estimate.channel, Method.FREE, State.DEAD, 0, reason=STUCK)
        for estimate in estimates[Method.FREE]
    ]
    guide = Guide(PART.plan, PART.scene.noise, Method.FREE, PART.spacing)
    asked = guide.update(bench.contacts, {**estimates, Method.FREE: others}, bench.session.evidence)
    assert Need.DEPTH in asked.needs[40]
    assert asked.target.channel == channel
    aside, lean = asked.target.place - asked.places[40], asked.target.push + np.cos(asked.target.tilt) * normal
    assert np.linalg.norm(aside) > 0.001
    assert aside @ lean * sign < 0.0
    # Poked so, its depth comes back.
    for _ in range(6):
        bench.poke(place + aside, asked.target.push)
    depth = (bench.session.snapshot().estimates[Method.FREE][40].position - place) @ normal
    assert abs(depth) < 0.6 * abs((estimates[Method.FREE][40].position - place) @ normal)


def test_a_poke_early_on_is_not_taken_to_lie_aside_when_the_whole_skin_is_found_to():
    """The skin lies 4 mm beside its plan: pokes made before that was known are placed by their taxels."""
    bench = PokedBench(seed=2)
    for row in range(0, 84, 4):
        place, normal = bench.true(int(PART.plan.channels[row]))
        for _ in range(2):
            bench.poke(place, -normal)
    beside = np.linalg.norm([bench.beside(row) for row in range(0, 84, 4)], axis=1)
    assert np.median(beside) < 0.0008


def test_an_axis_is_that_of_the_wrench_in_the_link_frame():
    bench = PokedBench()
    contact = bench.poke_at(*(lambda p, n: (p, -n))(*bench.true(int(PART.plan.channels[10]))))[0]
    axis = axis_of(contact)
    place, normal = bench.true(int(PART.plan.channels[10]))
    assert axis.away(place) < 0.006
    assert axis.tilt(normal) < np.radians(5.0)
    assert axis_of(replace(bench_rejection(), force=None)) is None
    assert axis_of(bench_rejection(force=np.zeros(3))) is None


def bench_rejection(force=None):
    force = np.array([0.0, 0.0, -5.0]) if force is None else force
    return Rejection(
        1, 0.0, 1.0, Reason.SLID, 1.0, 0.5, "", np.empty(0, dtype=np.int64), True, force, np.zeros(3), np.eye(4)
    )  # fmt: skip


def test_a_taxel_that_never_answers_is_given_up_after_three_pokes_at_it():
    bench = PokedBench()
    silent = bench.guidance.target.channel
    place, normal = bench.guidance.target.place, bench.guidance.target.normal
    for count in range(SETTINGS.unanswered):
        assert silent not in bench.guidance.given_up
        assert bench.guidance.target.channel == silent, f"given up after {count}"
        bench.reject(Reason.NO_TAXEL, place, -normal)
    assert bench.guidance.given_up == {silent: Why.NEVER_FIRED}
    assert bench.guidance.target.channel != silent
    # It answers after all: it is a taxel like the others.
    bench.poke(*(lambda p, n: (p, -n))(*bench.true(silent)))
    assert not bench.guidance.given_up


def test_pokes_elsewhere_do_not_count_as_tries():
    bench = PokedBench()
    target = bench.guidance.target
    for _ in range(2 * SETTINGS.unanswered):
        bench.reject(Reason.NO_TAXEL, target.place + np.array([0.05, 0.0, 0.0]), -target.normal)
        bench.reject(Reason.TOO_SOFT, target.place, -target.normal)
    assert not bench.guidance.given_up
    assert bench.guidance.target.channel == target.channel


def test_pokes_that_slide_lower_the_tilt_that_is_asked_for():
    bench = PokedBench(Method.FREE)
    for _ in range(6):
        target = bench.guidance.target
        lean = np.cross(target.normal, [1.0, 0.0, 0.0])
        lean /= np.linalg.norm(lean)
        push = np.sin(np.radians(24.0)) * lean - np.cos(np.radians(24.0)) * target.normal
        bench.reject(Reason.SLID, target.place, push, [target.channel])
    assert bench.guidance.usable_tilt < np.radians(22.0)
    assert bench.guidance.target.tilt <= bench.guidance.usable_tilt + 1e-9


def test_a_hand_that_pokes_straight_where_a_tilt_is_wanted_is_asked_for_less():
    bench = PokedBench(Method.FREE)
    while bench.guidance.target.tilt < np.radians(25.0):
        bench.guide.skip()
        bench.look()
    for _ in range(2):
        target = bench.guidance.target
        bench.poke(target.place, -target.normal)
    assert bench.guidance.usable_tilt < SETTINGS.usable_tilt


def test_without_enough_tilt_the_free_method_says_so():
    bench = PokedBench(Method.FREE)
    channel = int(PART.plan.channels[40])
    place, normal = bench.true(channel)
    for _ in range(SETTINGS.own_pokes):
        bench.poke(place, -normal)
    assert channel not in bench.guidance.given_up
    # Friction that holds hardly any tilt: pokes at another taxel slide.
    elsewhere = int(PART.plan.channels[10])
    place, normal = bench.true(elsewhere)
    lean = np.cross(normal, [1.0, 0.0, 0.0])
    push = np.sin(np.radians(8.0)) * lean / np.linalg.norm(lean) - np.cos(np.radians(8.0)) * normal
    for _ in range(30):
        if bench.guidance.usable_tilt < SETTINGS.diversity:
            break
        bench.reject(Reason.SLID, place, push, [elsewhere])
    assert bench.guidance.usable_tilt < SETTINGS.diversity
    assert bench.guidance.given_up[channel] is Why.TILT


# ---- where no layout names taxels ----


def test_a_spread_is_even_and_leaves_no_hole():
    places, triangles = spread_over(PART.surface, SPACING)
    apart = np.linalg.norm(places[:, None] - places[None], axis=2)
    np.fill_diagonal(apart, np.inf)
    assert apart.min() >= 0.8 * SPACING
    # Any vertex of the part has a place near it, so no hole is larger than a tip feels.
    gaps = np.linalg.norm(PART.surface.vertices[:, None] - places[None], axis=2).min(axis=1)
    assert gaps.max() < SPACING
    on, _ = nearest_points(PART.surface, places)
    np.testing.assert_allclose(on, places, atol=1e-9)
    np.testing.assert_array_equal(PART.surface.normals[triangles].shape, places.shape)


def test_a_cover_goes_around_what_answered_and_then_far_from_all_pokes():
    cover = Cover(PART.surface)
    first = cover.next(None)

    def straight(index):
        return PokeAxis(-cover.normals[index], cover.places[index])

    cover.poked(1, straight(first), answered=False)
    cover.keep({1})
    second = cover.next(cover.places[first])
    assert np.linalg.norm(cover.places[second] - cover.places[first]) > ASTRAY
    cover.poked(2, straight(second), answered=True)
    cover.keep({1, 2})
    third = cover.next(cover.places[second])
    assert SPACING * 0.8 <= np.linalg.norm(cover.places[third] - cover.places[second]) < 2.5 * SPACING
    cover.leave_out(cover.places[third])
    assert cover.next(cover.places[second]) != third
    cover.keep({1})
    assert cover.next(cover.places[first]) == second, "the poke was taken back"


def test_pokes_that_are_taken_back_are_no_tries():
    """A taxel is not given up for pokes that do not count, and it is again once they do."""
    bench = PokedBench()
    # A plan of one taxel, so that it stays the target whatever else answers.
    target = bench.guidance.target
    row = int(np.searchsorted(PART.plan.channels, target.channel))
    of_one = (getattr(PART.plan, name)[row : row + 1] for name in ("channels", "places", "normals", "modules"))
    alone = Guide(PlannedPlaces(*of_one), PART.scene.noise, Method.SURFACE, PART.spacing)
    beside = target.place + 0.004 * np.cross(target.normal, [0.0, 0.0, 1.0])

    def given_up():
        estimates = {method: [every[row]] for method, every in bench.session.snapshot().estimates.items()}
        return alone.update(bench.contacts, estimates, bench.session.evidence).given_up

    assert not given_up()
    for _ in range(SETTINGS.unanswered):
        contact = bench.poke_at(beside, -target.normal)[0]
        keep = contact.channels != target.channel
        contact = replace(contact, channels=contact.channels[keep], responses=contact.responses[keep])
        assert not given_up()
        bench.contacts[contact.poke] = contact
        bench.session.add(contact)
    assert given_up() == {target.channel: Why.NEVER_FIRED}
    gone = dict(bench.contacts)
    for poke in gone:
        bench.session.act(Exclude(poke))
        del bench.contacts[poke]
    assert not given_up()
    for poke, contact in gone.items():
        bench.session.act(Restore(poke))
        bench.contacts[poke] = contact
    assert given_up() == {target.channel: Why.NEVER_FIRED}


def test_a_target_that_was_not_shown_is_not_missed():
    bench = PokedBench(Method.FREE)
    while bench.guidance.target.tilt < np.radians(25.0):
        bench.guide.skip()
        bench.look()
    target, before = bench.guidance.target, bench.guidance.usable_tilt
    for _ in range(3):
        bench.guide.forget_target()
        bench.poke(target.place, -target.normal)
    assert bench.guidance.usable_tilt == before


def test_the_hand_is_at_the_newest_poke_whatever_was_restored():
    bench, plan = PokedBench(), PART.plan
    history = PokeHistory(plan.channels, SETTINGS)
    pulls = candidates.answer_offsets(plan.places, candidates.find_answering(plan.places, PART.spacing, PART.scene.noise))

    def hand(contacts):
        history.follow(contacts, {}, None, plan.places, plan.normals, pulls)
        return history.hand(plan.places)

    assert hand({}) is None
    rows = (3, 40, 70)
    for row in rows:
        place, normal = bench.true(int(plan.channels[row]))
        bench.poke(place, -normal)
    there = hand(bench.contacts)
    assert np.linalg.norm(there - plan.places[rows[-1]]) < PART.spacing
    first, second, newest = bench.contacts
    hand({number: bench.contacts[number] for number in (second, newest)})
    # What was taken out and comes back stands first in the session, but last in what the history adds.
    np.testing.assert_array_equal(hand({number: bench.contacts[number] for number in (second, newest, first)}), there)
    without = hand({number: bench.contacts[number] for number in (first, second)})
    assert np.linalg.norm(without - plan.places[rows[1]]) < PART.spacing


def test_the_target_stays_while_a_poke_is_only_reported_again():
    bench = PokedBench(Method.FREE, conditions=Conditions())
    for _ in range(12):
        target = bench.guidance.target
        bench.poke(target.place, target.push)
        asked = bench.guidance.target
        newest = max(bench.contacts)
        before = bench.contacts[newest]
        again = replace(before, force=before.force + np.array([0.3, -0.2, 0.1]), tare_change=0.3)
        bench.contacts[newest] = again
        bench.session.add(again)
        bench.look()
        assert bench.guidance.target.channel == asked.channel
        assert bench.guidance.target.push @ asked.push == pytest.approx(1.0)
        bench.contacts[newest] = before
        bench.session.add(before)
        bench.look()
    first = bench.guidance.target
    bench.guide.skip()
    assert bench.look().target.channel != first.channel


def bare(method):
    """A session and a guide that know the surface and nothing of the skin."""
    scene = replace(PART.scene, skin=replace(PART.scene.skin, layout=None, anchor=None))
    channels = np.arange(scene.skin.channels)
    guide = Guide(plan_without_positions(channels), scene.noise, method, TAXELS_APART, cover=Cover(PART.surface))
    return Session(scene, PART.surface, SOLVED), guide


@pytest.mark.parametrize("method", [Method.FREE, Method.SURFACE])
def test_without_a_layout_the_taxels_are_found_and_then_poked(method):
    session, guide = bare(method)
    rig, rng = rig_beside(PART, Conditions(), 1), np.random.default_rng(5)
    contacts, rejections, seen, phases = {}, {}, set(), []
    for poke in range(1, 181):
        before = {m: {each.channel: each for each in every} for m, every in session.snapshot().estimates.items()}
        estimates = {
            m: [of.get(c) or Estimate(c, m, State.UNSEEN, 0) for c in range(len(guide.plan.channels))]
            for m, of in before.items()
        }
        guidance = guide.update(contacts, estimates, session.evidence, rejections)
        phases.append(guidance.phase)
        target = guidance.target
        made, pokes = poked(PART, rig, MeantPokes(target.place[None], target.push[None]), Conditions(), rng, poke)
        for contact in made:
            session.add(contact)
            contacts[poke] = contact
            seen |= set(contact.channels.tolist())
        if not made:
            force = 8.0 * pokes.directions[0]
            rejections[poke] = Rejection(
                poke, 0.0, 1.0, Reason.NO_TAXEL, 0.0, 1.0, "", np.empty(0, dtype=np.int64), True,
                force, np.cross(pokes.points[0], force), np.eye(4),
            )  # fmt: skip
    assert phases[0] is GuidePhase.COVER
    assert phases[-1] in (GuidePhase.OWN, GuidePhase.SWEEP)
    assert set(guidance.channels.tolist()) <= seen
    assert len(seen) > 70
    assert all(isinstance(each, Contact) for each in contacts.values())
    assert len(guidance.needs) == len(guidance.channels) == len(guidance.places)
    # Half of the first pokes find nothing: then the skin is known, and hardly any miss it.
    assert len(contacts) > 110
