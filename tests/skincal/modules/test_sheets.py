"""Soft sheets: the fit against a dense Gaussian posterior, known deformations, and what few pokes may claim."""

from dataclasses import replace
from functools import cache
from itertools import product
from pathlib import Path

import numpy as np
import pytest

from skincal.contacts.outcome import Contact
from skincal.files.layout_sources import Grid, parse_layout
from skincal.geometry import rotations
from skincal.guide.verdict import check
from skincal.mesh.lay import place_layout
from skincal.mesh.surface import make_surface
from skincal.methods import estimate_taxels
from skincal.model.scene import NoiseSettings
from skincal.model.skin import Anchor, Layout, Module, ModuleKind, SkinKind
from skincal.modules import sheet_fit
from skincal.modules.pose import ModuleModel
from skincal.modules.sheet_basis import FIELD_STEP_LENGTH_M, FIELD_STEP_SD_M, MODES_MAX, STRAIN_SD, make_basis
from skincal.modules.sheet_estimate import COMMON_AIM_SD_FACTOR, predict_sheet_pokes
from skincal.modules.sheet_fit import fit_sheets
from skincal.modules.sheet_plan import count_sheet_pokes
from skincal.session.snapshot import snapshot_of
from skincal.taxels.contact_table import ContactTable
from skincal.taxels.result import Cause, Method, State
from skincal.taxels.shared_errors import predicted_error

NOISE = NoiseSettings(skin=0.0)
SENSOR = np.array([0.01, -0.02, -0.12])
MODULES = [Method.MODULES]
CENTRE_SD_M = 1.6 * NOISE.contact
"""sd of a contact about a single pad that answers, in each direction."""


@cache
def plane():
    """A square of 0.4 m at z = 0, in 800 triangles."""
    at = np.linspace(-0.2, 0.2, 21)
    x, y = np.meshgrid(at, at)
    corners = np.stack([x.ravel(), y.ravel(), np.zeros(x.size)], axis=1)
    row, column = np.meshgrid(np.arange(20), np.arange(20), indexing="ij")
    a = (row * 21 + column).ravel()
    return make_surface(corners, np.concatenate([np.stack([a, a + 1, a + 22], axis=1), np.stack([a, a + 22, a + 21], axis=1)]))


ANCHOR = Anchor(np.zeros(2), np.zeros(3), np.array([1.0, 0.0, 0.0]), np.array([0.0, 0.0, 1.0]))


@cache
def layout(rows=6, columns=8, pitch=9.0, kind=SkinKind.SHEET):
    return parse_layout(Grid(rows, columns, pitch, kind).layout_text(), Path("grid"))


@cache
def model(**of):
    return ModuleModel(layout(**of), ANCHOR, plane())


def press(places, channels, rng, offset=CENTRE_SD_M, force_noise=NOISE.force, first=1):
    """Poke single taxels at true places (n, 3), one poke for each of `channels`, off by `offset` in each direction."""
    contacts = []
    for number, channel in enumerate(channels, first):
        point = places[channel] + [*offset * rng.standard_normal(2), 0.0]
        push = np.array([*0.2 * rng.standard_normal(2), -1.0])
        force = rng.uniform(6, 12) * push / np.linalg.norm(push)
        moment = np.cross(point - SENSOR, force) + force_noise * 0.1 * rng.standard_normal(3)
        force = force + force_noise * rng.standard_normal(3)
        pose = np.eye(4)
        pose[:3, 3] = SENSOR
        start = 2.0 * number
        contacts.append(
            Contact(number, start, start + 0.3, force, moment, np.array([channel]), np.array([100.0]), pose, "", 0.0, True)
        )
    return contacts


def deformed(flat, stretch=(0.03, 0.0, 0.0), fold=0.0):
    strain = np.array([[stretch[0], stretch[2]], [stretch[2], stretch[1]]])
    return flat + flat @ strain - fold * (flat[:, :1] > 0.009) * [1.0, 0.0]


def on_plane(flat, turn=0.05, shift=(0.002, -0.003)):
    c, s = np.cos(turn), np.sin(turn)
    return np.concatenate([flat @ np.array([[c, s], [-s, c]]) + shift, np.zeros((len(flat), 1))], axis=1)


def estimate(contacts, of=None, **options):
    of = of or model()
    return estimate_taxels(contacts, of.layout.channels, MODULES, NOISE, plane(), model=of, **options)[Method.MODULES]


def fit(contacts, of=None, doubting=True, noise=NOISE):
    of, table = of or model(), ContactTable(contacts)
    evidence = table.evidence(of.layout.channels)
    return fit_sheets(evidence, table.totals(evidence.pokes), of, noise, [], doubting)[0]


