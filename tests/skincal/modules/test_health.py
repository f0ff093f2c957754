"""Modules that are not as planned are found, and a damaged layout is corrected from estimates of single taxels."""

from dataclasses import replace
from functools import cache

import numpy as np
import pytest

from skincal.methods import estimate_taxels
from skincal.model.skin import MODULE_KINDS, Layout, Module, ModuleKind
from skincal.modules.health import (
    MisplacedModule,
    MisplacementKind,
    ModuleChange,
    Unrepaired,
    UnrepairedKind,
    _intended_turn,
    changes_of,
    correct_layout,
    find_misplaced_modules,
    repair_layout,
    spacing_ratio,
)
from skincal.modules.pose import ModuleModel
from skincal.simulation.contacts import simulate_contacts, unguided
from skincal.simulation.rig_errors import RigErrors
from skincal.taxels.result import Estimate, Method, State
from tests.skincal.sim_support import make_rig

MAX_PLAN_ERROR_M = 0.0002
"""Of a corrected plan: two files may give the same angle with other digits."""
CASES = [("noise", 1), ("noise", 2), ("paper", 1), ("paper", 3)]


@cache
def poked(seed, errors="noise"):
    """A rig, its layout, and the estimates by method, of three pokes a taxel."""
    rng, rig = np.random.default_rng(seed), make_rig(getattr(RigErrors, errors)(), seed)
    contacts, methods = simulate_contacts(rig, unguided(rig, 3, rng), rng), [Method.FREE, Method.SURFACE, Method.MODULES]
    layout = rig.scene.skin.layout
    found = estimate_taxels(contacts, rig.channels.tolist(), methods, rig.scene.noise, rig.surface, model=model_of(rig, layout))
    return rig, layout, found


def model_of(rig, layout):
    return ModuleModel(layout, rig.scene.skin.anchor, rig.surface)


def damaged(layout, **changes):
    """A layout with some modules changed: by index, a function of the module."""
    modules = list(layout.modules)
    for name, change in changes.items():
        index = int(name.removeprefix("m"))
        modules[index] = change(modules[index])
    return Layout(tuple(modules), layout.width)


def mirrored(module):
    return replace(module, mirror=not module.mirror)


def turned(degrees):
    return lambda module: replace(module, angle=module.angle + np.radians(degrees))


def both(degrees):
    return lambda module: mirrored(turned(degrees)(module))


def exchanged(layout, *ring):
    """A layout in which each of some modules has the channels of the next."""
    modules = list(layout.modules)
    for here, there in zip(ring, (*ring[1:], ring[0]), strict=True):
        modules[here] = replace(modules[here], first_channel=layout.modules[there].first_channel)
    return Layout(tuple(modules), layout.width)


def several(layout):
    return damaged(exchanged(layout, 0, 3, 6), m1=mirrored, m4=turned(120))


DAMAGES = {
    "mirrored": lambda layout: damaged(layout, m0=mirrored),
    "turned": lambda layout: damaged(layout, m2=turned(120)),
    "turned half": lambda layout: damaged(layout, m2=turned(180)),
    "turned 90": lambda layout: damaged(layout, m5=turned(-90)),
    "mirrored the other way": lambda layout: damaged(layout, m1=both(180)),
    "mirrored and turned": lambda layout: damaged(layout, m6=both(-120)),
    "swapped": lambda layout: exchanged(layout, 1, 5),
    "cycle": lambda layout: exchanged(layout, 0, 4, 2),
    "swapped and turned": lambda layout: damaged(exchanged(layout, 1, 5), m5=turned(120)),
    "swapped and mirrored": lambda layout: damaged(exchanged(layout, 1, 5), m1=both(180)),
    "two swaps": lambda layout: exchanged(exchanged(layout, 1, 5), 0, 3),
    "two at once": lambda layout: damaged(layout, m1=mirrored, m4=turned(-120)),
    "several": several,
}


@pytest.mark.parametrize(("errors", "seed"), CASES)
def test_modules_as_planned_are_left_alone(errors, seed):
    rig, layout, found = poked(seed, errors)
    model = model_of(rig, layout)
    assert find_misplaced_modules(model, found[Method.SURFACE]) == find_misplaced_modules(model, {}) == ()
    mend = repair_layout(model, found[Method.SURFACE])
    assert (mend.layout, mend.changes, mend.left) == (layout, (), ())


