"""Rigid modules: the true poses are found, however frames, orders and companions are chosen; what is not known is said."""

from dataclasses import replace
from functools import lru_cache

import numpy as np
import pytest

from skincal.chi_square import CHI2_1DOF_MEDIAN, CHI2_2DOF_MEDIAN
from skincal.contacts.outcome import Contact
from skincal.geometry import rotations
from skincal.mesh.surface import make_surface
from skincal.methods import estimate_taxels
from skincal.model.scene import NoiseSettings
from skincal.modules import pose_fit
from skincal.modules.estimate import estimate_modules
from skincal.modules.pose import MODULE_TURN_TO_LENGTH_RADIUS_M, ModuleModel, ModulesOnSurface
from skincal.modules.pose_fit import assign_pokes, offset_variances, whitened_rows
from skincal.session.session import Session
from skincal.simulation.contacts import simulate_contacts, unguided
from skincal.simulation.operator import Habits
from skincal.simulation.rig_errors import RigErrors
from skincal.solver import tables
from skincal.taxels.contact_table import ContactTable
from skincal.taxels.result import STATES_WITH_POSITION, Cause, Method, State
from tests.skincal.estimate_support import trust_by_definition
from tests.skincal.sim_support import make_rig, scene_and_surface

NOISE = NoiseSettings()
MODULES = [Method.MODULES]


@lru_cache
def model_of(name="icub-forearm", surface=True):
    scene, mesh = scene_and_surface(name)
    return ModuleModel(scene.skin.layout, scene.skin.anchor, mesh if surface else None)


