"""The guide over a session: what it asks, and what becomes of it."""

from dataclasses import replace
from functools import cache

import numpy as np
import pytest

from skincal.guide import candidates
from skincal.guide.guidance import GuidePhase
from skincal.guide.guide import SKIPPED, Guide
from skincal.guide.poke_history import PokeHistory
from skincal.guide.progress import GuideSettings
from skincal.model.actions import Exclude, MarkDead, Restore
from skincal.session.session import Session
from skincal.simulate.benches import Bench
from skincal.simulate.courses import WAYS, Conditions, MeantPokes, errors_of, looks, poked, rig_beside, run_course
from skincal.taxels.result import Method, State


@cache
def part():
    return Bench()


def guide(method=Method.FREE):
    return Guide(part().plan, part().scene.noise, method, part().spacing)


class Followed:
    """A session whose operator does what the guide asks."""

    def __init__(self, method=Method.FREE, seed=1):
        solved = (Method.FREE, Method.SURFACE, *((method,) if method is Method.MODULES else ()))
        self.session, self.guide = Session(part().scene, part().surface, solved), guide(method)
        self.rig, self.rng = rig_beside(part(), Conditions(), seed), np.random.default_rng(seed)
        self.contacts = {}
        self.guidance = self.look()
        self.asked = []

    def look(self):
        return self.guide.update(self.contacts, self.session.snapshot().estimates, self.session.evidence)

    def poke(self, place=None):
        target = self.guidance.target
        self.asked.append(target.channel)
        meant = MeantPokes((target.place if place is None else place)[None], target.push[None])
        for contact in poked(part(), self.rig, meant, Conditions(), self.rng, self.session.last_poke + 1)[0]:
            self.session.add(contact)
            self.contacts[contact.poke] = contact
        self.guidance = self.look()
        return self


@cache
def after(pokes, method=Method.FREE):
    followed = Followed(method)
    for _ in range(pokes):
        followed.poke()
    return followed


def test_the_first_target_stands_on_the_part_and_says_what_it_gains():
    guidance = Followed().guidance
    target = guidance.target
    assert guidance.phase is GuidePhase.SWEEP
    assert guidance.done == 0
    row = int(np.flatnonzero(guidance.channels == target.channel)[0])
    np.testing.assert_array_equal(target.place, part().plan.places[row])
    assert np.linalg.norm(target.push) == pytest.approx(1.0)
    assert -target.push @ target.normal == pytest.approx(np.cos(target.tilt))
    assert target.tilt <= np.radians(28.0) + 1e-9
    assert 0 < target.after < target.before


def test_ninety_pokes_bring_the_free_method_to_five_millimetres():
    followed = after(96)
    errors = errors_of(followed.session.snapshot().estimates[Method.FREE], followed.rig)
    assert errors.mean() < 0.0055
    assert len(set(followed.asked)) > 50
    # Targets lie near each other: a third of the part's length is seldom crossed.
    places = {int(c): p for c, p in zip(part().plan.channels, part().plan.places, strict=True)}
    steps = [np.linalg.norm(places[a] - places[b]) for a, b in zip(followed.asked, followed.asked[1:], strict=False)]
    assert np.median(steps) < 0.03


def test_on_a_surface_no_taxel_is_asked_for_again_before_all_had_their_turn():
    followed, had = Followed(Method.SURFACE), set()
    assert followed.guidance.phase is GuidePhase.OWN
    while True:
        own = zip(followed.guidance.channels.tolist(), followed.guidance.own.tolist(), strict=True)
        waiting = {channel for channel, count in own if count == 0} - had
        if not waiting:
            break
        target, pokes = followed.guidance.target.channel, len(followed.contacts)
        assert target in waiting, "neither poked nor asked for"
        followed.poke()
        # A poke that no taxel answered is no poke: the target stays.
        had |= {target} if len(followed.contacts) > pokes else set()
    assert 50 < len(had) <= 84


@pytest.mark.parametrize(("method", "pokes"), [(Method.FREE, 60), (Method.SURFACE, 240)])
def test_a_session_that_is_opened_at_once_knows_what_a_followed_one_knows(method, pokes):
    followed = after(pokes, method)
    opened = guide(method).update(followed.contacts, followed.session.snapshot().estimates, followed.session.evidence)
    np.testing.assert_array_equal(opened.own, followed.guidance.own)
    np.testing.assert_allclose(opened.diversity, followed.guidance.diversity, atol=1e-12)
    np.testing.assert_allclose(opened.places, followed.guidance.places, atol=1e-12)
    np.testing.assert_array_equal(opened.rms, followed.guidance.rms)
    assert opened.needs == followed.guidance.needs


