"""What a correction does not know, carried into the estimates: against contacts that are corrected anew and solved again."""

from dataclasses import replace
from functools import lru_cache

import numpy as np
import pytest

from skincal.geometry import rotations
from skincal.methods import average_over_poses, estimate_taxels
from skincal.modules.pose import ModuleModel
from skincal.rig.correction import Correction, CorrectionErrors, RigPrior
from skincal.simulation.contacts import simulate_contacts, unguided
from skincal.simulation.rig_errors import RigErrors
from skincal.taxels.result import Method
from skincal.taxels.shared_errors import predicted_error
from tests.skincal.sim_support import make_rig

LINEAR, QUADRATIC = RigPrior(), RigPrior(quadratic=0.02)


@lru_cache
def poked(times=4, poses=("1", "2", "3")):
    """A right rig and its contacts in some poses."""
    rng = np.random.default_rng(5)
    rig = make_rig(RigErrors.noise(), 5)
    contacts = []
    for pose in rig.arm_poses:
        if pose in poses:
            contacts += simulate_contacts(rig, unguided(rig, times, rng), rng, pose, first_poke=len(contacts) * 2 + 1)
    return rig, contacts


def solved(rig, contacts, shared=None, methods=tuple(Method), doubting=False):
    model = ModuleModel(rig.scene.skin.layout, rig.scene.skin.anchor, rig.surface)
    return estimate_taxels(
        contacts, rig.channels.tolist(), methods, rig.scene.noise, rig.surface, doubting=doubting, model=model, shared=shared
    )


def correction_by(unknowns, names, columns, root=None):
    """The correction with these unknowns, SI: C row by row, then turn and shift of each pose."""
    matrix, poses = unknowns[: 6 * columns].reshape(6, columns), unknowns[6 * columns :].reshape(-1, 2, 3)
    motions = {}
    for name, (turn, shift) in zip(names, poses, strict=True):
        motions[name] = np.eye(4)
        motions[name][:3, :3], motions[name][:3, 3] = rotations(turn[None])[0], shift
    return Correction(
        np.eye(6) + matrix[:, :6], motions=motions, quadratic=matrix[:, 6:], root=np.empty((0, 0)) if root is None else root
    )


def errors_of(correction, contacts):
    return CorrectionErrors(correction, {contact.poke: contact for contact in contacts}.__getitem__)


def exact(contacts):
    """A correction that knows all of a right rig: what it takes up of slow errors stays in what is predicted."""
    names = sorted({contact.pose for contact in contacts})
    count = 36 + 6 * len(names)
    return errors_of(correction_by(np.zeros(count), names, 6, np.zeros((count, count))), contacts)


def some_root(prior, poses, rng):
    """An upper triangular root, as large as the prior, whose unknowns go together."""
    scales = prior.scales(poses)
    count = len(scales)
    return scales[:, None] * np.triu(np.eye(count) + rng.standard_normal((count, count)) / np.sqrt(count))


def in_a_triangle(estimate, surface):
    """Whether a place is inside its triangle and not on its rim, where a search stays whatever a push says."""
    corners = surface.vertices[surface.triangles[estimate.triangle]]
    shares = np.linalg.lstsq(corners.T, estimate.position, rcond=None)[0]
    return shares.min() > 0.01


@pytest.mark.parametrize("prior", [LINEAR, QUADRATIC], ids=["linear", "quadratic"])
@pytest.mark.parametrize(("method", "rtol"), [(Method.FREE, 0.06), (Method.SURFACE, 0.06), (Method.MODULES, 0.2)])
def test_what_a_correction_does_not_know_moves_taxels_as_a_correction_changed_by_it_does(rng, method, rtol, prior):
    """But for what turns with an axis that misses: some hundredths, of modules, whose steps leave it out, too, a fifth."""
    rig, contacts = poked()
    names, columns = sorted({contact.pose for contact in contacts}), 6 if prior is LINEAR else 27
    root = some_root(prior, len(names), rng)
    nothing = correction_by(np.zeros(len(root)), names, columns, root)
    found, step = solved(rig, contacts, errors_of(nothing, contacts), [method])[method], 0.02
    compared = 0
    for _ in range(2):
        x = rng.standard_normal(len(root))
        there, back = (
            solved(rig, [correction_by(sign * step * root @ x, names, columns).corrected(c) for c in contacts], None, [method])[
                method
            ]
            for sign in (1.0, -1.0)
        )
        for channel, estimate in found.items():
            around = (estimate, there[channel], back[channel])
            if any(each.position is None for each in around):
                continue
            if method is Method.SURFACE and not (
                len({each.triangle for each in around}) == 1 and all(in_a_triangle(each, rig.surface) for each in around)
            ):
                continue
            change = (there[channel].position - back[channel].position) / (2.0 * step)
            assert np.linalg.norm(estimate.moved @ x - change) < rtol * np.linalg.norm(estimate.moved)
            compared += 1
    assert compared > 40


def test_under_an_ordinary_correction_they_are_right_to_a_few_hundredths(rng):
    rig, contacts = poked()
    names = sorted({contact.pose for contact in contacts})
    root, here = some_root(LINEAR, len(names), rng), LINEAR.scales(len(names)) * rng.standard_normal(36 + 6 * len(names))
    now = correction_by(here, names, 6, root)
    right = [now.corrected(contact) for contact in contacts]
    found, x = solved(rig, right, errors_of(now, right), [Method.FREE])[Method.FREE], rng.standard_normal(len(root))
    there, back = (
        solved(
            rig, [correction_by(here + sign * 0.02 * root @ x, names, 6).corrected(c) for c in contacts], None, [Method.FREE]
        )[Method.FREE]
        for sign in (1.0, -1.0)
    )
    known = [channel for channel, estimate in found.items() if estimate.position is not None]
    changes = np.array([(there[channel].position - back[channel].position) / 0.04 for channel in known])
    moves = np.array([found[channel].moved @ x for channel in known])
    assert np.linalg.norm(moves - changes) < 0.08 * np.linalg.norm(changes)


