"""When a taxel is given up, whether predicted errors are believed, and how a session ends."""

from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from scipy import stats

from skincal.contacts.poke_columns import PokeColumns
from skincal.guide.believed_positions import plan_without_positions
from skincal.guide.guide import Guide
from skincal.guide.progress import GuideSettings, Why
from skincal.guide.verdict import CHI2_2DOF_QUANTILE_95, POKES_PER_HELD_OUT_POKE, Check, check, held_out, verdict_of
from skincal.methods import estimate_from, estimate_taxels
from skincal.model.actions import MarkDead
from skincal.model.scene import NoiseSettings
from skincal.modules.pose import ModuleModel
from skincal.pokes import NO_LANDMARK_POKES
from skincal.rig.correction import RIG, Correction, UsedCorrection
from skincal.rig.correction_fit import LandmarkAgreement, RigAnswer, RigRequest, correct_rig, landmark_agreement
from skincal.rig.expected_gain import unchecked_of
from skincal.session.session import Session
from skincal.session.snapshot import snapshot_of
from skincal.simulation.contacts import poke_landmarks, simulate_contacts, unguided
from skincal.simulation.example_parts import ExamplePart
from skincal.simulation.poking_strategies import Conditions, Hand, displaced_rig, errors_of, plan_pokes
from skincal.simulation.rig_errors import RigErrors
from skincal.taxels.contact_table import ContactTable
from skincal.taxels.result import Estimate, Method, State
from tests.skincal.sim_support import make_rig

SETTINGS = GuideSettings()


# ---- held-out pokes ----


@cache
def part():
    return ExamplePart()


@cache
def poked_session(pokes=240, seed=1, conditions=None):
    conditions, rng = conditions or Conditions(), np.random.default_rng(seed)
    rig = displaced_rig(part(), conditions, seed)
    contacts, _ = Hand(rig, conditions, rng).poke(plan_pokes("tilt_recipe", part(), conditions, pokes, rng), 1)
    session = Session(part().scene, part().surface)
    for contact in contacts:
        session.add(contact)
    session.snapshot()
    return session, rig


def checked(method=Method.FREE, surface=None, noise=None, **which):
    session, _ = poked_session(**which)
    surface, noise = surface or part().surface, noise or part().scene.noise
    model = ModuleModel(part().scene.skin.layout, part().scene.skin.anchor, surface)
    return check(session.snapshot(), session.channels, method, noise, surface, model)


def test_every_sixth_poke_is_held_out_with_the_taxel_that_answered_most():
    session, _ = poked_session()
    pairs = list(zip(*map(np.ndarray.tolist, held_out(session.snapshot().columns)), strict=True))
    assert [poke for poke, _ in pairs] == [each.poke for each in session.contacts][
        POKES_PER_HELD_OUT_POKE - 1 :: POKES_PER_HELD_OUT_POKE
    ]
    by_poke = {each.poke: each for each in session.contacts}
    for poke, channel in pairs:
        contact = by_poke[poke]
        assert contact.responses[contact.channels.tolist().index(channel)] == contact.responses.max()


def columns_of(contacts):
    return PokeColumns.collect((contact, False) for contact in contacts)


def test_a_short_session_holds_out_so_many_that_they_say_something():
    contacts = poked_session()[0].contacts
    for count, expected in ((7, 7), (19, 19), (39, 39), (40, 20), (55, 27), (60, 20), (119, 23), (120, 20)):
        assert len(held_out(columns_of(contacts[:count]))[0]) == expected
    assert held_out(columns_of(contacts[:60]))[0].tolist() == [contact.poke for contact in contacts[2:60:3]]


