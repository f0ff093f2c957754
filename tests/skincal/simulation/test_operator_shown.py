"""An operator who is shown a target: where it goes, when it looks, and what it does where it is shown none."""

from dataclasses import replace

import numpy as np
import pytest

from skincal.contacts.outcome import Reason
from skincal.geometry import move_wrench
from skincal.mesh.search import nearest_points
from skincal.model.errors import InputError
from skincal.model.readings import Chunk, LinkEvent, LinkState
from skincal.model.scene import Landmark
from skincal.robot.target_client import read_line
from skincal.robot.target_lines import Answer, AnswerKind, NoTarget, PokeTarget, write_line
from skincal.session.landmark_pokes import landmark_pokes
from skincal.session.pipeline import Pipeline
from skincal.simulation.device import DeviceTimeline
from skincal.simulation.operator import (
    AutoOperator,
    GuidedOperator,
    Habits,
    Move,
    PaceOrder,
    PokeOrder,
    PoseOrder,
    ScriptedOperator,
)
from skincal.simulation.rig_errors import RigErrors
from skincal.simulation.simulated_rig import tangents
from skincal.streams.links import LinkSpec
from tests.approved import approved_pattern
from tests.skincal.sim_support import ask_on, make_rig

FOLLOWS = replace(Habits.careful(), ignores=0.0)
STEP = 0.01


@pytest.fixture(scope="module")
def rig():
    return make_rig(RigErrors.none())


def target_at(rig, channel, beside=0.0, tilt=0.0):
    """The target that shows a taxel `beside` metres off, pushed at a tilt."""
    row = rig.row_of(channel)
    normal = rig.normals[row]
    across = tangents(normal[None])[0][0]
    return PokeTarget(1, channel, rig.places[row] + beside * across, np.sin(tilt) * across - np.cos(tilt) * normal)


def presses(operator, count, tell=None):
    """Play an operator as a time line does; `tell(now)` is called before it is asked. What it reached is asked for again."""
    now, done = 0.0, []
    if isinstance(operator, GuidedOperator):
        ask_on(operator)
    while len(done) < count:
        if tell is not None:
            tell(now)
        action = operator.next(now)
        now = now + STEP if action is None else action.free
        assert now < 10_000
        if action is not None:
            done.append(action)
    return done


def same(one, other):
    return all(
        a.begin == b.begin and a.free == b.free and (a.pokes.points == b.pokes.points).all() and (a.slide == b.slide).all()
        for a, b in zip(one, other, strict=True)
    )


def test_nobody_tells_it_anything_and_it_pokes_as_auto_does(rig):
    guided, auto = (kind(rig, Habits(), np.random.default_rng(4)) for kind in (GuidedOperator, AutoOperator))
    assert same(presses(guided, 200), presses(auto, 200))
    guided.show(NoTarget.ANY)
    assert same(presses(guided, 20), presses(auto, 20))


@pytest.mark.parametrize("name", ["icub-forearm", "flat-patch"])
def test_it_pokes_where_the_ring_is_and_not_where_the_taxel_is(name):
    rig = make_rig(RigErrors.none(), name=name)
    channel = int(rig.channels[20])
    shown = target_at(rig, channel, beside=0.010, tilt=np.radians(20))
    ring = shown.place if rig.surface is None else nearest_points(rig.surface, shown.place[None])[0][0]
    # The ring lies on the part, though the place that is believed is 4 mm above it.
    above = PokeTarget(1, channel, ring + 0.004 * rig.normals[rig.row_of(channel)], shown.push)
    guided = GuidedOperator(rig, FOLLOWS, np.random.default_rng(1))
    guided.show(above)
    done = presses(guided, 300)
    points = np.concatenate([p.pokes.points for p in done])
    if rig.surface is not None:
        np.testing.assert_allclose(nearest_points(rig.surface, points)[0], points, atol=1e-9)
    else:
        np.testing.assert_allclose(points[:, 2], rig.places[0, 2], atol=1e-12)
    off = points - ring
    assert np.linalg.norm(off.mean(axis=0)) < 0.0015
    assert np.sqrt(np.mean(np.sum(off**2, axis=1))) == pytest.approx(0.002 * np.sqrt(2), rel=0.15)
    pushes, normals = (np.concatenate([getattr(p.pokes, k) for p in done]) for k in ("directions", "normals"))
    leans = np.degrees(np.arccos(np.clip(pushes @ shown.push, -1, 1)))
    assert np.sqrt(np.mean(leans**2)) == pytest.approx(6.0 * np.sqrt(2), rel=0.2)
    assert np.degrees(np.arccos(-np.sum(pushes * normals, axis=1))).max() <= 30.0 + 1e-6


