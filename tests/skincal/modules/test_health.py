"""Modules that were mounted otherwise than planned are named, right ones are not; neighbours lie as far apart as planned."""

from dataclasses import replace
from functools import lru_cache

import numpy as np
import pytest

from skincal.methods import estimate_taxels
from skincal.model.skin import Layout
from skincal.modules.health import MisplacementKind, find_misplaced_modules, spacing_ratio
from skincal.modules.pose import ModuleModel
from skincal.simulate.contacts import simulate_contacts, unguided
from skincal.simulate.faults import RigErrors
from skincal.taxels.result import Estimate, Method, State
from tests.skincal.sim_support import make_rig


@lru_cache
def poked(seed, errors="noise"):
    rng = np.random.default_rng(seed)
    rig = make_rig(RigErrors.paper() if errors == "paper" else RigErrors.noise(), seed)
    contacts = simulate_contacts(rig, unguided(rig, 3, rng), rng)
    model = ModuleModel(rig.scene.skin.layout, rig.scene.skin.anchor, rig.surface)
    found = estimate_taxels(
        contacts,
        rig.channels.tolist(),
        [Method.FREE, Method.SURFACE, Method.MODULES],
        rig.scene.noise,
        rig.surface,
        model=model,
    )
    return rig, found


def planned(rig, change):
    """The modules of a layout with some modules planned otherwise than they are."""
    layout = rig.scene.skin.layout
    modules = tuple(change(index, module) for index, module in enumerate(layout.modules))
    return ModuleModel(Layout(modules, layout.width), rig.scene.skin.anchor, rig.surface)


CASES = [("noise", 1), ("noise", 2), ("paper", 1), ("paper", 3)]


@pytest.mark.parametrize(("errors", "seed"), CASES)
def test_modules_that_lie_as_planned_are_left_alone(errors, seed):
    rig, found = poked(seed, errors)
    assert find_misplaced_modules(planned(rig, lambda _, module: module), found[Method.SURFACE]) == ()
    assert find_misplaced_modules(planned(rig, lambda _, module: module), {}) == ()


@pytest.mark.parametrize(("each", "named"), [(2, 1), (3, 0)])
def test_taxels_that_answered_to_the_same_pokes_are_one_place(each, named):
    """A turned module whose twelve taxels are estimated at six places, and at four: the latter say nothing of a turn."""
    rig, found = poked(1)
    model = planned(rig, lambda index, module: replace(module, angle=module.angle - (2 * np.pi / 3 if index == 2 else 0.0)))
    estimates = dict(found[Method.SURFACE])
    channels = model.channels_of([2])
    for first in range(0, len(channels), each):
        together = channels[first : first + each]
        middle = np.mean([estimates[channel].position for channel in together], axis=0)
        estimates |= {channel: replace(estimates[channel], position=middle) for channel in together}
    assert len(find_misplaced_modules(model, estimates)) == named


def test_a_few_estimates_close_together_fit_any_turn_and_tell_none():
    """Six of a module's taxels, drawn together to half their distance and scattered by 2 mm."""
    rig, _ = poked(1)
    model = planned(rig, lambda _, module: module)
    for seed in range(40):
        rng, estimates = np.random.default_rng(seed), {}
        for module in range(2):
            every = model.channels_of([module])
            places = np.array([rig.places[rig.row_of(channel)] for channel in every])
            some = rng.permutation(len(every))[:6]
            near = 0.5 * (places[some] + places[some].mean(axis=0)) + 0.002 * rng.normal(size=(6, 3))
            for row, place in zip(some.tolist(), near, strict=True):
                normal = rig.normals[rig.row_of(every[row])]
                estimates[every[row]] = Estimate(every[row], Method.SURFACE, State.ESTIMATED, 3, position=place, normal=normal)
        for said in find_misplaced_modules(model, estimates):
            assert said.after < 0.8 * said.before


@pytest.mark.parametrize(("errors", "seed"), CASES)
@pytest.mark.parametrize("which", [0, 4])
def test_a_module_that_is_mirrored_is_named(errors, seed, which):
    rig, found = poked(seed, errors)
    model = planned(rig, lambda index, module: replace(module, mirror=index == which))
    (said,) = find_misplaced_modules(model, found[Method.SURFACE])
    assert (said.kind, said.module) == (MisplacementKind.MIRRORED, model.layout.modules[which].id)
    assert said.after < (0.6 if errors == "noise" else 1.0) * said.before


@pytest.mark.parametrize(("errors", "seed"), CASES)
@pytest.mark.parametrize("turn", [120, -120])
def test_a_module_that_is_turned_is_named_with_its_turn(errors, seed, turn):
    rig, found = poked(seed, errors)
    model = planned(rig, lambda index, module: replace(module, angle=module.angle - (np.radians(turn) if index == 2 else 0.0)))
    (said,) = find_misplaced_modules(model, found[Method.SURFACE])
    assert (said.kind, said.module) == (MisplacementKind.TURNED, 29)
    assert np.degrees(said.turn) == pytest.approx(turn)
    assert said.after < (0.6 if errors == "noise" else 1.0) * said.before


# Where a rig bends the whole skin by more than half a module (seed 3) a swap is named as another mistake.
@pytest.mark.parametrize(("errors", "seed"), CASES[:3])
def test_modules_that_are_swapped_are_named_both(errors, seed):
    rig, found = poked(seed, errors)
    modules = rig.scene.skin.layout.modules
    other = {1: modules[5], 5: modules[1]}
    model = planned(
        rig,
        lambda index, module: replace(module, place=other[index].place, angle=other[index].angle) if index in other else module,
    )
    said = find_misplaced_modules(model, found[Method.SURFACE])
    assert [(misfit.kind, misfit.module, misfit.other) for misfit in said] == [
        (MisplacementKind.SWAPPED, 28, 26), (MisplacementKind.SWAPPED, 26, 28)
    ]  # fmt: skip
    assert all(misfit.after < 0.5 * misfit.before for misfit in said)


def test_neighbours_lie_as_far_apart_as_planned():
    rig, found = poked(1)
    layout = rig.scene.skin.layout
    ratios = {method: spacing_ratio(layout, list(estimates.values())) for method, estimates in found.items()}
    assert 0.98 < ratios[Method.MODULES] < 1.02
    assert all(0.6 < ratio < 1.6 for ratio in ratios.values())
    true = [replace(estimate, position=rig.places[row]) for row, estimate in enumerate(found[Method.SURFACE].values())]
    assert spacing_ratio(layout, true) == pytest.approx(1.0, abs=0.02)
    assert spacing_ratio(layout, [replace(estimate, position=1.1 * estimate.position) for estimate in true]) == pytest.approx(
        1.1, abs=0.03
    )
    assert spacing_ratio(layout, []) is None