def test_a_poke_that_is_taken_out_and_put_in_again_leaves_no_trace():
    followed = Followed(seed=3)
    for _ in range(40):
        followed.poke()
    before = followed.guidance
    followed.session.act(Exclude(17))
    gone = followed.contacts.pop(17)
    without = followed.look()
    assert (without.own != before.own).any() or (without.diversity != before.diversity).any()
    followed.session.act(Restore(17))
    followed.contacts[17] = gone
    again = followed.look()
    np.testing.assert_array_equal(again.own, before.own)
    np.testing.assert_array_equal(again.diversity, before.diversity)
    assert again.needs == before.needs


def test_a_target_that_is_skipped_gives_way_to_another():
    followed = Followed(seed=5)
    first = followed.guidance.target
    followed.guide.skip()
    assert followed.look().target.channel != first.channel


def test_a_side_that_is_skipped_twice_is_asked_for_no_more():
    followed = Followed(seed=5)
    first = followed.guidance.target
    for _ in range(SKIPPED):
        followed.guide.skip()
    followed.guidance = followed.look()
    for _ in range(60):
        target = followed.guidance.target
        assert not (target.channel == first.channel and target.push @ first.push > 0.99)
        followed.poke()


def test_a_dead_taxel_is_never_asked_for():
    followed = Followed(seed=7)
    dead = followed.guidance.target.channel
    followed.session.act(MarkDead(dead))
    followed.guidance = followed.look()
    for _ in range(30):
        assert followed.guidance.target.channel != dead
        followed.poke()


def test_a_poke_that_is_reported_twice_is_asked_for_once():
    followed = Followed(Method.SURFACE, seed=11)
    first = followed.guidance.target
    followed.poke()
    number, contact = next(iter(followed.contacts.items()))
    target = followed.guidance.target.channel
    again = replace(contact, tare_change=0.02)
    followed.session.add(again)
    followed.contacts[number] = again
    assert followed.look().target.channel == target
    history, plan = PokeHistory(part().plan.channels, GuideSettings()), part().plan
    pulls = candidates.answer_offsets(plan.places, candidates.find_answering(plan.places, part().spacing, part().scene.noise))
    for reported in (contact, again):
        history.follow({number: reported}, {}, first, plan.places, plan.normals, pulls)
        assert history.asked[plan.channels == first.channel] == history.asked.sum() == 1


def test_a_poke_on_another_taxel_counts_where_it_landed():
    followed = Followed(seed=9)
    row = int(np.flatnonzero(part().plan.channels == followed.guidance.target.channel)[0])
    elsewhere = (row + 40) % 84
    followed.poke(part().plan.places[elsewhere])
    peak = next(iter(followed.contacts.values()))
    hit = int(peak.channels[peak.responses.argmax()])
    assert followed.guidance.own[np.flatnonzero(part().plan.channels == hit)[0]] == 1


def test_what_is_doubted_counts_less_for_the_guide():
    followed = after(60)
    estimates, plain, doubting = followed.session.snapshot().estimates, guide(), guide()
    row = int(followed.guidance.own.argmax())
    # By the contacts alone: where a taxel's pokes miss by more than the scene's noise, its own error says what is known.
    trusting = [each if each.rms is None else replace(each, rms=1e-6) for each in estimates[Method.FREE]]
    estimates, mistrusted = {**estimates, Method.FREE: trusting}, list(trusting)
    strongest: list[int] = followed.session.evidence([mistrusted[row].channel]).pokes[:2].tolist()
    mistrusted[row] = replace(mistrusted[row], doubted=dict.fromkeys(strongest, 0.0))
    plain.update(followed.contacts, estimates, followed.session.evidence)
    doubting.update(followed.contacts, {**estimates, Method.FREE: mistrusted}, followed.session.evidence)
    # What is known less is worth more to poke; only around the taxel, since a poke on one tells of its neighbours.
    beside = np.linalg.norm(followed.guidance.places - followed.guidance.places[row], axis=1)
    for at, share in ((row, 1.05), (int(beside.argmax()), 1.0)):
        channel = int(followed.guidance.channels[at])
        worth = [each.axis_diversity(channel, followed.session.evidence).worth.max() for each in (plain, doubting)]
        assert worth[1] > share * worth[0] if at == row else worth[1] == worth[0]


