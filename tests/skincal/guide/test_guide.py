"""The guide over a session: its targets, its needs, and what skips, exclusions and repeated reports do to them."""

from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest
from guided_bench import PART, STEADY, GuidedBench, after, make_guide

from skincal.following.session_guide import SessionGuide
from skincal.guide.guidance import GuidePhase
from skincal.guide.guide import MAX_SKIPS_PER_TAXEL_SIDE
from skincal.guide.progress import GuideSettings, Why
from skincal.guide.robot_order import RobotPace
from skincal.model.actions import Exclude, MarkDead, Restore
from skincal.part.part import lay_part
from skincal.session.session import Session
from skincal.simulation.contacts import PressedPlaces, simulate_contacts
from skincal.simulation.poking_strategies import STRATEGIES, Conditions, errors_of, evaluation_counts, run_course
from skincal.simulation.rig_errors import RigErrors
from skincal.taxels.result import Method, State
from tests.skincal.sim_support import make_rig

CHANNELS, PLACES, MODULES = PART.plan.channels, PART.plan.places, PART.plan.modules


def row_of(channel):
    return int(np.searchsorted(CHANNELS, channel))


def errors(bench, method):
    return errors_of(bench.session.snapshot().estimates[method], bench.rig)


def test_the_first_target_is_on_the_part_with_its_predicted_gain():
    guidance = GuidedBench().guidance
    target = guidance.target
    assert (guidance.phase, guidance.finished) == (GuidePhase.SWEEP, 0)
    np.testing.assert_array_equal(target.place, PLACES[row_of(target.channel)])
    assert -target.push @ target.normal == pytest.approx(np.cos(target.tilt))
    assert target.tilt <= np.radians(28.0) + 1e-9
    assert 0 < target.rms_after < target.rms_now


def test_ninety_pokes_bring_the_free_method_to_five_millimetres_by_short_ways():
    bench = after(96)
    assert errors(bench, Method.FREE).mean() < 0.0055
    assert len(set(bench.asked)) > 50
    places = PLACES[[row_of(channel) for channel in bench.asked]]
    assert np.median(np.linalg.norm(np.diff(places, axis=0), axis=1)) < 0.03


def test_on_a_surface_each_taxel_has_its_turn_before_any_is_repeated():
    bench, had = GuidedBench(Method.SURFACE), set()
    assert bench.guidance.phase is GuidePhase.OWN
    while waiting := {c for c, own in zip(CHANNELS.tolist(), bench.guidance.own.tolist(), strict=True) if not own} - had:
        target, pokes = bench.guidance.target.channel, len(bench.contacts)
        assert target in waiting
        bench.poke()
        # A poke that no taxel answered is none: the target stays.
        had |= {target} if len(bench.contacts) > pokes else set()
    assert 50 < len(had) <= 84


@pytest.mark.parametrize(("method", "pokes"), [(Method.FREE, 60), (Method.SURFACE, 240)])
def test_a_guide_made_later_knows_the_same(method, pokes):
    bench = after(pokes, method)
    opened = bench.update(make_guide(method))
    np.testing.assert_array_equal(opened.own, bench.guidance.own)
    np.testing.assert_allclose(opened.diversity, bench.guidance.diversity, atol=1e-12)
    np.testing.assert_allclose(opened.places, bench.guidance.places, atol=1e-12)
    np.testing.assert_array_equal(opened.rms, bench.guidance.rms)
    assert opened.needs == bench.guidance.needs


def test_an_excluded_poke_that_is_restored_leaves_no_trace():
    bench = GuidedBench(seed=3)
    for _ in range(40):
        bench.poke()
    before = bench.guidance
    bench.session.act(Exclude(17))
    gone = bench.contacts.pop(17)
    without = bench.look()
    assert (without.own != before.own).any() or (without.diversity != before.diversity).any()
    bench.session.act(Restore(17))
    bench.contacts[17] = gone
    again = bench.look()
    np.testing.assert_array_equal(again.own, before.own)
    np.testing.assert_array_equal(again.diversity, before.diversity)
    assert again.needs == before.needs


def test_a_side_that_is_skipped_twice_is_left_out_and_worth_nothing():
    bench = GuidedBench(seed=5)
    first = bench.guidance.target
    open_ = bench.diversity(row_of(first.channel))
    assert (open_.worth > 0).all()
    for _ in range(MAX_SKIPS_PER_TAXEL_SIDE):
        bench.guide.skip(first)
    axes = bench.diversity(row_of(first.channel))
    np.testing.assert_array_equal(axes.worth == 0.0, axes.tried @ first.push > np.cos(np.radians(25.0)))
    np.testing.assert_array_equal(axes.worth[axes.worth > 0], open_.worth[axes.worth > 0])
    assert bench.look().target.channel != first.channel
    for _ in range(60):
        target = bench.guidance.target
        assert not (target.channel == first.channel and target.push @ first.push > 0.99)
        bench.poke()


