"""Known distances between modules: the truth is nearer with them, and what they say is what least squares of all rows says."""

import subprocess
import sys
from dataclasses import replace
from functools import cache
from itertools import combinations

import numpy as np
import pytest
from scipy.optimize import least_squares

from skincal.methods import average_over_poses, estimate_taxels
from skincal.model.actions import Exclude, Restore
from skincal.model.scene import KnownDistance, NoiseSettings
from skincal.modules.distances import DistanceUse, apply_distances
from skincal.modules.estimate import estimate_modules
from skincal.modules.pose import ModuleModel, join_poses
from skincal.modules.pose_fit import fit_modules_from_pokes, whitened_rows
from skincal.rig.correction import RIG, Correction, UsedCorrection
from skincal.session.corrections import correct_action
from skincal.session.session import Session
from skincal.simulation.contacts import simulate_contacts, unguided
from skincal.simulation.rig_errors import RigErrors
from skincal.studies.error_numbers import inside_95_ellipsoid
from skincal.taxels.contact_table import ContactTable
from skincal.taxels.result import Method
from skincal.words.layout_words import distance_sentences
from tests.approved import approved
from tests.skincal.modules.test_pose_fit import laid, model_of, moved_poses, press
from tests.skincal.poke_script import same_estimates
from tests.skincal.sim_support import make_rig

SD = 0.0003
MODULES = [Method.MODULES]


@cache
def poked(seed):
    """A good rig, poked once at each taxel."""
    rig, rng = make_rig(RigErrors.noise(), seed), np.random.default_rng([seed, 5])
    return rig, simulate_contacts(rig, unguided(rig, 1, rng), rng)


def measured(rig, seed, wrong=0.0, sd=SD):
    """The distances of all modules' middle taxels, as a ruler reads them; the first one wrong."""
    rng, middles = np.random.default_rng([seed, 6]), [module.centre_channel for module in rig.scene.skin.layout.modules]
    found = []
    for one, other in combinations(middles, 2):
        length = float(np.linalg.norm(rig.places[rig.row_of(one)] - rig.places[rig.row_of(other)]) + sd * rng.standard_normal())
        found.append(KnownDistance((one, other), True, length + (0.0 if found else wrong), sd))
    return tuple(found)


def solved(rig, contacts, distances, surface=True):
    mesh = rig.surface if surface else None
    model = ModuleModel(rig.scene.skin.layout, rig.scene.skin.anchor, mesh, distances)
    return estimate_taxels(contacts, rig.channels.tolist(), MODULES, rig.scene.noise, mesh, model=model)[Method.MODULES]


# Without a mesh modules are taken for flat, and these are bent by a millimetre.
@pytest.mark.parametrize(
    ("surface", "sd", "less"), [(True, SD, 0.65), (False, 0.001, 0.85), (False, SD, 0.75)], ids=["mesh", "no mesh", "bent"]
)
def test_the_error_falls_and_the_prediction_with_it(surface, sd, less):
    squares, predicted, held = ({False: [], True: []} for _ in range(3))
    for seed in range(1, 21):
        rig, contacts = poked(seed)
        for told in (False, True):
            found = solved(rig, contacts, measured(rig, seed, sd=sd) if told else (), surface).values()
            both = [(each.position - rig.places[rig.row_of(each.channel)], each.covariance) for each in found]
            squares[told].append(np.mean([off @ off for off, _ in both]))
            predicted[told].append(np.mean([np.trace(covariance) for _, covariance in both]))
            held[told].append(np.mean([inside_95_ellipsoid(*one) for one in both]))
    assert np.mean(squares[True]) < less * np.mean(squares[False])
    assert np.mean(predicted[True]) < less * np.mean(predicted[False])
    assert 0.93 <= np.mean(held[True]) <= 0.97


def rows_of_all(model, contacts, noise, told, start):
    """Give what least squares makes small, as a function of all modules' unknowns from `start`: each poke and each distance."""
    table = ContactTable(contacts)
    evidence = table.evidence(model.layout.channels.tolist())
    touches, fitted = fit_modules_from_pokes(evidence, table.totals(evidence.pokes), model, noise, [{}])
    assert (fitted.trust == 1.0).all()
    flat, whiten = np.concatenate(model.pads), whitened_rows(touches, fitted.pads, noise).whiten
    pairs, axes = evidence.pairs[touches.rows], evidence.nearest[touches.rows]
    index = {channel: at for at, channel in enumerate(touches.channels.tolist())}

    def rows(x):
        poses = model.ground.move(start, x.reshape(len(model.pads), -1))
        pads = model.ground.place_pads(poses.select(fitted.of), flat)
        apart = [np.linalg.norm(np.subtract(*pads.points[[index[end] for end in each.ends]])) for each in told]
        off = [(length - each.length) / each.sd for length, each in zip(apart, told, strict=True)]
        across = pairs @ (axes - touches.contact_centres(pads)[0])[:, :, None]
        return np.concatenate([(whiten @ across).ravel(), off]), pads

    return rows