def test_where_everything_is_done_it_says_so():
    followed = after(60)
    estimates = dict(followed.session.snapshot().estimates)
    known = (replace(each, state=State.ESTIMATED, rms=1e-3, rival=None) for each in estimates[Method.SURFACE])
    estimates[Method.SURFACE] = tuple(known)
    content = GuideSettings(own_pokes=0, balance=float("inf"), settled=float("inf"))
    easy = Guide(part().plan, part().scene.noise, Method.SURFACE, part().spacing, content)
    guidance = easy.update(followed.contacts, estimates, followed.session.evidence)
    assert guidance.phase is GuidePhase.ENOUGH
    assert guidance.target is None
    assert guidance.done == 84


@pytest.mark.parametrize("way", [*WAYS, "guided", "diversity", "optimal"])
def test_a_course_is_the_same_each_time_and_gets_better(way):
    one, two = (run_course(part(), way, Method.SURFACE, Conditions(), 2, 60) for _ in range(2))
    np.testing.assert_array_equal(one.mean, two.mean)
    np.testing.assert_array_equal(one.seconds, two.seconds)
    assert one.pokes.tolist() == looks(60).tolist()
    assert one.mean[-1] < one.mean[0]
    assert (np.diff(one.seconds) > 0).all()
    assert one.falsely <= one.done


def test_a_threshold_is_reached_where_the_error_stays_below_it():
    course = run_course(part(), "round_robin", Method.SURFACE, Conditions(), 2, 120)
    at = course.pokes_to(0.02)
    place = int(np.searchsorted(course.pokes, at))
    assert (course.mean[place:] <= 0.02).all()
    assert course.mean[place - 1] > 0.02
    assert course.pokes_to(1e-6) == float("inf")


def test_the_axis_diversity_of_a_taxel_is_what_its_contacts_say_of_it():
    followed = after(60)
    says, contacts = followed.guidance, followed.contacts
    for channel in says.channels[says.own >= 2].tolist()[:5]:
        axes = followed.guide.axis_diversity(channel, followed.session.evidence)
        assert axes is not None
        touching = {p: c for p, c in contacts.items() if channel in c.channels}
        assert len(axes.pushes) == len(touching)
        row = says.channels.tolist().index(channel)
        assert int(axes.own.sum()) == says.own[row]
        assert axes.diversity == says.diversity[row]
        # In any order: each axis is a contact's, turned into the link frame.
        turned = [c.link_from_sensor[:3, :3] @ c.force / np.linalg.norm(c.force) for c in touching.values()]
        assert np.sort(axes.pushes @ turned[0]) == pytest.approx(np.sort([u @ turned[0] for u in turned]))
        assert (axes.trust <= 1.0).all()
        assert axes.normal @ axes.normal == pytest.approx(1.0)
        np.testing.assert_allclose(axes.offsets @ axes.normal, 0.0, atol=1e-12)
        assert np.linalg.norm(axes.beside) < 0.01
        # Where one taxel answered alone, the poke was at it by all that is known.
        assert np.linalg.norm(axes.offsets, axis=1).max() < 0.015


@pytest.mark.parametrize("pokes", [3, 60, 150])
def test_the_push_worth_most_at_the_target_is_the_one_that_is_asked_for(pokes):
    followed = Followed(seed=2) if pokes == 3 else after(pokes)
    for _ in range(3 if pokes == 3 else 0):
        followed.poke()
    target = followed.guidance.target
    axes = followed.guide.axis_diversity(target.channel, followed.session.evidence)
    assert axes is not None
    np.testing.assert_array_equal(axes.tried[axes.worth.argmax()], target.push)
    assert axes.worth.max() > 0
    assert axes.usable_tilt == followed.guidance.usable_tilt


def test_a_taxel_without_contacts_has_an_empty_axis_diversity_and_an_unknown_channel_none():
    followed = Followed()
    assert guide().axis_diversity(0, followed.session.evidence) is None, "nothing is known yet"
    target = followed.guidance.target
    axes = followed.guide.axis_diversity(target.channel, followed.session.evidence)
    assert axes is not None
    assert (axes.pushes.shape, axes.offsets.shape, axes.own.shape, axes.diversity) == ((0, 3), (0, 3), (0,), 0.0)
    assert followed.guide.axis_diversity(10**6, followed.session.evidence) is None