def test_three_hundred_rigs_drawn_from_what_is_known_spread_as_the_covariance_says(rng):
    """Also where the skin was poked in an arm pose that the correction does not know: that may be as wrong as any."""
    rig, contacts = poked(1)
    root = some_root(LINEAR, 2, rng)
    known = correction_by(np.zeros(len(root)), ["1", "2"], 6, root)
    own = LINEAR.scales(1)[-6:]
    plain = solved(rig, contacts, exact(contacts), [Method.FREE])[Method.FREE]
    found = solved(rig, contacts, errors_of(known, contacts), [Method.FREE])[Method.FREE]
    placed = [channel for channel, estimate in found.items() if estimate.position is not None]
    drawn = []
    for _ in range(300):
        unknowns = np.concatenate([root @ rng.standard_normal(len(root)), own * rng.standard_normal(6)])
        right = correction_by(unknowns, ["1", "2", "3"], 6)
        moved = solved(rig, [right.corrected(contact) for contact in contacts], None, [Method.FREE])[Method.FREE]
        drawn.append([moved[channel].position - plain[channel].position for channel in placed])
    drawn = np.array(drawn)
    spread = np.einsum("sti,stj->tij", drawn, drawn) / len(drawn)
    added = np.array([found[channel].covariance - plain[channel].covariance for channel in placed])
    ratios = np.trace(spread, axis1=1, axis2=2) / np.trace(added, axis1=1, axis2=2)
    assert 0.85 < ratios.mean() < 1.15
    assert ratios.min() > 0.7
    assert ratios.max() < 1.4
    # Where nothing was poked in the pose that is not known, all of it is shared and stands in `moved`.
    only = [contact for contact in contacts if contact.pose != "3"]
    shared = solved(rig, only, errors_of(known, only), [Method.FREE])[Method.FREE]
    alone = solved(rig, only, exact(only), [Method.FREE])[Method.FREE]
    for channel, estimate in shared.items():
        if estimate.position is not None:
            np.testing.assert_allclose(
                estimate.covariance, alone[channel].covariance + estimate.moved @ estimate.moved.T, rtol=1e-9, atol=1e-15
            )
            assert estimate.rms == pytest.approx(np.sqrt(np.trace(estimate.covariance)), rel=1e-12)


@pytest.mark.parametrize("method", list(Method))
def test_when_an_unknown_pose_came_leaves_no_trace(method):
    """Not in a bit: solved at once, taxel by taxel backwards, or after another pose that nobody poked any more."""
    rig, contacts = poked()
    known = correction_by(np.zeros(42), ["1"], 6, np.diag(LINEAR.scales(1)))
    at_once = solved(rig, contacts, errors_of(known, contacts), [method])[method]
    used = errors_of(known, contacts)
    solved(rig, [contact for contact in contacts if contact.pose == "3"], used, [method])
    again = solved(rig, contacts[::-1], used, [method])[method]
    for channel, estimate in at_once.items():
        assert np.array_equal(estimate.covariance, again[channel].covariance)
        if estimate.moved is not None:
            assert estimate.moved.shape == (3, 42)
            assert np.array_equal(estimate.moved, again[channel].moved)


def test_hundreds_of_arm_poses_that_nobody_knows_take_no_room():
    rig, contacts = poked()
    streamed = [replace(contact, pose=f"{contact.poke} deg") for contact in contacts]
    known = correction_by(np.zeros(36 + 6 * len(streamed)), [poke.pose for poke in streamed], 6, np.diag(LINEAR.scales(0)))
    found = solved(rig, streamed, errors_of(known, streamed), [Method.SURFACE])[Method.SURFACE]
    few = solved(rig, contacts, errors_of(known, contacts), [Method.SURFACE])[Method.SURFACE]
    whole = [predicted_error(list(estimates.values()), np.inf) for estimates in (found, few)]
    assert max(estimate.moved.shape[1] for estimate in found.values() if estimate.moved is not None) == 36
    # What each poke has by itself averages, what three poses have does not.
    assert whole[0].mean < whole[1].mean
    assert whole[0].whole == pytest.approx(whole[1].whole, rel=1e-9)


def test_the_mean_over_poses_keeps_what_all_of_them_share():
    rig, contacts = poked()
    names = sorted({contact.pose for contact in contacts})
    known = correction_by(np.zeros(36 + 6 * len(names)), names, 6, np.diag(LINEAR.scales(len(names))))
    asked = contacts, rig.channels.tolist(), Method.FREE, rig.scene.noise, rig.surface
    plain, shared = (average_over_poses(*asked, shared=each) for each in (exact(contacts), errors_of(known, contacts)))
    own = [
        solved(rig, [c for c in contacts if c.pose == name], errors_of(known, contacts), [Method.FREE], doubting=True)[
            Method.FREE
        ]
        for name in names
    ]
    several = 0
    for channel, estimate in shared.items():
        if estimate.position is None:
            continue
        moves = [each[channel].moved for each in own if each[channel].moved is not None]
        several += len(moves) > 1
        added = np.mean(moves, axis=0) @ np.mean(moves, axis=0).T
        np.testing.assert_allclose(estimate.covariance, plain[channel].covariance + added, rtol=1e-9, atol=1e-15)
    assert several > 5
