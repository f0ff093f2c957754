"""What the guide learns from pokes: their positions, their targets, and how they ended."""

from dataclasses import replace

import numpy as np
import pytest
from guided_bench import PART, STEADY, GuidedBench, make_guide, tilted

from skincal.contacts.outcome import Reason, Rejection
from skincal.guide.believed_positions import PlannedPlaces
from skincal.guide.candidates import answer_offsets, find_answering
from skincal.guide.guide import Guide
from skincal.guide.poke_history import PokeHistory, with_axis
from skincal.guide.progress import GuideSettings, Need, Why
from skincal.model.actions import Exclude, Restore
from skincal.simulation.simulated_rig import tangents
from skincal.taxels.result import Cause, Estimate, Method, State, StateReason

SETTINGS = GuideSettings()
PLAN = PART.plan
OFFSETS = answer_offsets(PLAN.places, find_answering(PLAN.places, PART.spacing, PART.scene.noise))


def steady(method=Method.SURFACE, **options):
    return GuidedBench(method, conditions=STEADY, **options)


def follow(history, contacts, targets=None):
    outcomes = dict(sorted({**dict.fromkeys(history.contacts), **contacts}.items()))
    history.update(outcomes, (targets or {}).get, PLAN.places, PLAN.normals, OFFSETS)


def test_a_taxel_at_the_edge_that_is_poked_exactly_is_balanced():
    bench, row = steady(), int(np.linalg.norm(OFFSETS, axis=1).argmax())
    for _ in range(4):
        bench.poke_taxel(row)
    assert bench.guidance.own[row] == 4
    assert np.linalg.norm(bench.diversity(row).beside) < SETTINGS.balance < np.linalg.norm(OFFSETS[row])


def test_pokes_on_one_half_of_a_taxel_are_found_on_that_side():
    bench = steady()
    aside = np.cross(bench.true(int(PLAN.channels[40]))[1], [1.0, 0.0, 0.0])
    aside /= np.linalg.norm(aside)
    for _ in range(4):
        bench.poke_taxel(40, 0.002 * aside)
    beside = bench.diversity(40).beside
    assert beside @ aside > 0.0007
    assert abs(beside @ aside) > np.linalg.norm(beside - (beside @ aside) * aside)


@pytest.mark.parametrize("sign", [-1.0, 1.0], ids=["axes meet below the skin", "axes meet above it"])
def test_a_biased_depth_is_corrected_by_a_poke_off_the_taxel(sign):
    bench = steady(Method.FREE)
    channel = int(PLAN.channels[40])
    place, normal = bench.true(channel)
    (e1,), (e2,) = tangents(normal[None])
    for turn in np.arange(12) * np.pi / 6:
        aside = np.cos(turn) * e1 + np.sin(turn) * e2
        push = 0.45 * sign * aside - normal
        bench.poke(place + 0.0015 * aside, push / np.linalg.norm(push), shown=False)
    estimates = bench.session.snapshot().estimates
    assert (estimates[Method.FREE][40].position - place) @ normal * sign > 0.002
    # The others need nothing, so this taxel is the target.
    stuck = StateReason(Cause.EXTERNAL_TEXT, text="stuck")
    others = [
        estimate if estimate.channel == channel else Estimate(estimate.channel, Method.FREE, State.DEAD, 0, reason=stuck)
        for estimate in estimates[Method.FREE]
    ]
    asked = bench.update(make_guide(), {**estimates, Method.FREE: others})
    assert Need.DEPTH in asked.needs[40]
    assert asked.target.channel == channel
    aside, lean = asked.target.place - asked.places[40], asked.target.push + np.cos(asked.target.tilt) * normal
    assert np.linalg.norm(aside) > 0.001
    assert aside @ lean * sign < 0.0
    for _ in range(6):
        bench.poke(place + aside, asked.target.push, shown=False)
    depth = (bench.session.snapshot().estimates[Method.FREE][40].position - place) @ normal
    assert abs(depth) < 0.6 * abs((estimates[Method.FREE][40].position - place) @ normal)


def test_pokes_made_before_the_skin_was_found_off_its_plan_are_not_off_their_taxels():
    bench = steady(seed=2)
    for row in range(0, 84, 4):
        bench.poke_taxel(row)
        bench.poke_taxel(row)
    assert np.median(np.linalg.norm([bench.diversity(row).beside for row in range(0, 84, 4)], axis=1)) < 0.0008


def rejected(**changes):
    none = np.empty(0, dtype=np.int64)
    force, origin = np.array([0.0, 0.0, -5.0]), np.zeros(3)
    return replace(Rejection(1, 0.0, 1.0, Reason.SLID, 1.0, 0.5, "", none, True, force, origin, np.eye(4)), **changes)


def test_an_axis_is_that_of_the_wrench_in_the_link_frame():
    bench = steady()
    bench.poke_taxel(10)
    axis, (place, normal) = with_axis(bench.contacts[1]), bench.true(int(PLAN.channels[10]))
    assert axis.miss(place) < 0.006
    assert axis.tilt(normal) < np.radians(5.0)
    assert with_axis(rejected(force=None)) is with_axis(rejected(force=np.zeros(3))) is None