@pytest.mark.parametrize("method", [Method.FREE, Method.SURFACE])
def test_it_is_predicted_from_what_all_the_other_pokes_say_and_nothing_else(method):
    """By another route: the taxel is solved anew from the other contacts, and the axis's distance summed up in space."""
    session, _ = poked_session(120)
    noise, inside, count = part().scene.noise, 0, 0
    for poke, channel in zip(*held_out(session.snapshot().columns), strict=True):
        others = [contact for contact in session.contacts if contact.poke != poke]
        if sum(channel in other.channels for other in others) < 2:
            continue
        # By the scene's noise: that it is larger is for the verdict to find.
        estimate = estimate_from(ContactTable(others), [channel], [method], noise, part().surface)[method][channel]
        if estimate.position is None:
            continue
        answers = ContactTable([contact for contact in session.contacts if contact.poke == poke]).evidence([channel])
        u, lever, size = answers.directions[0], estimate.position - answers.sensors[0], answers.forces[0]
        force = noise.force / size
        spread = (noise.moment / size) ** 2 * np.eye(3) + force**2 * (lever @ lever * np.eye(3) - np.outer(lever, lever))
        spread += noise.contact**2 * np.eye(3) - noise.reach**2 * np.log(answers.weights[0]) * np.eye(3)
        across = np.linalg.svd(u[None])[2][1:]
        # The force's noise turns with the push: u x (p - a) is read, of which the part across u counts.
        turned = np.stack([np.cross(u, e) for e in across])
        total = turned @ estimate.covariance @ turned.T + across @ spread @ across.T
        off = across @ np.cross(u, estimate.position - answers.nearest[0])
        inside += bool(off @ np.linalg.solve(total, off) <= CHI2_2DOF_QUANTILE_95)
        count += 1
    found = checked(method, pokes=120)
    assert count > 5
    assert (found.checked, found.inside) == (count, inside)


@pytest.mark.parametrize("method", list(Method))
def test_what_is_predicted_truly_is_believed(method):
    checks = [checked(method, seed=seed) for seed in (1, 2, 3, 4)]
    total, inside = sum(check.checked for check in checks), sum(check.inside for check in checks)
    assert total >= 100
    assert 0.90 <= inside / total <= 0.99
    assert all(check.believed for check in checks)


def test_noise_that_is_given_as_a_third_of_what_it_is_is_not_believed():
    noise = part().scene.noise
    third = replace(noise, force=noise.force / 3, moment=noise.moment / 3, contact=noise.contact / 3)
    for seed in (1, 2):
        found = checked(Method.MODULES, noise=third, seed=seed)
        assert found.inside < 0.6 * found.checked
        assert not found.believed


def test_a_surface_that_is_not_the_parts_is_not_believed():
    surface = part().surface
    moved = replace(surface, vertices=surface.vertices + np.array([0.0, 0.0, 0.02]))
    assert checked(Method.SURFACE).believed
    assert not checked(Method.SURFACE, surface=moved).believed


@pytest.mark.parametrize("method", [Method.FREE, Method.MODULES])
def test_an_arm_that_reports_a_wrong_pose_is_not_believed(method):
    """Half of the pokes are moved by 12 mm: what each half says is of one piece, both together are not."""
    session, _ = poked_session()
    shift = np.eye(4)
    shift[1, 3] = 0.012
    moved = Session(part().scene, part().surface)
    for contact in session.contacts:
        moved.add(replace(contact, link_from_sensor=shift @ contact.link_from_sensor) if contact.poke % 2 else contact)
    found = check(moved.snapshot(), moved.channels, method, part().scene.noise, None, moved.module_model)
    assert not found.believed


def test_without_a_module_model_modules_are_not_checked():
    session, _ = poked_session()
    args = session.channels, Method.MODULES, part().scene.noise
    assert check(session.snapshot(), *args, part().surface) == Check(0, 0)
    assert check(Session(part().scene, None).snapshot(), *args, None, session.module_model) == Check(0, 0)


def test_a_few_pokes_that_agree_say_nothing():
    assert not Check(0, 0).has_enough
    assert Check(12, 12).has_enough


def test_the_chance_is_that_of_a_binomial():
    for checked_, inside in ((40, 40), (40, 38), (40, 33), (12, 9), (0, 0)):
        expected = stats.binom.sf(checked_ - inside - 1, checked_, 0.05) if checked_ else 1.0
        assert Check(checked_, inside).chance == pytest.approx(expected, abs=1e-12)
    # 0.0152 and 0.102 of 11, 0.0002 of 14: hardly, well, and not at all.
    judged = [(check_.agrees, check_.believed) for check_ in (Check(11, 8), Check(11, 9), Check(14, 7))]
    assert judged == [(False, True), (True, True), (False, False)]