def test_a_dead_taxel_is_no_target():
    bench = GuidedBench(seed=7)
    dead = bench.guidance.target.channel
    bench.session.act(MarkDead(dead))
    bench.look()
    for _ in range(30):
        assert bench.guidance.target.channel != dead
        bench.poke()


def test_the_target_stays_while_a_poke_is_reported_again():
    bench = GuidedBench()
    for _ in range(12):
        bench.poke()
        target, newest = bench.guidance.target, max(bench.contacts)
        before = bench.contacts[newest]
        for report in (replace(before, force=before.force + np.array([0.3, -0.2, 0.1]), tare_change=0.3), before):
            bench.report(report)
            assert bench.look().target.channel == target.channel
            assert bench.guidance.target.push @ target.push == pytest.approx(1.0)
    first = bench.guidance.target
    assert bench.skip().target.channel != first.channel


def test_a_poke_on_another_taxel_counts_for_that():
    bench = GuidedBench(seed=9)
    elsewhere = (row_of(bench.guidance.target.channel) + 40) % 84
    bench.poke(PLACES[elsewhere])
    hit = next(iter(bench.contacts.values())).strongest_channel
    assert bench.guidance.own[row_of(hit)] == 1


def test_doubted_contacts_count_less_at_their_taxel_alone():
    bench, plain, doubting = after(60), make_guide(), make_guide()
    estimates, row = dict(bench.session.snapshot().estimates), int(bench.guidance.own.argmax())
    # By the contacts alone: the solver's own error would count where it is larger.
    trusting = [each if each.rms is None else replace(each, rms=1e-6) for each in estimates[Method.FREE]]
    mistrusted = list(trusting)
    strongest = bench.session.snapshot().evidence([mistrusted[row].channel]).pokes[:2].tolist()
    mistrusted[row] = replace(mistrusted[row], doubted=dict.fromkeys(strongest, 0.0))
    bench.update(plain, {**estimates, Method.FREE: trusting})
    bench.update(doubting, {**estimates, Method.FREE: mistrusted})
    beside = np.linalg.norm(bench.guidance.places - bench.guidance.places[row], axis=1)
    for at, share in ((row, 1.05), (int(beside.argmax()), 1.0)):
        channel = int(bench.guidance.channels[at])
        worth = [each.axis_diversity(channel, bench.session.snapshot()).worth.max() for each in (plain, doubting)]
        assert worth[1] > share * worth[0] if at == row else worth[1] == worth[0]


def test_enough_is_said_if_nothing_is_needed():
    bench = after(60)
    estimates = dict(bench.session.snapshot().estimates)
    known = (replace(each, state=State.TOUCHED, rms=1e-3, rival=None) for each in estimates[Method.SURFACE])
    estimates[Method.SURFACE] = tuple(known)
    content = GuideSettings(own_pokes=0, balance=float("inf"), settled=float("inf"))
    guidance = bench.update(make_guide(Method.SURFACE, settings=content), estimates)
    assert (guidance.phase, guidance.target, guidance.finished) == (GuidePhase.ENOUGH, None, 84)


@pytest.mark.parametrize("way", [*STRATEGIES, "guided"])
def test_a_course_is_the_same_each_time_and_gets_better(way):
    one, two = (run_course(PART, way, Method.SURFACE, Conditions(), 2, 60) for _ in range(2))
    np.testing.assert_array_equal(one.mean, two.mean)
    np.testing.assert_array_equal(one.seconds, two.seconds)
    assert one.pokes.tolist() == evaluation_counts(60).tolist()
    assert one.mean[-1] < one.mean[0]
    assert (np.diff(one.seconds) > 0).all()
    assert one.falsely <= one.done


def test_a_threshold_is_reached_once_the_error_stays_below_it():
    course = run_course(PART, "round_robin", Method.SURFACE, Conditions(), 2, 120)
    place = int(np.searchsorted(course.pokes, course.pokes_to(0.02)))
    assert (course.mean[place:] <= 0.02).all()
    assert course.mean[place - 1] > 0.02
    assert course.pokes_to(1e-6) == float("inf")