def test_a_place_without_a_taxel_is_poked_too(rig):
    guided = GuidedOperator(rig, FOLLOWS, np.random.default_rng(1))
    shown = replace(target_at(rig, 204, beside=0.003), channel=None)
    guided.show(shown)
    done = presses(guided, 100)
    off = np.concatenate([p.pokes.points for p in done]) - nearest_points(rig.surface, shown.place[None])[0]
    assert np.linalg.norm(off.mean(axis=0)) < 0.001


@pytest.mark.parametrize("name", ["icub-forearm", "flat-patch"])
def test_a_known_point_is_poked_at_its_own_height_and_never_left_for_another(name):
    rig = make_rig(RigErrors.none(), name=name)
    row = 20
    normal, across = rig.normals[row], tangents(rig.normals[row : row + 1])[0][0]
    # A screw's head, 3 mm above the skin and beside every taxel; the push that is shown leans more than a tip holds on metal.
    head = rig.places[row] + 0.004 * across + 0.003 * normal
    lean = np.radians(40)
    shown = PokeTarget(1, None, head, np.sin(lean) * across - np.cos(lean) * normal, known=True)
    guided = GuidedOperator(rig, replace(Habits(), ignores=1.0, slide_rate=1.0, double_rate=0.0), np.random.default_rng(1))
    guided.show(shown)
    done = presses(guided, 300)
    assert all((press.pokes.targets == -1).all() and (press.slide == 0.0).all() for press in done)
    off = np.concatenate([press.pokes.points for press in done]) - head
    assert np.linalg.norm(off.mean(axis=0)) < 0.0002
    assert np.sqrt(np.mean(np.sum(off**2, axis=1))) == pytest.approx(0.0007 * np.sqrt(2), rel=0.15)
    forces = np.concatenate([press.pokes.forces for press in done])
    assert 8.0 <= forces.min() < 8.5
    assert 12.5 < forces.max() <= 13.0
    pushes, normals = (np.concatenate([getattr(press.pokes, k) for press in done]) for k in ("directions", "normals"))
    leans = np.degrees(np.arccos(-np.sum(pushes * normals, axis=1)))
    assert np.abs(off @ normals[0]).max() < 1e-12, "at the point's own height"
    assert leans.max() <= 28.0 + 1e-6 or rig.surface is None
    guided.show(target_at(rig, 204 if name == "icub-forearm" else int(rig.channels[0])))
    assert any(press.slide.any() for press in presses(guided, 20)), "elsewhere it slides as ever"


def test_it_goes_where_it_likes_in_one_poke_of_twelve(rig):
    guided = GuidedOperator(rig, Habits.careful(), np.random.default_rng(2))
    guided.show(target_at(rig, 204))
    targets = np.concatenate([p.pokes.targets for p in presses(guided, 1200)])
    ignored = targets != 204
    assert ignored.mean() == pytest.approx(1 / 12, abs=0.025)
    assert len(set(targets[ignored])) > 40


def test_a_target_counts_until_a_reaction_before_the_touch(rig):
    habits = replace(FOLLOWS, approach_s=(0.6, 0.6))
    for late, expected in ((0.30, 288), (0.40, 204)):
        guided = GuidedOperator(rig, habits, np.random.default_rng(3))
        guided.show(target_at(rig, 204))
        second = replace(target_at(rig, 288), number=2)
        one = presses(guided, 1, lambda now, at=late, other=second, hand=guided: now >= at and hand.show(other))[0]
        assert one.begin == pytest.approx(0.6, abs=STEP)
        assert one.pokes.targets[0] == expected
        guided.show(second)  # too late for the one, in time for the next
        assert presses(guided, 1)[0].pokes.targets[0] == 288


def test_the_hand_waits_where_nothing_is_to_be_poked_and_goes_on(rig):
    guided = GuidedOperator(rig, FOLLOWS, np.random.default_rng(5))
    guided.show(target_at(rig, 204))
    assert guided.next(0.0) is None, "the hand is on its way"
    guided.show(NoTarget.WAIT)
    assert [guided.next(now) for now in np.arange(0.0, 60.0, STEP)] == [None] * 6000
    assert guided.begun == 0
    guided.show(target_at(rig, 205))
    action = next(a for a in (guided.next(now) for now in np.arange(60.0, 62.0, STEP)) if a is not None)
    assert action.begin - 60.0 >= FOLLOWS.approach_s[0], "it sets out anew"
    assert action.pokes.targets[0] == 205
    guided.show(NoTarget.ANY)
    assert len(presses(guided, 10)) == 10


def test_it_follows_over_all_poses_and_ends_after_its_pokes(rig):
    guided = GuidedOperator(rig, FOLLOWS, np.random.default_rng(6), pokes=6, poses=("2", "1"))
    guided.show(target_at(rig, 204))
    done = presses(guided, 8)
    assert [a.arm_pose.name for a in done if isinstance(a, Move)] == ["2", "1"]
    assert guided.is_finished
    assert guided.next(1e6) is None