# ---- the basis ----


def test_the_modes_have_the_variogram_of_the_field():
    flat = layout().places
    basis = make_basis(flat)
    covariance = (basis.modes * basis.variances) @ basis.modes.T
    apart = np.linalg.norm(flat[:, None] - flat[None], axis=2)
    variogram = np.diag(covariance)[:, None] + np.diag(covariance) - 2.0 * covariance
    assert variogram == pytest.approx(FIELD_STEP_SD_M**2 * apart / FIELD_STEP_LENGTH_M, rel=1e-9, abs=1e-16)
    assert basis.left_out.max() < 1e-15


def test_what_the_modes_of_a_large_sheet_leave_out_is_kept():
    flat = layout(16, 16, 8.0).places
    basis = make_basis(flat)
    assert basis.modes.shape[1] <= MODES_MAX
    apart = np.linalg.norm(flat[:, None] - flat[None], axis=2)
    kept = (basis.modes * basis.variances) @ basis.modes.T
    own = np.diag(kept) + basis.left_out
    variogram = own[:, None] + own - 2.0 * kept
    far = apart > 0.02
    true = FIELD_STEP_SD_M**2 / FIELD_STEP_LENGTH_M * apart[far]
    assert np.abs(variogram[far] / true - 1.0).max() < 0.15
    assert basis.left_out.mean() < 0.1 * own.mean()


# ---- against the dense posterior ----


def dense(contacts, found):
    """Posterior of the positions by covariances of all taxels, without a basis and without the program's rows.

    The rows are E (a - p) with the noise E N E' + s^2 (I - o o'); the prior is that of `sheet_basis` on all taxels at once,
    with a shift and a turn of sd `POSE_MAX_SD_M`, at the pose found.
    """
    stretch, field, factor = found.scales
    flat = found.basis.flat
    x = found.pose.x[0]
    y = np.cross([0.0, 0.0, 1.0], x)
    here = found.pose.points[0] + flat[:, :1] * x + flat[:, 1:] * y
    count = len(flat)
    # Unknowns: the displacements of all taxels along x and y.
    apart = np.linalg.norm(flat[:, None] - flat[None], axis=2)
    own = -0.5 * FIELD_STEP_SD_M**2 / FIELD_STEP_LENGTH_M * field**2 * apart
    centring = np.eye(count) - 1.0 / count
    prior = np.kron(centring @ own @ centring, np.eye(2))
    strains = np.zeros((count, 2, 3))
    strains[:, 0, 0], strains[:, 1, 1], strains[:, 0, 2], strains[:, 1, 2] = *flat.T, flat[:, 1], flat[:, 0]
    pose = np.zeros((count, 2, 3))
    deformed_flat = found.basis.displaced(found.coefficients)
    pose[:, 0, 0] = pose[:, 1, 1] = 1.0
    pose[:, 0, 2], pose[:, 1, 2] = -deformed_flat[:, 1] / 0.010, deformed_flat[:, 0] / 0.010
    for columns, sd in ((strains, stretch * STRAIN_SD), (pose, sheet_fit.POSE_MAX_SD_M)):
        wide = columns.reshape(2 * count, 3) * sd
        prior = prior + wide @ wide.T
    rows, misses, noises = [], [], []
    for contact in contacts:
        u = contact.force / np.linalg.norm(contact.force)
        moment = contact.moment + np.cross(contact.link_from_sensor[:3, 3], contact.force)
        axis = np.cross(u, moment) / np.linalg.norm(contact.force)
        e1 = np.cross(u, [1.0, 0.0, 0.0])
        e1 /= np.linalg.norm(e1)
        pair = np.stack([e1, np.cross(u, e1)])
        pad = int(np.flatnonzero(found.touches.channels == contact.channels[0])[0])
        place = found.pads.points[pad]
        lever, size = place - SENSOR, np.linalg.norm(contact.force)
        cross = np.array([[0, -lever[2], lever[1]], [lever[2], 0, -lever[0]], [-lever[1], lever[0], 0]])
        slant = np.array([[0, -u[2], u[1]], [u[2], 0, -u[0]], [-u[1], u[0], 0]])
        n = np.array([0.0, 0.0, 1.0])
        of_residual = (
            NOISE.moment**2 * np.eye(3) + NOISE.force**2 * cross @ cross.T
            + size**2 * CENTRE_SD_M**2 * slant @ (np.eye(3) - np.outer(n, n)) @ slant.T
        )  # fmt: skip
        turn = np.stack([pair[1], -pair[0]])
        noises.append(factor * turn @ of_residual @ turn.T / size**2)
        row = np.zeros((2, 2 * count))
        row[:, 2 * pad], row[:, 2 * pad + 1] = pair @ x, pair @ y
        rows.append(row)
        misses.append(pair @ (axis - here[pad]))
    rows, misses = np.concatenate(rows), np.concatenate(misses)
    noise = np.zeros((len(rows), len(rows)))
    for at, each in enumerate(noises):
        noise[2 * at : 2 * at + 2, 2 * at : 2 * at + 2] = each
    spread = rows @ prior @ rows.T + noise
    gain = prior @ rows.T @ np.linalg.inv(spread)
    moved = (gain @ misses).reshape(count, 2)
    covariance = prior - gain @ rows @ prior
    axes = np.stack([x, y])
    blocks = np.array([axes.T @ covariance[2 * k : 2 * k + 2, 2 * k : 2 * k + 2] @ axes for k in range(count)])
    twice = -np.linalg.slogdet(spread)[1] - misses @ np.linalg.solve(spread, misses)
    return here + moved @ axes, blocks, twice