def test_the_axis_diversity_of_a_taxel_describes_its_contacts():
    bench = after(60)
    says = bench.guidance
    for row in np.flatnonzero(says.own >= 2)[:5].tolist():
        axes, channel = bench.diversity(row), int(says.channels[row])
        touching = [contact for contact in bench.contacts.values() if channel in contact.channels]
        assert (len(axes.pushes), int(axes.own.sum()), axes.diversity) == (len(touching), says.own[row], says.diversity[row])
        # In any order: each axis is a contact's, in the link frame.
        turned = [c.link_from_sensor[:3, :3] @ c.force / np.linalg.norm(c.force) for c in touching]
        assert np.sort(axes.pushes @ turned[0]) == pytest.approx(np.sort([u @ turned[0] for u in turned]))
        np.testing.assert_allclose(axes.offsets @ axes.normal, 0.0, atol=1e-12)
        assert np.linalg.norm(axes.beside) < 0.01
        assert np.linalg.norm(axes.offsets, axis=1).max() < 0.015
    fresh = GuidedBench()
    assert make_guide().axis_diversity(0, fresh.session.snapshot()) is None, "before the first update"
    assert fresh.diversity(row_of(fresh.guidance.target.channel)).pushes.shape == (0, 3)
    assert fresh.guide.axis_diversity(10**6, fresh.session.snapshot()) is None


@pytest.mark.parametrize("pokes", [3, 60, 150])
def test_the_target_is_the_push_of_the_largest_gain(pokes):
    bench = after(pokes, seed=2 if pokes == 3 else 1)
    axes = bench.diversity(row_of(bench.guidance.target.channel))
    np.testing.assert_array_equal(axes.tried[axes.worth.argmax()], bench.guidance.target.push)
    assert axes.worth.max() > 0
    assert axes.usable_tilt == bench.guidance.usable_tilt


# ---- modules ----


def test_modules_are_enough_after_ten_pokes_each():
    bench = GuidedBench(Method.MODULES)
    while bench.guidance.phase is not GuidePhase.ENOUGH and bench.count < 90:
        bench.poke()
    assert (bench.guidance.phase, bench.guidance.finished) == (GuidePhase.ENOUGH, 84)
    assert 56 <= len(bench.contacts) <= 84
    assert np.mean(errors(bench, Method.MODULES) > 0.003) < 0.02


@pytest.mark.parametrize("seed", [1, 2, 3])
def test_modules_take_turns_and_the_pokes_of_one_are_far_apart(seed):
    """Side by side they do not show its turn: 34 pokes to 3 mm instead of 18, over ten seeds."""
    bench = GuidedBench(Method.MODULES, seed)
    for _ in range(21):
        bench.poke()
    rows = np.array([row_of(channel) for channel in bench.asked])
    assert np.bincount(MODULES[rows], minlength=7).min() >= 2
    for module in range(7):
        places, wide = PLACES[rows[MODULES[rows] == module]], PLACES[module == MODULES]
        apart = np.linalg.norm(places[:, None] - places, axis=2)[np.triu_indices(len(places), 1)]
        assert apart.max() > 0.75 * np.linalg.norm(wide[:, None] - wide, axis=2).max()
    assert np.median(errors(bench, Method.MODULES)) < 0.004


def test_a_taxel_that_is_missed_twice_gives_way_to_another_of_its_module():
    bench = GuidedBench(Method.MODULES)
    home = MODULES[row_of(bench.guidance.target.channel)]
    elsewhere = PLACES[np.flatnonzero((home + 3) % 7 == MODULES)[4]]
    own, shunned = [], None
    for _ in range(30):
        channel = bench.guidance.target.channel
        if MODULES[row_of(channel)] == home:
            own.append(channel)
            shunned = channel if len(own) == 2 else shunned
        bench.poke(elsewhere if channel == shunned else None)
    assert own.count(shunned) == 2
    assert len(set(own)) >= 4


def test_a_module_that_is_never_hit_is_given_up_although_it_answers_its_neighbours_pokes():
    bench = GuidedBench(Method.MODULES, conditions=STEADY)
    home = MODULES[row_of(bench.guidance.target.channel)] == MODULES
    gaps = np.linalg.norm(PLACES[:, None] - PLACES, axis=2) + 1.0 * (home[:, None] == home)
    for channel in CHANNELS[home & (gaps.min(axis=1) > 0.0075)].tolist():
        bench.session.act(MarkDead(channel))
    while bench.look().phase is not GuidePhase.ENOUGH:
        channel = bench.guidance.target.channel
        place, other = (bench.true(CHANNELS[row])[0] for row in (row_of(channel), gaps[row_of(channel)].argmin()))
        bench.poke(place + (0.6 if home[row_of(channel)] else 0.0) * (other - place))
        assert bench.count < 120
    assert {Why.NOT_CONVERGED} < {*bench.guidance.given_up.values(), None}
    assert home[[row_of(channel) for channel in bench.guidance.given_up]].all()