@pytest.mark.parametrize("surface", [True, False], ids=["mesh", "no mesh"])
def test_it_is_least_squares_over_all_pokes_and_distances(surface, rng):
    model, noise = model_of(surface=surface), NoiseSettings(skin=0.0, radius=1e9)
    poses = moved_poses(model, rng)
    contacts = press(model, poses, rng, 16 * len(poses))
    middles = [module.centre_channel for module in model.layout.modules]
    true = [laid(model, module, pose).points[model.place_of[middles[module]]] for module, pose in enumerate(poses)]
    told = tuple(
        KnownDistance((middles[i], middles[i + 1]), True, float(np.linalg.norm(true[i] - true[i + 1])) + off, SD)
        for i, off in enumerate(rng.uniform(-0.0001, 0.0001, len(poses) - 1))
    )
    known = ModuleModel(model.layout, model._anchor, model._surface, told)
    kept = {}
    alone = estimate_modules(ContactTable(contacts), known, range(len(poses)), noise, [{}], {}, fitted_modules=kept)
    for module, own in kept.items():
        # By the noise alone, without what slow errors may add.
        information = own.slopes.reshape(-1, model.ground.unknowns)
        kept[module] = replace(own, covariance=np.linalg.inv(information.T @ information), factor=1.0, height=0.0)
    found, tried = apply_distances(known, kept, alone, noise)
    assert all(each.used for each in tried)
    rows = rows_of_all(known, contacts, noise, told, join_poses([kept[module].pose for module in range(len(poses))]))
    best = least_squares(lambda x: rows(x)[0], np.zeros(model.ground.unknowns * len(poses)), xtol=1e-15, ftol=1e-15, gtol=1e-15)
    pads, covariance = rows(best.x)[1], np.linalg.inv(best.jac.T @ best.jac)
    channels = np.concatenate([module.channels for module in model.layout.modules]).tolist()
    moved = max(np.linalg.norm(found[channel].position - alone[channel].position) for channel in channels)
    assert moved > 0.00005
    size, traces = model.ground.unknowns, {"alone": 0.0, "found": 0.0, "dense": 0.0}
    for at, channel in enumerate(channels):
        assert np.linalg.norm(found[channel].position - pads.points[at]) < 0.05 * moved, "but for the curvature"
        first = size * int(model.layout.module_of[channel])
        own = covariance[first : first + size, first : first + size]
        there = pads.gradients[at] @ own @ pads.gradients[at].T
        np.testing.assert_allclose(found[channel].covariance, there, rtol=0, atol=0.1 * np.trace(there))
        for name, each in (("alone", alone[channel].covariance), ("found", found[channel].covariance), ("dense", there)):
            traces[name] += np.trace(each)
    assert traces["found"] == pytest.approx(traces["dense"], rel=0.03)
    assert traces["found"] < 0.95 * traces["alone"]


def test_what_all_modules_share_is_no_news_to_a_distance(rng):
    """Errors of the rig that shift two modules alike stay as they are, and those that part them fall."""
    model, noise = model_of("flat-patch", False), NoiseSettings()
    poses = moved_poses(model, rng)
    contacts = press(model, poses, rng, 12 * len(poses), noise=0.004)
    middles = [model.layout.modules[module].centre_channel for module in (0, 1)]
    ends = [laid(model, module, poses[module]).points[model.place_of[middles[module]]] for module in (0, 1)]
    way = (ends[0] - ends[1]) / np.linalg.norm(ends[0] - ends[1])
    told = (KnownDistance(tuple(middles), True, float(np.linalg.norm(ends[0] - ends[1])), 1e-4),)
    known, kept = ModuleModel(model.layout, model._anchor, None, told), {}
    alone = estimate_modules(ContactTable(contacts), known, range(len(poses)), noise, [{}], {}, fitted_modules=kept)
    # One error shifts both along their distance, another one the first alone, by a millimetre each.
    for module, apart in ((0, way), (1, np.zeros(3))):
        moves = np.zeros((6, 2))
        moves[:3, 0], moves[:3, 1] = 0.001 * way, 0.001 * apart
        kept[module] = replace(kept[module], moves=moves, shared=-kept[module].slopes @ moves)
    found, (tried,) = apply_distances(known, kept, alone, noise)
    assert tried.used
    together, apart = found[middles[0]].moved.T @ way
    assert together == pytest.approx(0.001, rel=1e-6)
    assert abs(apart) < 0.0007