@pytest.mark.parametrize("pokes", [5, 30, 90])
def test_positions_and_covariances_are_those_of_the_dense_posterior(pokes):
    rng = np.random.default_rng(pokes)
    places = on_plane(deformed(layout().places, fold=0.002))
    contacts = press(places, rng.permutation(np.arange(96) % 48)[:pokes], rng)
    found = fit(contacts, doubting=False)
    positions, covariances, _ = dense(contacts, found)
    # The dense route turns the sheet by small angles at the pose found.
    assert np.abs(found.pads.points - positions).max() < 1e-6
    own = found.pads.gradients @ found.covariance @ found.pads.gradients.transpose(0, 2, 1)
    # It also subtracts large numbers: its covariances are not symmetric in the fourth digit.
    assert np.abs(own - covariances).max() < 1e-3 * np.abs(covariances).max()
    # The estimates add the shift by the aim, and slow errors.
    estimates = list(estimate(contacts, doubting=False).values())
    more = np.array([each.covariance for each in estimates]) - covariances
    assert (np.linalg.eigvalsh(more)[:, -1] >= (COMMON_AIM_SD_FACTOR * NOISE.contact) ** 2 * 0.9).all()


def test_the_scales_are_those_of_the_dense_likelihood():
    rng = np.random.default_rng(4)
    contacts = press(on_plane(deformed(layout().places, fold=0.002)), rng.permutation(48)[:40], rng)
    found = fit(contacts, doubting=False)
    tried = list(product(sheet_fit.STRETCH_SCALES, sheet_fit.FIELD_SCALES, sheet_fit.NOISE_FACTORS))
    priors = [np.prod(each) for each in product(sheet_fit.STRETCH_PRIORS, sheet_fit.FIELD_PRIORS, sheet_fit.NOISE_PRIORS)]
    twice = np.array([dense(contacts, replace(found, scales=scales))[2] for scales in tried])
    odds = priors * np.exp(0.5 * (twice - twice.max()))
    odds = odds / odds.sum()
    stretch, field, factor = np.array(tried).T
    expected = np.sqrt(odds @ stretch**2), np.sqrt(odds @ field**2), odds @ factor
    assert found.scales == pytest.approx(expected, rel=0.01)


def test_a_poke_is_predicted_as_the_posterior_without_it_predicts():
    rng = np.random.default_rng(2)
    contacts = press(on_plane(layout().places), rng.permutation(48)[:20], rng)
    found = fit(contacts, doubting=False)
    predicted = predict_sheet_pokes([found])
    for at in (0, 7, 19):
        positions, covariances, _ = dense(contacts[:at] + contacts[at + 1 :], found)
        pad = int(contacts[at].channels[0])
        pairs = found.touches.evidence.pairs[found.touches.rows[at]]
        off = pairs @ (found.touches.evidence.nearest[found.touches.rows[at]] - positions[pad])
        assert predicted.misses[at] == pytest.approx(off, abs=2e-6)
        spread = pairs @ covariances[pad] @ pairs.T + predicted.own[at]
        assert predicted.covariances[at] == pytest.approx(spread, rel=1e-3, abs=1e-12)


# ---- known deformations ----


