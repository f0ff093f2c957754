"""Taxels of the surface method by the centres of the answers: pokes with known truth, and equations written out one by one."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from skincal.contacts.outcome import Contact
from skincal.mesh.surface import make_surface
from skincal.methods import estimate_from
from skincal.model.scene import NoiseSettings
from skincal.modules.pose_fit import CONTACT_TO_PAD_CENTRE_SD_FACTOR
from skincal.rig.answer_centres import DEPENDENT_ANSWERS_FACTOR, join_by_centres
from skincal.taxels.contact_table import ContactTable
from skincal.taxels.result import Method, Rival, State

NOISE = NoiseSettings()
PLACE_SD = 0.0003
SIDE = 7
PITCH = 0.004


def plate():
    half = 0.05
    corners = np.array([[-half, -half, 0.0], [half, -half, 0.0], [half, half, 0.0], [-half, half, 0.0]])
    return make_surface(corners, np.array([[0, 1, 2], [0, 2, 3]]))


SURFACE = plate()
GRID = (np.arange(SIDE) - SIDE // 2) * PITCH
TRUE = np.array([[x, y, 0.0] for x in GRID for y in GRID])


def half_space(away):
    """Share of a load that a pad feels below a layer of 2.5 mm (Boussinesq)."""
    return (1.0 + (away / 0.0025) ** 2) ** -2.5


def pokes(seed, rounds=2, falls=half_space, gains=0.2):
    """Pokes that land 2 mm (sd) beside the taxels, with the sensor's frame at the touched point, as a given tip writes them."""
    rng = np.random.default_rng(seed)
    gain, found = np.exp(gains * rng.standard_normal(len(TRUE))), []
    for number, target in enumerate(np.tile(rng.permutation(len(TRUE)), rounds).tolist(), start=1):
        place = TRUE[target] + np.append(rng.normal(0.0, 0.002, 2), 0.0)
        answers = gain * falls(np.linalg.norm(TRUE - place, axis=1))
        channels = np.flatnonzero(answers > 0.08)
        if not len(channels):
            continue
        pose = np.eye(4)
        pose[:3, 3] = place + rng.normal(0.0, PLACE_SD, 3)
        found.append(
            Contact(
                poke=number, start_s=float(number), end_s=number + 0.3, force=np.array([0.0, 0.0, -NOISE.moment / PLACE_SD]),
                moment=np.zeros(3), channels=channels, responses=100.0 * answers[channels], link_from_sensor=pose, pose="tool",
                tare_change=0.0, final=True,
            )
        )  # fmt: skip
    return found


def solved(contacts):
    table, channels = ContactTable(contacts), range(len(TRUE))
    alone = list(estimate_from(table, channels, [Method.SURFACE], NOISE, SURFACE)[Method.SURFACE].values())
    return alone, table.evidence([each.channel for each in alone if each.position is not None])


def joined(alone, evidence):
    return join_by_centres(alone, evidence, SURFACE, NOISE, PLACE_SD)


def errors(estimates):
    return np.array([each.position - TRUE[each.channel] for each in estimates if each.position is not None])


@pytest.mark.parametrize("falls", [half_space, lambda away: np.exp(-0.5 * (away / 0.0023) ** 2)])
def test_taxels_are_nearer_to_the_truth_and_their_errors_are_as_predicted(falls):
    before, after, squares, predicted = [], [], [], []
    for seed in range(6):
        alone, evidence = solved(pokes(seed, falls=falls))
        found = joined(alone, evidence)
        before.append(np.linalg.norm(errors(alone), axis=1).mean())
        after.append(np.linalg.norm(errors(found), axis=1).mean())
        squares += np.sum(errors(found) ** 2, axis=1).tolist()
        predicted += [each.rms**2 for each in found if each.position is not None]
    assert np.mean(after) < 0.93 * np.mean(before)
    assert 0.8 < np.sqrt(np.mean(predicted) / np.mean(squares)) < 1.5


def test_the_shifts_solve_the_equations_that_are_written_one_by_one():
    contacts = pokes(3)
    for contact in contacts[:60:20]:
        contact.link_from_sensor[0, 3] += 0.006
    alone, evidence = solved(contacts)
    assert any(trust < 0.9 for each in alone for trust in each.doubted.values()), "a wrong place is doubted"
    unknown = {each.channel: at for at, each in enumerate(alone)}
    rows, sides, doubted = [], [], {each.channel: each.doubted for each in alone}

    def add(shares, place, variance, trust):
        for axis in (0, 1):
            row = np.zeros(2 * len(alone))
            for channel, share in shares:
                row[2 * unknown[channel] + axis] = share
            weight = np.sqrt(trust / variance)
            rows.append(weight * row)
            sides.append(weight * place[axis])

    for contact in contacts:
        place, shares = contact.link_from_sensor[:3, 3], contact.responses / contact.responses.max()
        trusts = [doubted[channel].get(contact.poke, 1.0) for channel in contact.channels.tolist()]
        for channel, share, trust in zip(contact.channels.tolist(), shares.tolist(), trusts, strict=True):
            add([(channel, 1.0)], place, NOISE.contact**2 - NOISE.reach**2 * np.log(share) + PLACE_SD**2, trust)
        count = len(shares)
        if count > 1:
            centre = (CONTACT_TO_PAD_CENTRE_SD_FACTOR * NOISE.contact / count) ** 2 + PLACE_SD**2
            add(list(zip(contact.channels.tolist(), (shares / shares.sum()).tolist(), strict=True)), place, centre, min(trusts))
    matrix = np.array(rows)
    expected = np.linalg.lstsq(matrix, np.array(sides), rcond=None)[0].reshape(-1, 2)
    found = joined(alone, evidence)
    np.testing.assert_allclose([each.position[:2] for each in found], expected, atol=1e-9)
    np.testing.assert_allclose([each.position[2] for each in found], 0.0, atol=1e-12)
    inverse = np.linalg.inv(matrix.T @ matrix)
    least = DEPENDENT_ANSWERS_FACTOR * np.array([inverse[2 * at, 2 * at] for at in range(len(alone))])
    seen = np.array([each.covariance[0, 0] for each in found])
    assert (seen > 0.999 * least).all(), "scatter beyond the scene's noise enlarges it"
    assert np.median(seen / least) < 1.01


def test_the_order_of_the_pokes_changes_no_bit_and_doubtful_taxels_stay():
    contacts = pokes(3)
    alone, evidence = solved(contacts)
    found = joined(alone, evidence)
    other = joined(*solved(contacts[::-1]))
    assert all(one.position.tobytes() == two.position.tobytes() for one, two in zip(found, other, strict=True))
    for unsure in (replace(alone[0], state=State.INFERRED), replace(alone[0], rival=Rival(alone[0].position + PITCH, 0, 2.0))):
        kept = joined([unsure, *alone[1:]], evidence)
        assert kept[0] is unsure
    assert join_by_centres([], evidence, SURFACE, NOISE, PLACE_SD) == []