def test_a_wrong_distance_is_not_used_and_said():
    rig, contacts = poked(1)
    scene = replace(rig.scene, distances=measured(rig, 1, wrong=0.020))
    session = Session(scene, rig.surface)
    for contact in contacts:
        session.add(contact)
    tried = session.snapshot().tried_distances
    assert [each.use for each in tried] == [DistanceUse.OFF, *[DistanceUse.USED] * 20]
    assert tried[0].distance.length - tried[0].found == pytest.approx(0.020, abs=0.003)
    first, second = distance_sentences(tried)
    assert first == approved("distances.used", used=20, count="21 known distances")
    (one, other), told, found = tried[0].distance.ends, f"{tried[0].distance.length * 1e3:.1f}", f"{tried[0].found * 1e3:.1f}"
    within = f"{2e3 * tried[0].sd:.1f}"
    assert second == approved("distances.off", one=one, other=other, told=told, found=found, within=within)
    left = tuple(each for each in scene.distances if each is not tried[0].distance)
    without = solved(rig, contacts, left)
    for estimate in session.snapshot().estimates[Method.MODULES]:
        np.testing.assert_allclose(estimate.position, without[estimate.channel].position, rtol=0, atol=1e-12)
    with_it = solved(rig, contacts, scene.distances)
    assert {channel: each.position.tolist() for channel, each in with_it.items()} == {
        each.channel: each.position.tolist() for each in session.snapshot().estimates[Method.MODULES]
    }, "solved as they come and at once"


def test_distances_that_the_pokes_gain_nothing_from_change_nothing():
    """By a millimetre too short each: no single one is far off, and pokes that were held out speak against all."""
    rig, contacts = poked(2)
    close = replace(measured(rig, 2)[0], sd=0.001)
    short = tuple(replace(each, length=each.length - 0.002, sd=close.sd) for each in measured(rig, 2))
    session, plain = (Session(replace(rig.scene, distances=each), rig.surface, MODULES) for each in (short, ()))
    for contact in contacts:
        session.add(contact)
        plain.add(contact)
    assert {each.use for each in session.snapshot().tried_distances} <= {DistanceUse.NO_BETTER, DistanceUse.OFF}
    assert same_estimates(session.snapshot(), plain.snapshot())


def test_a_module_that_is_not_known_leaves_its_distances_out():
    rig, contacts = poked(1)
    layout = rig.scene.skin.layout
    of_first = [contact for contact in contacts if (layout.module_of[contact.channels] == 0).all()]
    session = Session(replace(rig.scene, distances=measured(rig, 1)), rig.surface, MODULES)
    for contact in of_first:
        session.add(contact)
    assert {each.use for each in session.snapshot().tried_distances} == {DistanceUse.UNKNOWN}
    assert distance_sentences(session.snapshot().tried_distances)[1].endswith(approved("distances.unknown"))


def test_origins_of_modules_are_ends_as_well():
    rig, contacts = poked(3)
    model = ModuleModel(rig.scene.skin.layout, rig.scene.skin.anchor, rig.surface)
    kept = {}
    found = estimate_modules(ContactTable(contacts), model, range(7), rig.scene.noise, [{}], {}, fitted_modules=kept)
    ids = [module.id for module in model.layout.modules]
    apart = float(np.linalg.norm(kept[0].pose.points - kept[4].pose.points))
    told = (KnownDistance((ids[0], ids[4]), False, apart, SD),)
    known = ModuleModel(model.layout, rig.scene.skin.anchor, rig.surface, told)
    assert apply_distances(known, kept, found, rig.scene.noise)[1][0].found == pytest.approx(apart, abs=1e-12)


def test_a_session_is_the_same_to_the_bit_in_parts_and_after_a_poke_was_out():
    rig, contacts = poked(1)
    scene = replace(rig.scene, distances=measured(rig, 1))
    at_once, in_parts = (Session(scene, rig.surface) for _ in range(2))
    action = correct_action(UsedCorrection(RIG, Correction(np.eye(6) + 1e-4), 0.009, 0.002, 6))
    for session in (at_once, in_parts):
        for contact in contacts:
            session.add(contact)
        session.snapshot()
        session.act(action)
    in_parts.act(Exclude(contacts[10].poke))
    in_parts.snapshot()
    in_parts.act(Restore(contacts[10].poke))
    while in_parts.unsolved or in_parts.snapshot(0.0) is not in_parts.snapshot(0.0):
        in_parts.snapshot(0.0)
    assert same_estimates(at_once.snapshot(), in_parts.snapshot())
    assert at_once.snapshot().tried_distances == in_parts.snapshot().tried_distances


def test_averages_over_poses_go_without_them():
    """What a distance says is the same in every pose: it would count once for each."""
    rig, contacts = poked(1)
    channels, noise = rig.channels.tolist(), rig.scene.noise
    plain, told = (
        average_over_poses(
            contacts, channels, Method.MODULES, noise, rig.surface,
            ModuleModel(rig.scene.skin.layout, rig.scene.skin.anchor, rig.surface, each),
        )
        for each in ((), measured(rig, 1))
    )  # fmt: skip
    assert all(np.array_equal(plain[channel].position, told[channel].position) for channel in channels)


def test_a_scene_without_distances_imports_nothing_of_it():
    code = """
import sys
from skincal.mesh.load import load_surface
from skincal.model.scene import load_scene, resource
from skincal.session.session import Session
import skincal.cli.solve, skincal.words.layout_words
scene = load_scene(resource("scenes/icub-forearm/scene.toml"))
Session(scene, load_surface(scene.surface)[0]).snapshot()
sys.exit("skincal.modules.distances" in sys.modules)
"""
    assert subprocess.run([sys.executable, "-c", code], check=False).returncode == 0