@pytest.mark.parametrize(("errors", "seed"), CASES)
@pytest.mark.parametrize("turn", [None, 120, -120])
def test_a_mirrored_or_turned_module_is_named(errors, seed, turn):
    rig, layout, found = poked(seed, errors)
    model = model_of(rig, damaged(layout, m2=mirrored if turn is None else turned(-turn)))
    (said,) = find_misplaced_modules(model, found[Method.SURFACE])
    assert (said.kind, said.module) == (MisplacementKind.MIRRORED if turn is None else MisplacementKind.TURNED, 29)
    if turn is not None:
        assert np.degrees(said.turn) == pytest.approx(turn)
    assert said.after < (0.6 if errors == "noise" else 1.0) * said.before


# If a rig bends the whole skin by more than half a module (seed 3), a swap is named as another mistake.
@pytest.mark.parametrize(("errors", "seed"), CASES[:3])
def test_swapped_modules_are_named_both(errors, seed):
    rig, layout, found = poked(seed, errors)
    one, other = layout.modules[1], layout.modules[5]
    wrong = damaged(
        layout,
        m1=lambda module: replace(module, place=other.place, angle=other.angle),
        m5=lambda module: replace(module, place=one.place, angle=one.angle),
    )
    said = find_misplaced_modules(model_of(rig, wrong), found[Method.SURFACE])
    swapped = MisplacementKind.SWAPPED
    assert [(each.kind, each.module, each.other) for each in said] == [(swapped, 28, 26), (swapped, 26, 28)]
    assert all(each.after < 0.5 * each.before for each in said)


def test_of_two_modules_the_turned_one_is_named():
    rig, layout, found = poked(1)
    two = damaged(Layout(layout.modules[:2], layout.width), m1=turned(120))
    (said,) = find_misplaced_modules(model_of(rig, two), found[Method.SURFACE])
    assert (said.module, said.kind) == (layout.modules[1].id, MisplacementKind.TURNED)


@pytest.mark.parametrize(("each", "named"), [(2, 1), (3, 0)])
def test_taxels_of_the_same_pokes_are_one_position(each, named):
    """A turned module whose twelve taxels are estimated at six positions, and at four, which are too few."""
    rig, layout, found = poked(1)
    model, estimates = model_of(rig, damaged(layout, m2=turned(-120))), dict(found[Method.SURFACE])
    channels = model.channels_of([2])
    for first in range(0, len(channels), each):
        together = channels[first : first + each]
        middle = np.mean([estimates[channel].position for channel in together], axis=0)
        estimates |= {channel: replace(estimates[channel], position=middle) for channel in together}
    assert len(find_misplaced_modules(model, estimates)) == named


def test_a_few_estimates_close_together_show_no_turn():
    """Six of a module's taxels, drawn together to half their distance and scattered by 2 mm."""
    rig, layout, _ = poked(1)
    model = model_of(rig, layout)
    for seed in range(40):
        rng, estimates = np.random.default_rng(seed), {}
        for module in range(2):
            every = model.channels_of([module])
            places = np.array([rig.places[rig.row_of(channel)] for channel in every])
            some = rng.permutation(len(every))[:6]
            near = 0.5 * (places[some] + places[some].mean(axis=0)) + 0.002 * rng.normal(size=(6, 3))
            for row, place in zip(some.tolist(), near, strict=True):
                normal = rig.normals[rig.row_of(every[row])]
                estimates[every[row]] = Estimate(every[row], Method.SURFACE, State.TOUCHED, 3, position=place, normal=normal)
        assert all(said.after < 0.8 * said.before for said in find_misplaced_modules(model, estimates))


def test_neighbours_are_as_far_apart_as_planned():
    rig, layout, found = poked(1)
    ratios = {method: spacing_ratio(layout, list(estimates.values())) for method, estimates in found.items()}
    assert 0.98 < ratios[Method.MODULES] < 1.02
    assert all(0.6 < ratio < 1.6 for ratio in ratios.values())
    true = [replace(estimate, position=rig.places[row]) for row, estimate in enumerate(found[Method.SURFACE].values())]
    wider = [replace(estimate, position=1.1 * estimate.position) for estimate in true]
    assert spacing_ratio(layout, true) == pytest.approx(1.0, abs=0.02)
    assert spacing_ratio(layout, wider) == pytest.approx(1.1, abs=0.03)
    assert spacing_ratio(layout, []) is None


# ---- correction ----


def check_repair(rig, layout, estimates):
    """Correct a layout and compare it with the rig's own."""
    model, right = model_of(rig, layout), rig.scene.skin.layout
    assert find_misplaced_modules(model, estimates)
    mend = repair_layout(model, estimates)
    assert mend.left == ()
    assert find_misplaced_modules(model.with_layout(mend.layout), estimates) == ()
    np.testing.assert_allclose(mend.layout.places, right.places, atol=MAX_PLAN_ERROR_M)
    np.testing.assert_array_equal(mend.layout.module_of, right.module_of)