def test_a_taxel_that_never_answers_is_given_up_after_three_pokes_at_it():
    bench = steady()
    target = bench.guidance.target
    for _ in range(SETTINGS.unanswered):
        assert target.channel not in bench.guidance.given_up
        assert bench.guidance.target.channel == target.channel
        bench.reject(Reason.NO_TAXEL, target.place, -target.normal)
    assert bench.guidance.given_up == {target.channel: Why.NEVER_FIRED}
    assert bench.guidance.target.channel != target.channel
    place, normal = bench.true(target.channel)
    bench.poke(place, -normal)
    assert not bench.guidance.given_up, "it answers after all"


def test_pokes_elsewhere_do_not_count_as_tries():
    bench = steady()
    target = bench.guidance.target
    for _ in range(2 * SETTINGS.unanswered):
        bench.reject(Reason.NO_TAXEL, target.place + np.array([0.05, 0.0, 0.0]), -target.normal)
        bench.reject(Reason.TOO_SOFT, target.place, -target.normal)
    assert not bench.guidance.given_up
    assert bench.guidance.target.channel == target.channel


def test_excluded_pokes_do_not_count_as_tries():
    bench = steady()
    target = bench.guidance.target
    row = int(np.searchsorted(PLAN.channels, target.channel))
    of_one = (getattr(PLAN, name)[row : row + 1] for name in ("channels", "places", "normals", "modules"))
    alone = Guide(PlannedPlaces(*of_one, spacing=PART.spacing), PART.scene.noise, Method.SURFACE)
    beside = target.place + 0.004 * np.cross(target.normal, [0.0, 0.0, 1.0])

    def given_up():
        estimates = {method: [every[row]] for method, every in bench.session.snapshot().estimates.items()}
        return bench.update(alone, estimates).given_up

    for _ in range(SETTINGS.unanswered):
        assert not given_up()
        contact = bench.press(beside, -target.normal)[0]
        keep = contact.channels != target.channel
        bench.targets[contact.poke] = target
        bench.report(replace(contact, channels=contact.channels[keep], responses=contact.responses[keep]))
    assert given_up() == {target.channel: Why.NEVER_FIRED}
    every = dict(bench.contacts)
    for poke in every:
        bench.session.act(Exclude(poke))
    bench.contacts.clear()
    assert not given_up()
    for poke in every:
        bench.session.act(Restore(poke))
    bench.contacts.update(every)
    assert given_up() == {target.channel: Why.NEVER_FIRED}


def test_slides_lower_the_usable_tilt():
    bench = steady(Method.FREE)
    for _ in range(6):
        target = bench.guidance.target
        bench.reject(Reason.SLID, target.place, tilted(target.normal, 24.0), [target.channel])
    assert bench.guidance.usable_tilt < np.radians(22.0)
    assert bench.guidance.target.tilt <= bench.guidance.usable_tilt + 1e-9


@pytest.mark.parametrize("shown", [True, False])
def test_a_hand_that_misses_the_tilt_of_its_targets_lowers_it(shown):
    bench = steady(Method.FREE)
    while bench.guidance.target.tilt < np.radians(25.0):
        bench.skip()
    target, before = bench.guidance.target, bench.guidance.usable_tilt
    for _ in range(2):
        bench.poke(target.place, -target.normal, shown=shown)
    assert (bench.guidance.usable_tilt < before) is shown


def test_without_enough_tilt_the_free_method_gives_up():
    bench = steady(Method.FREE)
    channel, elsewhere = (int(PLAN.channels[row]) for row in (40, 10))
    for _ in range(SETTINGS.own_pokes):
        bench.poke_taxel(40)
    assert channel not in bench.guidance.given_up
    place, normal = bench.true(elsewhere)
    for _ in range(30):
        if bench.guidance.usable_tilt >= SETTINGS.diversity:
            bench.reject(Reason.SLID, place, tilted(normal, 8.0), [elsewhere])
    assert bench.guidance.usable_tilt < SETTINGS.diversity
    assert bench.guidance.given_up[channel] is Why.TILT


def test_the_hand_is_at_the_newest_poke_whatever_is_restored():
    bench, history = steady(), PokeHistory(PLAN.channels, SETTINGS)

    def hand(*numbers):
        follow(history, {number: bench.contacts[number] for number in numbers})
        return history.hand(PLAN.places)

    assert hand() is None
    for row in (3, 40, 70):
        bench.poke_taxel(row)
    first, second, newest = bench.contacts
    there = hand(first, second, newest)
    assert np.linalg.norm(there - PLAN.places[70]) < PART.spacing
    hand(second, newest)
    np.testing.assert_array_equal(hand(second, newest, first), there)
    assert np.linalg.norm(hand(first, second) - PLAN.places[40]) < PART.spacing


def test_a_poke_that_is_reported_twice_is_counted_once():
    bench = GuidedBench(Method.SURFACE, seed=11)
    first = bench.guidance.target
    bench.poke()
    contact, history = bench.contacts[1], PokeHistory(PLAN.channels, SETTINGS)
    for reported in (contact, replace(contact, tare_change=0.02)):
        follow(history, {1: reported}, {1: first})
        assert history.asked[PLAN.channels == first.channel] == history.asked.sum() == 1