def moved_poses(model, rng, shift=0.003, turn=0.1):
    """Every module beside its plan."""
    plans = [model.plan(module) for module in range(len(model.pads))]
    unknowns = model.ground.unknowns
    sizes = np.r_[np.full(unknowns - unknowns // 2, shift), np.full(unknowns // 2, turn * MODULE_TURN_TO_LENGTH_RADIUS_M)]
    if unknowns == 3:
        sizes = np.array([shift, shift, turn * MODULE_TURN_TO_LENGTH_RADIUS_M])
    return [model.ground.move(plan, (sizes * rng.standard_normal(unknowns))[None]) for plan in plans]


def laid(model, module, pose):
    pads = model.pads[module]
    return model.ground.place_pads(pose.select(np.zeros(len(pads), dtype=np.int64)), pads)


def press(model, poses, rng, pokes, modules=None, tilt=0.4, noise=0.0):
    """Pokes at the exact middle of one to four pads that answer, in three arm poses."""
    arms = [np.eye(4) for _ in range(3)]
    for arm in arms:
        arm[:3, :3] = rotations(rng.normal(0, 1, (1, 3)))[0]
        arm[:3, 3] = rng.normal(0, 0.1, 3)
    modules = range(len(model.pads)) if modules is None else modules
    contacts = []
    for number in range(1, pokes + 1):
        module = modules[number % len(modules)]
        pads = laid(model, module, poses[module])
        some = np.sort(rng.choice(len(pads.points), rng.integers(1, 5), replace=False))
        responses = rng.uniform(20, 200, len(some))
        point = responses @ pads.points[some] / responses.sum()
        push = -pads.normals[some].mean(axis=0) + tilt * rng.standard_normal(3)
        force = rng.uniform(6, 12) * push / np.linalg.norm(push)
        arm = arms[number % 3]
        turn, here = arm[:3, :3].T, arm[:3, :3].T @ (point - arm[:3, 3])
        moment = np.cross(here, turn @ force) + noise * rng.standard_normal(3)
        channels = model.layout.modules[module].channels[some]
        start = 2.0 * number
        of_arm = arm, str(number % 3), 0.0, True
        contacts.append(Contact(number, start, start + 0.3, turn @ force, moment, channels, responses, *of_arm))
    return contacts


def modules(contacts, model, channels=None, **options):
    scene_channels = model.layout.channels if channels is None else channels
    surface = model.ground.surface if isinstance(model.ground, ModulesOnSurface) else None
    return estimate_taxels(contacts, scene_channels, MODULES, NOISE, surface, model=model, **options)[Method.MODULES]


CASES = [("icub-forearm", True), ("icub-forearm", False), ("flat-patch", False)]


@pytest.mark.parametrize(("name", "surface"), CASES)
def test_exact_pokes_give_the_exact_places(name, surface, rng):
    model = model_of(name, surface)
    poses = moved_poses(model, rng)
    contacts = press(model, poses, rng, 30 * len(poses))
    found = modules(contacts, model)
    for module, pose in enumerate(poses):
        pads = laid(model, module, pose)
        channels = model.layout.modules[module].channels.tolist()
        for channel, point, normal in zip(channels, pads.points, pads.normals, strict=True):
            assert found[channel].state is State.TOUCHED
            np.testing.assert_allclose(found[channel].position, point, rtol=0, atol=2e-7)
            assert found[channel].normal @ normal > 1 - 1e-6


@pytest.mark.parametrize("turn", [60, 120, 180, -120])
def test_a_module_that_is_turned_against_its_plan_is_found_as_it_lies(turn, rng):
    model = model_of()
    poses = [model.plan(module) for module in range(7)]
    poses[2] = model.ground.move(poses[2], np.array([[0.0, 0.0, np.radians(turn) * MODULE_TURN_TO_LENGTH_RADIUS_M]]))
    found = modules(press(model, poses, rng, 140), model)
    pads = laid(model, 2, poses[2])
    for channel, point in zip(model.layout.modules[2].channels.tolist(), pads.points, strict=True):
        np.testing.assert_allclose(found[channel].position, point, rtol=0, atol=1e-6)


@pytest.mark.parametrize(("name", "surface"), CASES)
def test_the_gradients_are_those_of_differences(name, surface, rng):
    """Of the pads, and of the whitened rows at a given noise: a few pads cross into another triangle on the way."""
    model = model_of(name, surface)
    step = 1e-6
    for module in range(3):
        pose = moved_poses(model, rng)[module]
        at = laid(model, module, pose)
        for unknown in range(model.ground.unknowns):
            move = np.zeros((1, model.ground.unknowns))
            move[0, unknown] = step
            there, back = (laid(model, module, model.ground.move(pose, sign * move)).points for sign in (1.0, -1.0))
            off = np.abs((there - back) / (2 * step) - at.gradients[:, :, unknown]).max(axis=1)
            assert np.median(off) < 1e-6
            assert off.max() < (0.2 if surface else 1e-6)


def test_rows_fall_with_the_step_that_their_slopes_tell(rng):
    model = model_of(surface=False)
    poses = moved_poses(model, rng)
    contacts = press(model, poses, rng, 20, modules=[1])
    table = ContactTable(contacts)
    evidence = table.evidence(model.channels_of([1]))
    touches = assign_pokes(evidence, table.totals(evidence.pokes), model, NOISE, [1])
    start = model.plan(1)
    step = 1e-6 * rng.standard_normal((1, 6))
    before, after = (whitened_rows(touches, laid(model, 1, model.ground.move(start, s * step)), NOISE) for s in (0.0, 1.0))
    # In metres: the noise's size changes with the lever, which is not part of the step.
    off = np.linalg.solve(before.whiten, before.misses[..., None]) - np.linalg.solve(after.whiten, after.misses[..., None])
    linear = np.linalg.solve(before.whiten, before.slopes @ step[0][:, None])
    assert np.abs(off - linear).max() < 1e-3 * np.abs(linear).max()


def test_a_rigid_motion_of_everything_moves_the_estimates_with_it(rng):
    rig = make_rig(RigErrors.noise(), 3)
    contacts = simulate_contacts(rig, unguided(rig, 2, rng), rng)
    motion = np.eye(4)
    motion[:3, :3], motion[:3, 3] = rotations(np.array([[0.7, -1.1, 0.4]]))[0], [0.3, -0.2, 0.1]
    anchor = rig.scene.skin.anchor
    turn, shift = motion[:3, :3], motion[:3, 3]
    there = replace(anchor, point=turn @ anchor.point + shift, x=turn @ anchor.x, normal=turn @ anchor.normal)
    surface = make_surface(rig.surface.vertices @ motion[:3, :3].T + motion[:3, 3], rig.surface.triangles)
    for mesh, moved_mesh in ((rig.surface, surface), (None, None)):
        here = modules(contacts, ModuleModel(rig.scene.skin.layout, anchor, mesh))
        moved_contacts = [replace(each, link_from_sensor=motion @ each.link_from_sensor) for each in contacts]
        moved = modules(moved_contacts, ModuleModel(rig.scene.skin.layout, there, moved_mesh))
        for channel, estimate in here.items():
            expected = motion[:3, :3] @ estimate.position + motion[:3, 3]
            np.testing.assert_allclose(moved[channel].position, expected, rtol=0, atol=2e-5)
            assert moved[channel].rms == pytest.approx(estimate.rms, rel=1e-2)


def bits(estimates):
    def exact(estimate):
        known = None if estimate.position is None else (estimate.position.tobytes(), estimate.covariance.tobytes())
        return estimate.state, estimate.contacts, known

    return {channel: exact(estimate) for channel, estimate in estimates.items()}


def test_neither_the_order_of_pokes_nor_the_company_of_other_modules_changes_a_bit(rng):
    rig = make_rig(RigErrors.noise(), 4)
    contacts = simulate_contacts(rig, unguided(rig, 2, rng), rng, habits=Habits(double_rate=0.08))
    model = model_of()
    whole = bits(modules(contacts, model))
    shuffled = [contacts[i] for i in rng.permutation(len(contacts))]
    assert bits(modules(shuffled, model)) == whole
    for module in range(7):
        alone = bits(modules(contacts, model, model.channels_of([module])))
        assert alone == {channel: whole[channel] for channel in alone}


def test_a_session_says_the_same_live_and_at_once(rng):
    """Poke by poke, with pokes taken out and in again, or all at once: the same bits."""
    rig = make_rig(RigErrors.noise(), 5)
    contacts = simulate_contacts(rig, unguided(rig, 1, rng), rng)
    live, once = (Session(rig.scene, rig.surface) for _ in range(2))
    for contact in contacts:
        live.add(contact)
        live.snapshot()
    for contact in contacts:
        once.add(contact)
    assert live.methods == (Method.FREE, Method.SURFACE, Method.MODULES)
    same = {estimate.channel: estimate for estimate in live.snapshot().estimates[Method.MODULES]}
    assert bits(same) == bits({estimate.channel: estimate for estimate in once.snapshot().estimates[Method.MODULES]})
    assert bits(same) == bits(modules(contacts, model_of()))


def test_without_a_layout_there_is_no_such_method():
    scene, surface = scene_and_surface()
    bare = replace(scene, skin=replace(scene.skin, layout=None, anchor=None))
    assert Session(bare, surface).methods == (Method.FREE, Method.SURFACE)
    assert Session(bare, None).methods == (Method.FREE,)
    with pytest.raises(ValueError, match="layout"):
        estimate_taxels([], [204], MODULES, NOISE, None)


def errors(rig, found):
    return 1e3 * np.linalg.norm([found[channel].position for channel in rig.channels.tolist()] - rig.places, axis=1)


@lru_cache
def good_rig(seed, double_rate=0.0):
    rng = np.random.default_rng(seed)
    rig = make_rig(RigErrors.noise(), seed)
    contacts = simulate_contacts(rig, unguided(rig, 3, rng), rng, habits=Habits(double_rate=double_rate, slide_rate=0.0))
    return rig, contacts


def test_on_a_good_rig_modules_are_twice_as_good_as_taxels():
    # Measured over 6 seeds: 0.36 to 0.51 mm, where single taxels on the surface have 1.27 to 1.46 mm.
    ratios = []
    for seed in range(1, 5):
        rig, contacts = good_rig(seed)
        found = estimate_taxels(
            contacts, rig.channels.tolist(), [Method.SURFACE, Method.MODULES], rig.scene.noise, rig.surface, model=model_of()
        )
        own, single = (errors(rig, found[method]).mean() for method in (Method.MODULES, Method.SURFACE))
        assert own < 0.6
        ratios.append(own / single)
    assert np.mean(ratios) < 0.5


def test_ellipses_hold_what_they_should():
    inside = []
    for seed in range(1, 9):
        rig, contacts = good_rig(seed)
        found = modules(contacts, model_of())
        for row, channel in enumerate(rig.channels.tolist()):
            estimate = found[channel]
            values, axes = np.linalg.eigh(estimate.covariance)
            off = axes.T @ (estimate.position - rig.places[row])
            inside.append(np.sum(off[1:] ** 2 / values[1:]) < 5.991)
    # Eight seeds of seven modules: 97 %.
    assert np.mean(inside) > 0.9


def test_pokes_that_touch_two_places_are_doubted_and_harm_little():
    clean, doubled, plain, doubted, honest = [], [], [], [], []
    for seed in range(1, 5):
        rig, contacts = good_rig(seed)
        clean.append(errors(rig, modules(contacts, model_of())).mean())
        rig, touched = good_rig(seed, 0.08)
        found = modules(touched, model_of())
        doubled.append(errors(rig, found).mean())
        plain.append(errors(rig, modules(touched, model_of(), doubting=False)).mean())
        pure = {contact.poke: contact.force for contact in contacts}
        wrong = {touch.poke for touch in touched if touch.poke in pure and not np.array_equal(touch.force, pure[touch.poke])}
        said = {poke for estimate in found.values() for poke in estimate.doubted}
        doubted.append(len(said & wrong) / len(wrong))
        honest.append(len(said - wrong) / (len(touched) - len(wrong)))
    assert np.mean(doubled) < 1.15 * np.mean(clean)
    assert np.mean(plain) > 1.3 * np.mean(clean)
    assert np.mean(doubted) > 0.6
    assert np.mean(honest) < 0.05


def test_what_was_not_poked_is_said(rng):
    model = model_of()
    poses = [model.plan(module) for module in range(7)]
    found = modules(press(model, poses, rng, 40, modules=[0, 1]), model)
    assert {found[channel].state for channel in model.channels_of([0, 1])} == {State.TOUCHED}
    assert {found[channel].state for channel in model.channels_of(range(2, 7))} == {State.UNSEEN}
    assert not modules([], model)[204].contacts
    found = modules(press(model, poses, rng, 70), model, dead={204: "stuck"})
    assert (found[204].state, found[205].state) == (State.DEAD, State.TOUCHED)


@pytest.mark.parametrize("surface", [True, False])
def test_one_poke_tells_a_place_and_not_how_the_module_is_turned(surface, rng):
    model = model_of(surface=surface)
    contact = press(model, [model.plan(module) for module in range(7)], rng, 1, modules=[3])[0]
    peak = int(contact.channels[contact.responses.argmax()])
    lone = replace(contact, channels=np.array([peak]), responses=np.array([100.0]))
    found = modules([lone], model)
    others = [found[channel] for channel in model.channels_of([3]) if channel != peak]
    assert {estimate.state for estimate in others} == {State.BLIND}
    assert {estimate.reason.cause for estimate in others} == {Cause.MODULE_ONE_POKE}
    assert all(estimate.worst_direction is not None and estimate.sd is None for estimate in others)
    assert found[peak].state is (State.TOUCHED if surface else State.BLIND)


def test_parallel_axes_leave_the_depth_of_a_free_module_open_and_nothing_is_nan(rng):
    model = model_of("flat-patch", surface=False)
    contacts = press(model, [model.plan(module) for module in range(4)], rng, 60, tilt=0.0)
    found = modules(contacts, model)
    assert {estimate.state for estimate in found.values()} == {State.BLIND}
    for estimate in found.values():
        assert estimate.position is None
        assert abs(estimate.worst_direction[2]) > 0.9
    tilted = modules(press(model, [model.plan(module) for module in range(4)], rng, 60, tilt=0.3), model)
    assert all(estimate.state in STATES_WITH_POSITION for estimate in tilted.values())


def test_pokes_from_behind_are_said_to_be(rng):
    model = model_of(surface=False)
    outward = press(model, [model.plan(m) for m in range(7)], rng, 60)
    found = modules([replace(poke, force=-poke.force, moment=-poke.moment) for poke in outward], model)
    assert {(estimate.state, estimate.reason.cause) for estimate in found.values()} == {(State.BLIND, Cause.MODULE_BEHIND)}


def test_errors_of_arm_poses_that_are_known_make_the_ellipses_larger():
    rig, contacts = good_rig(1)
    known = replace(rig.scene.noise, pose_turn=0.02, pose_shift=0.002)
    table, surface = ContactTable(contacts), [{}]
    plain, wider = (estimate_modules(table, model_of(), range(7), noise, surface, {}) for noise in (rig.scene.noise, known))
    assert all(wider[channel].rms > 2e-3 + plain[channel].rms for channel in plain)


def test_contacts_are_off_the_middle_of_the_pads_that_answer_by_what_is_said():
    """By another route: the simulated tip's true place beside the middle of the true places of the pads."""
    off: dict[int, list[float]] = {}
    for seed in range(1, 5):
        rng = np.random.default_rng(seed)
        rig = make_rig(RigErrors.noise(), seed)
        pokes = unguided(rig, 3, rng)
        of = rig.scene.skin.layout.module_of
        for contact in simulate_contacts(rig, pokes, rng, habits=Habits.careful()):
            if len(set(of[contact.channels].tolist())) > 1:
                continue
            rows = [rig.row_of(channel) for channel in contact.channels.tolist()]
            aside = pokes.points[contact.poke - 1] - contact.responses @ rig.places[rows] / contact.responses.sum()
            normal = rig.normals[rows[0]]
            aside -= (aside @ normal) * normal
            off.setdefault(len(rows), []).append(float(aside @ aside) / 2.0)
    for pads in (1, 2, 3):
        assert len(off[pads]) > 30
        said = offset_variances(np.array([pads]), np.zeros(1), NOISE)[0]
        assert 0.6 < np.sqrt(np.mean(off[pads]) / said) < 1.5
    beside = offset_variances(np.array([2, 2]), np.array([0.0, 0.3]), NOISE)
    assert beside[1] - beside[0] == pytest.approx(0.001**2)


@pytest.mark.parametrize(("other", "counts"), [(0.9, True), (1.0, False), (1.1, True)])
def test_a_poke_between_two_modules_counts_for_the_one_that_answers_more_and_for_none_where_both_do_alike(other, counts, rng):
    model = model_of()
    poses = [model.plan(module) for module in range(7)]
    contact = press(model, poses, rng, 1, modules=[0])[0]
    here, there = (int(model.layout.modules[module].channels[0]) for module in (0, 1))
    channels = np.sort([here, there])
    responses = np.where(channels == here, 100.0, 100.0 * other)
    table = ContactTable([replace(contact, channels=channels, responses=responses)])
    evidence = table.evidence(model.channels_of([0, 1]))
    touches = assign_pokes(evidence, table.totals(evidence.pokes), model, NOISE, [0, 1])
    assert touches.modules.tolist() == ([0 if other < 1.0 else 1] if counts else [])


@pytest.mark.parametrize("seed", [1, 2, 3])
def test_without_a_surface_a_pose_that_does_not_settle_is_blind_and_more_pokes_make_it_settle(seed):
    rig, rng = make_rig(RigErrors.noise(), seed), np.random.default_rng(seed)
    model = model_of(surface=False)
    contacts = simulate_contacts(rig, unguided(rig, 3, rng), rng)
    few, many = (
        estimate_taxels(contacts[:count], rig.channels.tolist(), [Method.MODULES], rig.scene.noise, None, model=model)
        for count in (20, 80)
    )

    def unsettled(found):
        return [each for each in found[Method.MODULES].values() if each.reason and each.reason.cause is Cause.MODULE_MOVING]

    assert unsettled(few)
    assert all(estimate.state is State.BLIND and estimate.position is None for estimate in unsettled(few))
    assert not unsettled(many)


def trust_by_hand(slopes, misses, pitches):
    """The trust of pokes judged together, by numpy's `lstsq` on the rows as they stand."""
    count, left = len(misses), misses
    raised = 1.0 + tables.SMALL_SAMPLE_SPREAD_CORRECTION / (2 * count - 3)
    pitches = pitches / max(1.0, raised * np.median(pitches) / CHI2_1DOF_MEDIAN)
    for _ in range(pose_fit.ROBUST_SEARCH_STEPS):
        roots = np.sqrt(1.0 / np.maximum(np.sum(left**2, axis=1) + pitches, tables.FULL_WEIGHT_MAX_MISS_SDS**2))[:, None]
        move = np.linalg.lstsq((roots[:, :, None] * slopes).reshape(2 * count, -1), (roots * left).ravel())[0]
        left = left - slopes @ move
    squares = np.sum(left**2, axis=1)
    squares = squares / max(1.0, raised * np.median(squares) / CHI2_2DOF_MEDIAN) + pitches
    return trust_by_definition(squares)


def test_pokes_are_trusted_as_least_squares_in_plain_numpy_says(rng):
    model = model_of()
    poses = moved_poses(model, rng, 0.001, 0.02)
    contacts = press(model, poses, rng, 60, modules=[2], noise=0.002)
    off = {contact.poke: 0.004 * (contact.poke // 5) for contact in contacts if contact.poke % 5 == 0}
    far = [replace(contact, moment=contact.moment + off.get(contact.poke, 0.0)) for contact in contacts]
    table = ContactTable(far)
    evidence = table.evidence(model.channels_of([2]))
    touches = assign_pokes(evidence, table.totals(evidence.pokes), model, NOISE, [2])
    found = pose_fit.fit_modules(touches, model, poses[2], NOISE).trust
    rows, at = whitened_rows(touches, laid(model, 2, poses[2]), NOISE), touches.rows
    middles = touches.contact_centres(laid(model, 2, poses[2]))[0]
    pairs, forces, levers = evidence.pairs[at], evidence.forces[at], middles - evidence.sensors[at]
    swing = (NOISE.force / forces)[:, None] * np.sum(pairs * levers[:, None], axis=2)
    pitches = evidence.columns[7, at] ** 2 / ((NOISE.moment / forces) ** 2 + np.sum(swing**2, axis=1))
    assert 3 <= (found < 1).sum() <= 20
    assert ((found > 0) & (found < 1)).sum() >= 2
    # Three arm poses with twenty pokes each: judged by themselves.
    for pose in np.unique(evidence.poses[at]):
        own = evidence.poses[at] == pose
        by_hand = trust_by_hand(rows.slopes[own], rows.misses[own], pitches[own])
        np.testing.assert_allclose(found[own], by_hand, rtol=0, atol=1e-9)