@pytest.mark.parametrize("name", DAMAGES)
def test_a_damaged_layout_is_corrected(name):
    """From true positions with noise of 1.5 mm, and from pokes."""
    for seed in (1, 2):
        rig, layout, found = poked(seed)
        rng, estimates = np.random.default_rng(seed), found[Method.SURFACE]
        noisy = {
            channel: replace(estimate, position=rig.places[row] + rng.normal(0.0, 0.0015, 3))
            for row, (channel, estimate) in enumerate(estimates.items())
        }
        for known in (noisy, estimates):
            check_repair(rig, DAMAGES[name](layout), known)


def test_with_the_papers_rig_errors_single_mistakes_and_most_cycles_are_corrected():
    rig, layout, found = poked(1, "paper")
    for name in ("mirrored", "turned", "swapped"):
        check_repair(rig, DAMAGES[name](layout), found[Method.SURFACE])
    closed = 0
    for seed in range(1, 7):
        rig, layout, found = poked(seed, "paper")
        mend = repair_layout(model_of(rig, DAMAGES["cycle"](layout)), found[Method.SURFACE])
        assert mend.misfits
        closed += np.array_equal(mend.layout.module_of, layout.module_of)
    assert closed >= 5, "measured: nine of ten"


SQUARES = {
    "mirrored": lambda layout: damaged(layout, m0=mirrored),
    "turned": lambda layout: damaged(layout, m3=turned(90)),
    "both": lambda layout: damaged(layout, m2=both(90)),
    "swapped": lambda layout: exchanged(layout, 0, 3),
}


@pytest.mark.parametrize("name", SQUARES)
def test_square_modules_are_corrected_without_a_surface(name):
    rig, rng = make_rig(RigErrors.noise(), 1, "flat-patch"), np.random.default_rng(4)
    contacts = simulate_contacts(rig, unguided(rig, 3, rng), rng)
    found = estimate_taxels(contacts, rig.channels.tolist(), [Method.FREE], rig.scene.noise, None)[Method.FREE]
    known = {
        channel: replace(estimate, position=rig.places[row] + rng.normal(0.0, 0.001, 3), normal=np.array([0.0, 0.0, 1.0]))
        for row, (channel, estimate) in enumerate(found.items())
    }
    assert rig.surface is None
    check_repair(rig, SQUARES[name](rig.scene.skin.layout), known)


def test_once_the_layout_is_corrected_its_pokes_are_solved_as_those_of_the_right_one():
    rig, layout, found = poked(2)
    wrong, rng = model_of(rig, several(layout)), np.random.default_rng(2)
    make = make_rig(RigErrors.noise(), 2)
    contacts = simulate_contacts(make, unguided(make, 3, rng), rng)

    def errors(model):
        methods = [Method.SURFACE, Method.MODULES]
        solved = estimate_taxels(contacts, rig.channels.tolist(), methods, rig.scene.noise, rig.surface, model=model)
        pairs = zip(solved[Method.MODULES].values(), rig.places, strict=True)
        return np.array([np.nan if each.position is None else np.linalg.norm(each.position - place) for each, place in pairs])

    assert np.isnan(errors(wrong)).sum() == 12, "the search of a module that is planned mirrored does not settle: it is blind"
    right = errors(wrong.with_layout(repair_layout(wrong, found[Method.SURFACE]).layout))
    assert right.mean() == pytest.approx(errors(model_of(rig, layout)).mean(), abs=1e-4)


# ---- what cannot be corrected ----


def test_a_swap_with_an_unknown_module_is_not_corrected():
    rig, layout, found = poked(1)
    unseen = set(layout.modules[5].channels.tolist())
    estimates = {channel: estimate for channel, estimate in found[Method.SURFACE].items() if channel not in unseen}
    model = model_of(rig, exchanged(layout, 1, 5))
    (said,) = find_misplaced_modules(model, estimates)
    mend = repair_layout(model, estimates)
    assert (said.kind, mend.layout, mend.changes) == (MisplacementKind.SWAPPED, model.layout, ())
    assert mend.left == (Unrepaired(UnrepairedKind.NO_RING, (said.module, said.other)),)


def of_kinds(*kinds):
    place = np.array([0.04, 0.0])
    modules = (Module(10 + i, MODULE_KINDS[kind], 12 * i, i * place, 0.0, False) for i, kind in enumerate(kinds))
    return Layout(tuple(modules), 12 * len(kinds))