def test_a_skip_leads_to_another_module():
    bench, homes = GuidedBench(Method.MODULES), []
    for _ in range(7):
        homes.append(int(MODULES[row_of(bench.guidance.target.channel)]))
        bench.skip()
    assert sorted(homes) == list(range(7))


def test_modules_without_a_mesh_are_pushed_from_all_sides():
    """Parallel axes leave the depth blind."""
    bench = GuidedBench(Method.MODULES)
    bench.guide = make_guide(Method.MODULES, replace(PART.plan, on_surface=False))
    bench.look()
    pushes = {module: [] for module in range(7)}
    for _ in range(24):
        target = bench.guidance.target
        assert np.radians(9.9) < target.tilt < np.radians(28.1)
        pushes[int(MODULES[row_of(target.channel)])].append(target.push)
        bench.poke()
    for own in pushes.values():
        assert np.degrees(np.arccos(np.clip((np.array(own) @ np.array(own).T).min(), -1.0, 1.0))) > 25.0


def test_a_flat_patch_without_a_mesh_is_finished_by_about_the_predicted_number_of_pokes():
    rig, rng = make_rig(RigErrors.noise(), 0, "flat-patch"), np.random.default_rng(5)
    session, guide = Session(rig.scene, None), SessionGuide(lay_part(rig.scene, None, ()))
    stance, pokes = rig.arm_pose(), 0

    def follow():
        pose = stance.name, stance.reported
        return guide.next_target(session.snapshot(), pose, Method.MODULES, 100.0)

    predicted = guide.costs[Method.MODULES]
    while not (guidance := follow()).enough:
        pokes += 1
        place = np.append(guidance.target.place[:2] + 0.0015 * rng.standard_normal(2), 0.0)
        push = guidance.target.push + np.append(np.radians(5.0) * rng.standard_normal(2), 0.0)
        pressed = PressedPlaces(
            np.zeros(1, dtype=np.int64), place[None], np.array([[0.0, 0.0, 1.0]]), push[None] / np.linalg.norm(push),
            rng.uniform(6.0, 12.0, 1), rng.uniform(0.0, np.pi / 2, 1),
        )  # fmt: skip
        for contact in simulate_contacts(rig, pressed, rng, first_poke=pokes):
            session.add(contact)
    assert 0.75 * predicted < pokes < 1.25 * predicted
    done = np.array([not needs for needs in guidance.needs])
    assert done.mean() > 0.9
    assert np.max(errors_of(session.snapshot().estimates[Method.MODULES], rig)[done]) < 0.003


def test_an_impossible_side_is_left_out_after_one_skip():
    bench = GuidedBench(seed=5)
    first = bench.guidance.target
    bench.guide.skip(first, is_impossible=True)
    worth = bench.diversity(row_of(first.channel))
    np.testing.assert_array_equal(worth.worth == 0.0, worth.tried @ first.push > np.cos(np.radians(25.0)))


def course_of(method, robot, pokes, sweep):
    bench = GuidedBench(method, conditions=STEADY)
    bench.guide.settings = replace(bench.guide.settings, sweep=sweep)
    bench.guide.robot, bench.guide._kept = robot, None
    bench.look()
    return [(bench.guidance.target, bench.poke())[0] for _ in range(pokes)]


def test_a_robot_makes_the_first_own_pokes_of_a_taxel_in_a_row_with_several_tilts():
    """From the start; by the free method a hand goes elsewhere after each poke."""
    robot, hand = (course_of(Method.FREE, pace, 30, sweep=0.0) for pace in (RobotPace(0.1, 3.0), None))
    stays = [[a.channel == b.channel for a, b in pairwise(course)] for course in (robot, hand)]
    assert np.mean(stays[0]) > 0.5 > np.mean(stays[1])
    turned = [a.push @ b.push for a, b in pairwise(robot) if a.channel == b.channel]
    assert np.median(turned) < np.cos(np.radians(15.0))


@pytest.mark.parametrize("method", [Method.SURFACE, Method.MODULES])
def test_by_the_other_methods_a_robot_gets_the_targets_of_a_hand_to_the_last_bit(method):
    robot, hand = (course_of(method, pace, 25, sweep=1.5) for pace in (RobotPace(0.1, 3.0), None))
    for a, b in zip(robot, hand, strict=True):
        assert a.channel == b.channel
        np.testing.assert_array_equal(a.place, b.place)
        np.testing.assert_array_equal(a.push, b.push)