def test_a_side_that_was_skipped_is_worth_nothing():
    followed = Followed(seed=3)
    first = followed.guidance.target
    open_ = followed.guide.axis_diversity(first.channel, followed.session.evidence)
    assert open_ is not None
    assert (open_.worth > 0).all()
    for _ in range(SKIPPED):
        followed.guide.skip()
    axes = followed.guide.axis_diversity(first.channel, followed.session.evidence)
    assert axes is not None
    np.testing.assert_array_equal(axes.worth == 0.0, axes.tried @ first.push > np.cos(np.radians(25.0)))
    np.testing.assert_array_equal(axes.worth[axes.worth > 0], open_.worth[axes.worth > 0])


def test_modules_are_enough_after_few_pokes_each_and_the_guide_goes_from_one_to_the_next():
    followed = Followed(Method.MODULES)
    for _ in range(90):
        if followed.guidance.phase is GuidePhase.ENOUGH:
            break
        followed.poke()
    assert followed.guidance.phase is GuidePhase.ENOUGH
    assert followed.guidance.done == 84
    # Eight to twelve pokes for each of the seven modules.
    assert 56 <= len(followed.contacts) <= 84
    errors = errors_of(followed.session.snapshot().estimates[Method.MODULES], followed.rig)
    assert np.mean(errors > 0.003) < 0.02


@pytest.mark.parametrize("seed", [1, 2, 3])
def test_modules_take_turns_and_the_pokes_of_one_lie_far_apart(seed):
    """Side by side they do not say how it is turned: 34 pokes to 3 mm instead of 18, over ten seeds."""
    followed, plan = Followed(Method.MODULES, seed), part().plan
    for _ in range(21):
        followed.poke()
    rows = np.searchsorted(plan.channels, followed.asked)
    # A poke that falls on a neighbour's taxel is its turn.
    assert np.bincount(plan.modules[rows], minlength=7).min() >= 2
    for module in range(7):
        places = plan.places[rows[plan.modules[rows] == module]]
        apart = np.linalg.norm(places[:, None] - places, axis=2)[np.triu_indices(len(places), 1)]
        wide = plan.places[plan.modules == module]
        assert apart.max() > 0.75 * np.linalg.norm(wide[:, None] - wide, axis=2).max()
    errors = errors_of(followed.session.snapshot().estimates[Method.MODULES], followed.rig)
    assert np.median(errors) < 0.004


def test_a_taxel_that_is_asked_for_in_vain_gives_way_to_another_of_its_module():
    """The hand never gets to the second taxel that is asked for of the first module, but to one of another module."""
    followed, plan = Followed(Method.MODULES), part().plan
    home = plan.modules[np.searchsorted(plan.channels, followed.guidance.target.channel)]
    elsewhere = plan.places[np.flatnonzero(plan.modules == (home + 3) % 7)[4]]
    own, shunned = [], None
    for _ in range(30):
        channel = followed.guidance.target.channel
        if plan.modules[np.searchsorted(plan.channels, channel)] == home:
            own.append(channel)
            shunned = channel if len(own) == 2 else shunned
        followed.poke(elsewhere if channel == shunned else None)
    assert own.count(shunned) == 2
    assert len(set(own)) >= 4


def test_a_skip_leads_to_another_module():
    followed, plan = Followed(Method.MODULES), part().plan
    homes = []
    for _ in range(7):
        homes.append(int(plan.modules[np.searchsorted(plan.channels, followed.guidance.target.channel)]))
        followed.guide.skip()
        followed.guidance = followed.look()
    assert sorted(homes) == list(range(7))


def test_modules_in_space_are_pushed_from_all_sides():
    """Parallel axes leave the depth blind where no mesh gives it."""
    followed, plan = Followed(Method.MODULES), part().plan
    followed.guide = Guide(plan, part().scene.noise, Method.MODULES, part().spacing, on_surface=False)
    followed.guidance, pushes = followed.look(), {module: [] for module in range(7)}
    for _ in range(24):
        target = followed.guidance.target
        # How far is what the hand manages.
        assert np.radians(9.9) < target.tilt < np.radians(28.1)
        pushes[int(plan.modules[np.searchsorted(plan.channels, target.channel)])].append(target.push)
        followed.poke()
    for own in pushes.values():
        # One that fell on another module is asked for again from the same side.
        assert np.degrees(np.arccos(np.clip((np.array(own) @ np.array(own).T).min(), -1.0, 1.0))) > 25.0