def test_a_stretched_sheared_and_folded_sheet_is_found_better_than_as_a_board():
    errors = {SkinKind.SHEET: [], SkinKind.BOARD: []}
    inside = []
    for seed in range(6):
        rng = np.random.default_rng(seed)
        size = {"rows": 10, "columns": 10, "pitch": 12.0}
        places = on_plane(deformed(layout(**size).places, (0.03, 0.0, 0.0175), fold=0.002))
        contacts = press(places, np.tile(rng.permutation(100), 2), rng)
        for kind, of in errors.items():
            found = list(estimate(contacts, model(**size, kind=kind)).values())
            off = np.array([each.position for each in found]) - places
            of.append(np.linalg.norm(off, axis=1).mean())
            if kind is SkinKind.SHEET:
                known = np.array([each.covariance[:2, :2] for each in found])
                inside += [o[:2] @ np.linalg.solve(c, o[:2]) < 5.991 for o, c in zip(off, known, strict=True)]
    assert np.mean(errors[SkinKind.SHEET]) < 0.75 * np.mean(errors[SkinKind.BOARD])
    assert np.mean(errors[SkinKind.SHEET]) < 0.001
    assert np.mean(inside) >= 0.90


def test_a_large_stretch_is_learned_from_exact_pokes():
    places = on_plane(deformed(layout().places, (0.05, -0.02, 0.01)), turn=0.0)
    contacts = press(places, np.arange(48), np.random.default_rng(0), offset=1e-4, force_noise=1e-3)
    found = estimate(contacts)
    off = [np.linalg.norm(each.position - places[channel]) for channel, each in found.items()]
    assert max(off) < 0.001, "5 % of 35 mm is 1.7 mm"


def test_the_error_grows_with_the_distance_to_the_touched_taxels():
    places = on_plane(layout().places)
    left = [channel for channel in range(48) if channel % 8 < 3]
    found = estimate(press(places, left * 3, np.random.default_rng(1)))
    by_column = [np.mean([found[8 * row + column].rms for row in range(6)]) for column in range(8)]
    assert (np.diff(by_column[2:]) > 0).all()
    assert by_column[7] > 1.8 * by_column[1]
    assert found[7].state is State.INFERRED
    assert found[0].state is State.TOUCHED


def test_one_poke_determines_no_turn_and_no_pokes_nothing():
    places = on_plane(layout().places)
    found = estimate(press(places, [20], np.random.default_rng(0)))
    assert found[0].state is State.BLIND
    assert found[0].reason.cause is Cause.MODULE_ONE_POKE
    assert {each.reason.cause for each in estimate([]).values()} == {Cause.MODULE_UNPOKED}


def test_a_poke_far_off_is_doubted_and_hardly_moves_the_sheet():
    rng = np.random.default_rng(5)
    places = on_plane(deformed(layout().places))
    contacts = press(places, np.tile(np.arange(48), 2), rng)
    wrong = places.copy()
    wrong[20, 0] += 0.02
    (bad,) = press(wrong, [20], rng, first=97)
    without, found = estimate(contacts), estimate([*contacts, bad])
    assert found[20].doubted[97] < 0.1
    assert np.linalg.norm(found[20].position - without[20].position) < 0.0005


def test_a_taxel_whose_only_contact_is_an_outlier_is_not_touched():
    rng = np.random.default_rng(5)
    places = on_plane(deformed(layout().places))
    wrong = places.copy()
    wrong[20, 0] += 0.02
    clean = [each for each in press(places, np.tile(np.arange(48), 2), rng) if 20 not in each.channels]
    found = estimate([*clean, *press(wrong, [20], rng, first=97)])[20]
    assert (found.contacts, found.state, found.reason.cause) == (1, State.BLIND, Cause.CONTRADICTED)
    assert (found.position, found.sd, found.rms) == (None, None, None)
    (good,) = press(places, [20], rng, first=97)
    assert estimate([*clean, good])[20].state is State.TOUCHED


def test_pokes_that_push_from_behind_give_no_position():
    contacts = [
        replace(each, force=-each.force, moment=-each.moment)
        for each in press(on_plane(layout().places), range(0, 48, 4), np.random.default_rng(0))
    ]
    assert {each.reason.cause for each in estimate(contacts).values()} == {Cause.MODULE_BEHIND}


# ---- the same in other frames and orders ----


def test_a_rigid_motion_moves_the_estimates_and_the_order_of_pokes_does_not():
    rng = np.random.default_rng(8)
    contacts = press(on_plane(deformed(layout().places)), rng.permutation(48)[:25], rng)
    turn, shift = rotations(np.array([[0.4, -1.1, 0.7]]))[0], np.array([0.3, -0.2, 0.5])
    surface = make_surface(plane().vertices @ turn.T + shift, plane().triangles)
    anchor = Anchor(ANCHOR.at, shift, turn @ ANCHOR.x, turn @ ANCHOR.normal)
    motion = np.eye(4)
    motion[:3, :3], motion[:3, 3] = turn, shift
    moved = [replace(each, link_from_sensor=motion @ each.link_from_sensor) for each in contacts]
    own = estimate(contacts)
    other = estimate_taxels(moved, layout().channels, MODULES, NOISE, surface, model=ModuleModel(layout(), anchor, surface))[
        Method.MODULES
    ]
    for channel, each in own.items():
        assert other[channel].position == pytest.approx(turn @ each.position + shift, abs=1e-8)
        assert other[channel].covariance == pytest.approx(turn @ each.covariance @ turn.T, abs=1e-12)
    again = estimate(contacts[::-1])
    assert all(np.array_equal(again[channel].position, each.position) for channel, each in own.items())