# ---- the verdict ----


def test_the_verdict_counts_what_is_done_and_says_of_the_rest_why():
    session, rig = poked_session(240)
    dead = int(session.channels[7])
    mine = Session(part().scene, part().surface)
    for contact in session.contacts:
        mine.add(contact)
    mine.act(MarkDead(dead))
    snapshot = mine.snapshot()
    guide = Guide(part().plan, part().scene.noise, Method.FREE)
    guidance = guide.update(snapshot, {}.get)
    estimates = snapshot.estimates[Method.FREE]
    verdict = verdict_of(guidance, snapshot, part().scene.noise, part().surface)
    by_modules = replace(guidance, method=Method.MODULES)
    assert verdict_of(by_modules, snapshot, part().scene.noise, part().surface, mine.module_model).check.has_enough
    assert verdict.used == 83
    assert verdict.counts.accepted == len(mine.contacts)
    assert {taxel.channel: taxel.why for taxel in verdict.left}[dead] is Why.DEAD
    open_ = [taxel for taxel in verdict.left if taxel.why is not Why.DEAD]
    assert verdict.done == 83 - len(open_)
    assert all(each.needs for each in open_)
    assert not verdict.enough
    assert verdict.check.believed
    assert verdict.wanted == SETTINGS.wanted
    done = set(session.channels) - {taxel.channel for taxel in verdict.left}
    errors = dict(zip([estimate.channel for estimate in estimates], errors_of(estimates, rig), strict=True))
    assert all(errors[channel] < 5.0 / 3.0 * SETTINGS.wanted for channel in done)


def test_a_session_without_pokes_has_a_verdict_too():
    session = Session(part().scene, part().surface)
    snapshot = session.snapshot()
    guidance = Guide(part().plan, NoiseSettings(), Method.SURFACE).update(snapshot, {}.get)
    verdict = verdict_of(guidance, snapshot, NoiseSettings(), part().surface)
    assert (verdict.done, verdict.used, verdict.counts.accepted, verdict.seconds) == (0, 84, 0, 0.0)
    assert {taxel.why for taxel in verdict.left} == {Why.NOT_POKED_ENOUGH}
    assert verdict.check == Check(0, 0)
    assert verdict.check.believed


def test_it_is_not_enough_where_there_is_nothing():
    guide = Guide(plan_without_positions(np.arange(12)), NoiseSettings(), Method.FREE)
    nothing = snapshot_of((), {Method.FREE: [Estimate(channel, Method.FREE, State.UNSEEN, 0) for channel in range(12)]})
    verdict = verdict_of(guide.update(nothing, {}.get), nothing, NoiseSettings(), None)
    assert (verdict.done, verdict.used, verdict.enough) == (0, 0, False)


# ---- landmarks ----


def used_correction(ratio=1.1, root=1e-3):
    return UsedCorrection(
        RIG, Correction(np.eye(6), root=root * np.eye(36) if root else np.empty((0, 0))), 0.009, 0.001, 21, ratio
    )


def test_landmarks_are_judged_as_the_rig_is_used():
    """By held-out pokes under a correction, as reported without one; by what was recorded where nobody looked since."""
    some = np.zeros(42)
    answer = RigAnswer(Correction(np.eye(6)), True, 0.009, 0.001, 6, dict.fromkeys(range(21), 1.0), {}, some, some, 1.2, 6.5)
    assert landmark_agreement(answer, None) == LandmarkAgreement(21, 6.5, False)
    assert landmark_agreement(answer, used_correction()) == LandmarkAgreement(21, 1.2, True)
    assert landmark_agreement(replace(answer, noisier=2.8), used_correction()) == LandmarkAgreement(21, 1.2, True, 2.8)
    assert landmark_agreement(replace(answer, noisier=2.8), None).noisier == 1.0, "as reported, the scene's noise is predicted"
    noisy = replace(used_correction(1.1), noisier=4.0)
    assert landmark_agreement(None, noisy) == LandmarkAgreement(21, 1.1, True, 4.0)
    assert landmark_agreement(None, used_correction(1.1)) == LandmarkAgreement(21, 1.1, True)
    assert landmark_agreement(replace(answer, correction=None), used_correction(1.1)) == LandmarkAgreement(21, 1.1, True)
    assert landmark_agreement(replace(answer, correction=None), None) is None
    assert landmark_agreement(None, used_correction(np.nan)) is None
    assert landmark_agreement(None, None) is None