def swap(module, other):
    return MisplacedModule(module, MisplacementKind.SWAPPED, 0.04, 0.001, other=other)


TRIANGLES = ["triangle_12"] * 5
MIXED = ["triangle_12", "triangle_10pad", "triangle_12"]


@pytest.mark.parametrize(
    ("kinds", "swaps", "firsts", "left"),
    [
        (MIXED, [(10, 11), (11, 10)], [0, 12, 24], [(UnrepairedKind.UNLIKE, (10, 11))]),
        (MIXED, [(10, 12), (12, 10)], [24, 12, 0], []),
        # What is in 11's place has the channels of 10, and so on.
        (TRIANGLES, [(10, 11), (11, 12), (12, 10), (13, 14)], [24, 0, 12, 36, 48], [(UnrepairedKind.NO_RING, (13, 14))]),
        (TRIANGLES, [(10, 11), (11, 12), (12, 11)], [0, 24, 12, 36, 48], [(UnrepairedKind.NO_RING, (10, 11))]),
    ],
    ids=["other pads", "same pads", "cycle and chain", "chain into a cycle"],
)
def test_modules_with_the_same_pads_in_a_cycle_exchange_their_channels(kinds, swaps, firsts, left):
    layout = of_kinds(*kinds)
    other, unrepaired = correct_layout(layout, [swap(*pair) for pair in swaps])
    assert [module.first_channel for module in other.modules] == firsts
    assert unrepaired == tuple(Unrepaired(*each) for each in left)
    assert (other is layout) == (firsts == [module.first_channel for module in layout.modules])


def test_a_module_off_its_place_and_a_correction_that_is_no_nearer_are_left(monkeypatch):
    layout = of_kinds("triangle_12", "triangle_12")
    near = MisplacedModule(10, MisplacementKind.TURNED, 0.02, 0.016, turn=float(np.pi))
    far = MisplacedModule(11, MisplacementKind.MIRRORED, 0.05, 0.018)
    mended, left = correct_layout(layout, [near, far])
    assert [change.module for change in changes_of(layout, mended)] == [10]
    assert left == (Unrepaired(UnrepairedKind.STILL_OFF, (11,), 0.018),)
    rig, layout, found = poked(1)
    wrong = MisplacedModule(28, MisplacementKind.TURNED, 0.01, 0.001, turn=float(np.radians(120.0)))
    monkeypatch.setattr("skincal.modules.health.find_misplaced_modules", lambda *_: (wrong,))
    mend = repair_layout(model_of(rig, layout), found[Method.SURFACE])
    assert (mend.layout, mend.changes) == (layout, ())
    assert mend.left[0] == Unrepaired(UnrepairedKind.NO_NEARER, (28,))


@pytest.mark.parametrize(
    ("seen", "straight", "mirrored"),
    [(175.0, 180, 180), (168.0, 180, 168), (-57.0, -60, -60), (-47.0, -47, -47), (22.0, 0, 0)],
)
def test_a_measured_turn_means_a_symmetry_of_the_outline_or_a_step(seen, straight, mirrored):
    """A parallelogram lies on itself after half a turn, and its mirror image lies on it after none."""
    outline = np.array([[-0.02, -0.01], [0.01, -0.01], [0.02, 0.01], [-0.01, 0.01]])
    module = Module(1, ModuleKind("slanted", np.zeros((1, 2)), outline, 0), 0, np.zeros(2), 0.0, False)
    for turn, expected in ((False, straight), (True, mirrored)):
        assert np.degrees(_intended_turn(float(np.radians(seen)), module, mirrored=turn)) == pytest.approx(expected)


def test_a_change_has_the_keys_of_the_file():
    assert ModuleChange(17, angle=float(np.radians(-60.0)), mirror=True).keys == {"angle_deg": -60, "mirror": True}
    assert ModuleChange(17, first_channel=204).keys == {"first_channel": 204}
    assert ModuleChange(17, angle=0.1).keys == {"angle_deg": pytest.approx(5.72958, abs=1e-5)}
    assert ModuleChange(17).keys == {}


@pytest.mark.parametrize(("angle", "turn", "then"), [(-180, 120, -60), (120, 120, -120), (-60, -120, 180), (0, 180, 180)])
def test_angles_stay_within_half_a_turn(angle, turn, then):
    layout = damaged(of_kinds("triangle_12"), m0=turned(angle))
    other, _ = correct_layout(layout, [MisplacedModule(10, MisplacementKind.TURNED, 0.01, 0.001, turn=float(np.radians(turn)))])
    (change,) = changes_of(layout, other)
    assert change.keys == {"angle_deg": then}