def test_the_same_seed_and_targets_give_the_same_pokes(rig):
    def session(seed):
        guided = GuidedOperator(rig, Habits(), np.random.default_rng(seed))
        shown = iter([204, 205, 288, 289] * 20)
        pressed = [0]

        def tell(_now):
            if guided.begun >= pressed[0]:
                pressed[0] += 1
                guided.show(target_at(rig, next(shown)))

        return presses(guided, 40, tell)

    first = session(7)
    assert same(first, session(7))
    assert not same(first, session(8))


def test_the_pace_shortens_the_ways_and_not_the_presses():
    usual, quick = Habits.careful(), Habits.careful().at_pace(2.0)
    assert quick.approach_s == (0.2, 0.45)
    assert quick.rest_s == (0.15, 0.3)
    assert quick.hold_s == usual.hold_s
    assert usual.at_pace(1.0) == usual


def test_each_operator_says_what_it_does_not_take(rig, rng):
    guided, obedient = GuidedOperator(rig, FOLLOWS, rng), ScriptedOperator(rig, FOLLOWS, rng)
    with pytest.raises(InputError, match=approved_pattern("operator.no_taxel", channel=0)):
        guided.show(PokeTarget(1, 0, np.zeros(3), np.array([0.0, 0.0, -1.0])))
    for order in (PokeOrder(204), PoseOrder("2")):
        with pytest.raises(InputError, match=approved_pattern("operator.for_told")):
            guided.accept(order)
    with pytest.raises(InputError, match=approved_pattern("operator.for_guided")):
        obedient.accept(PaceOrder(2.0))
    assert obedient.next(0.0) is None


def test_each_number_is_poked_once_and_said_to_be_reached_when_the_hand_is_back(rig):
    guided, answers = GuidedOperator(rig, FOLLOWS, np.random.default_rng(3)), []
    guided.answered = answers.append
    guided.show(replace(target_at(rig, 204), number=7))
    (done,) = (action for now in np.arange(0.0, 9.0, STEP) if (action := guided.next(now)) is not None)
    assert answers == [Answer(AnswerKind.REACHED, 7)]
    assert guided.begun == 1, "and never again, until another number is asked for"
    guided.show(replace(target_at(rig, 204), number=8))
    again = next(action for now in np.arange(9.0, 12.0, STEP) if (action := guided.next(now)) is not None)
    assert again.begin > done.free
    assert answers == [Answer(AnswerKind.REACHED, 7)]
    assert guided.next(again.free) is None
    assert answers[1:] == [Answer(AnswerKind.REACHED, 8)]


def test_a_known_point_that_is_asked_for_comes_out_of_the_bytes_as_an_axis_through_it():
    """The wrench is that of a press there; the skin says what it feels: nothing beside it, something upon it."""
    rig = make_rig(RigErrors.noise())
    scene, normal = rig.scene, rig.normals[20]
    beside = nearest_points(rig.surface, rig.surface.vertices[rig.surface.vertices[:, 0].argmax()][None])
    heads = (
        (beside[0][0], rig.surface.normals[beside[1][0]]),
        (nearest_points(rig.surface, rig.places[20:21])[0][0], normal),
    )
    assert np.linalg.norm(rig.places - heads[0][0], axis=1).min() > 0.03, "no taxel feels it"
    for (head, outward), felt in zip(heads, (False, True), strict=True):
        operator = GuidedOperator(rig, Habits(double_rate=0.0), np.random.default_rng(3), 6)
        operator.show(read_line(write_line(PokeTarget(1, None, head, -outward, known=True))))
        ask_on(operator)
        line = DeviceTimeline(rig, operator, np.random.default_rng(4))
        pipeline = Pipeline(
            scene, [LinkSpec(name, f"simulated:{name}", (stream,)) for name, stream in line.links.items()], rig.surface
        )
        for link in line.links:
            pipeline.feed(LinkEvent(link, 0, LinkState.OPEN))
        while not line.finished:
            for at_ns, link, data in line.advance():
                pipeline.feed(Chunk(link, at_ns, data))
            pipeline.tick(round(line.now * 1e9))
        outcomes = [record.outcome for record in pipeline.snapshot().pokes]
        there = landmark_pokes(outcomes, [Landmark("head", head, None)], {outcome.poke: "head" for outcome in outcomes})
        assert len(there) >= 5
        if not felt:
            assert {outcome.reason for outcome in outcomes} == {Reason.NO_TAXEL}
        for poke in there:
            force, moment = move_wrench(poke.link_from_sensor, poke.force, poke.moment)
            assert 7.0 < np.linalg.norm(force) < 14.0
            away = np.linalg.norm(moment - np.cross(head, force)) / np.linalg.norm(force)
            assert away < 0.004
            assert poke.landmark_miss < 0.004
        assert any(hasattr(outcome, "responses") for outcome in outcomes) is felt