def test_the_origin_of_the_sheet_s_plane_does_not_matter():
    rng = np.random.default_rng(9)
    contacts = press(on_plane(layout().places), rng.permutation(48)[:25], rng)
    (module,) = layout().modules
    kind = module.kind
    shift = np.array([0.05, -0.03])
    off = ModuleKind(kind.name, kind.pads + shift, kind.outline + shift, kind.centre_pad)
    c, s = np.cos(0.3), np.sin(0.3)
    turned = Module(1, off, 0, module.place - np.array([[c, -s], [s, c]]) @ shift, 0.3, False)
    other = Layout((turned,), 48, given_kind=SkinKind.SHEET)
    plan = ModuleModel(other, ANCHOR, plane()).planned(0)
    assert plan == pytest.approx(place_layout(other, ANCHOR, plane()).places[:48], abs=1e-12)
    for channel, each in estimate(contacts, ModuleModel(other, ANCHOR, plane())).items():
        assert each.position == pytest.approx(estimate(contacts)[channel].position, abs=1e-6)


def test_two_sheets_are_each_fitted_alone():
    (module,) = layout().modules
    second = replace(module, id=2, first_channel=48, place=np.array([0.1, 0.0]))
    both = ModuleModel(Layout((module, second), 96, given_kind=SkinKind.SHEET), ANCHOR, plane())
    places = on_plane(layout().places)
    there = np.concatenate([places, places + np.array([0.1, 0.0, 0.0])])
    rng = np.random.default_rng(3)
    first = press(there, range(0, 48, 2), rng)
    every = [*first, *press(there, range(48, 96, 3), rng, first=25)]
    alone, found = estimate(first), estimate(every, both)
    assert all(found[channel].position.tolist() == each.position.tolist() for channel, each in alone.items())
    assert np.linalg.norm(found[60].position - there[60]) < 0.004
    # By hand: each sheet has a shift of its own, in two directions; the mean of two is smaller by the square root of two.
    shift = np.sqrt(2.0) * COMMON_AIM_SD_FACTOR * NOISE.contact
    for estimates, whole in ((alone, shift), (found, shift / np.sqrt(2.0))):
        assert predicted_error(list(estimates.values()), np.inf).whole == pytest.approx(whole, rel=1e-6)
    assert not np.any(found[0].moved @ found[60].moved.T)
    assert [found[channel].rms for channel in alone] == pytest.approx([each.rms for each in alone.values()], rel=1e-12)


# ---- the plan ----


def test_more_taxels_and_a_smaller_error_need_more_pokes():
    small, large = layout(4, 4, 9.0).places, layout(16, 16, 9.0).places
    counts = [count_sheet_pokes(flat, NOISE, wanted) for flat in (small, large) for wanted in (0.002, 0.0015)]
    assert counts[0] < counts[1]
    assert counts[2] < counts[3]
    assert counts[1] < counts[3]
    assert 30 <= count_sheet_pokes(layout().places, NOISE, 0.0015) <= 60


# ---- wrong layouts ----

ROWS = np.arange(48).reshape(6, 8)
SERPENTINE = np.where(np.arange(6)[:, None] % 2, ROWS[:, ::-1], ROWS)


@pytest.mark.parametrize(
    ("true", "agrees"),
    [(ROWS, True), (SERPENTINE, False), (ROWS[:, ::-1], False), (np.arange(48).reshape(8, 6).T, False)],
    ids=["right", "serpentine", "mirrored", "by columns"],
)
def test_channels_in_another_order_are_contradicted_by_held_out_pokes(true, agrees):
    """A sheet bends to much, but not to taxels in each other's places."""
    rng = np.random.default_rng(2)
    contacts = press(on_plane(layout().places)[true.ravel()], rng.permutation(48), rng)
    moment = snapshot_of(contacts, {Method.MODULES: list(estimate(contacts).values())})
    tried = check(moment, range(48), Method.MODULES, NOISE, plane(), model())
    assert tried.has_enough
    assert tried.agrees is agrees
    assert tried.believed is agrees