def landmark_case(errors, seed):
    """A rig, its contacts, what landmark pokes say, and the estimates of the modules as reported."""
    rng, rig = np.random.default_rng([seed, 3]), make_rig(errors, seed)
    contacts = [poke for pose in rig.arm_poses for poke in simulate_contacts(rig, unguided(rig, 1, rng), rng, pose)]
    contacts = [replace(contact, poke=number) for number, contact in enumerate(contacts, start=1)]
    known = poke_landmarks(rig, rig.scene.landmarks, 3, rng, 10_001)
    model = ModuleModel(rig.scene.skin.layout, rig.scene.skin.anchor, rig.surface)
    channels, noise = rig.channels.tolist(), rig.scene.noise
    found = estimate_taxels(contacts, channels, [Method.MODULES], noise, rig.surface, model=model)[Method.MODULES]
    return rig, contacts, known, correct_rig(RigRequest(rig.scene, rig.surface, contacts, known)), list(found.values())


def test_a_rig_that_landmarks_speak_against_may_be_as_wrong_as_any():
    """Landmark pokes make it no better until it is corrected by them; where they agree, they say how right it is."""
    rig, contacts, known, answer, found = landmark_case(RigErrors.paper(), 1)
    noise, against = rig.scene.noise, landmark_agreement(answer, None)
    assert not against.agrees
    plain = unchecked_of(None, None, found, contacts, NO_LANDMARK_POKES, noise)
    assert plain == unchecked_of(None, against, found, contacts, known, noise)
    off = [
        estimate.position - place for estimate, place in zip(found, rig.places, strict=True) if estimate.position is not None
    ]
    assert plain > 0.5 * np.sqrt(np.mean(np.sum(np.square(off), axis=1)))
    # One whose own uncertainty is in the prediction adds nothing; of one of old only what its landmarks leave is known.
    assert unchecked_of(used_correction(), None, found, contacts, known, noise) is None
    assert 0.0 < unchecked_of(used_correction(root=0.0), None, found, contacts, known, noise) < 0.4 * plain
    rig, contacts, known, answer, found = landmark_case(RigErrors.noise(), 2)
    agrees = landmark_agreement(answer, None)
    assert agrees.agrees
    assert unchecked_of(None, agrees, found, contacts, known, rig.scene.noise) < 0.4 * plain
    assert unchecked_of(None, None, [], contacts, known, rig.scene.noise) is None


def test_a_session_of_a_rig_that_is_wrong_is_not_believed_without_its_correction():
    rig, contacts, known, answer, _ = landmark_case(RigErrors.paper(), 1)
    right = [answer.correction.corrected(contact) for contact in contacts]
    used = UsedCorrection(RIG, answer.correction, answer.before, answer.after, len(known), answer.ratio)
    assert landmark_agreement(answer, used).agrees
    guide = Guide(part().plan, rig.scene.noise, Method.FREE)
    for correction, pokes in ((None, contacts), (used, right)):
        session = Session(rig.scene, rig.surface)
        for contact in pokes:
            session.add(contact)
        snapshot = session.snapshot()
        by_modules = replace(guide.update(snapshot, {}.get), method=Method.MODULES)
        landmarks = landmark_agreement(answer, correction)
        verdict = verdict_of(by_modules, snapshot, rig.scene.noise, rig.surface, session.module_model, landmarks)
        assert verdict.believed is (correction is not None and verdict.check.agrees)
        assert verdict.doubted is (correction is None or not verdict.check.believed)
        assert verdict.predicted.mean > 0
