"""A layout that was damaged is put right from the estimates of single taxels; what cannot be is said."""

from dataclasses import replace

import numpy as np
import pytest

from skincal.methods import estimate_taxels
from skincal.model.skin import KINDS, Layout, Module, ModuleKind
from skincal.modules.health import (
    MisplacedModule,
    MisplacementKind,
    ModuleChange,
    Unrepaired,
    UnrepairedKind,
    _meant,
    changes_of,
    correct_layout,
    find_misplaced_modules,
    repair_layout,
)
from skincal.modules.pose import ModuleModel
from skincal.simulate.contacts import simulate_contacts, unguided
from skincal.simulate.faults import RigErrors
from skincal.taxels.result import Method
from tests.skincal.modules.test_health import poked
from tests.skincal.sim_support import make_rig

OFF = 0.0002
"""m. A plan that was put right lies so near to the undamaged one; two files may say the same angle with other digits."""


def damaged(layout, **changes):
    """A layout that says something else: by index, a dictionary of what it says, or a function of the module."""
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


def taxels(rig, found, seed, sd=0.0015):
    """Estimates of single taxels: their true places and noise."""
    rng = np.random.default_rng(seed)
    return {
        channel: replace(estimate, position=rig.places[row] + rng.normal(0.0, sd, 3))
        for row, (channel, estimate) in enumerate(found[Method.SURFACE].items())
    }


def check_mended(rig, layout, estimates):
    """Put a layout right and compare it with the rig's own."""
    scene = rig.scene
    model = ModuleModel(layout, scene.skin.anchor, rig.surface)
    assert find_misplaced_modules(model, estimates), "the damage is seen"
    mend = repair_layout(model, estimates)
    assert mend.left == ()
    assert find_misplaced_modules(model.with_layout(mend.layout), estimates) == ()
    np.testing.assert_allclose(mend.layout.places, scene.skin.layout.places, atol=OFF)
    np.testing.assert_array_equal(mend.layout.module_of, scene.skin.layout.module_of)
    return mend


@pytest.mark.parametrize("name", DAMAGES)
@pytest.mark.parametrize("seed", [1, 2, 3])
def test_a_damaged_layout_is_put_right_from_taxels_that_are_known_to_two_millimetres(name, seed):
    rig, found = poked(1)
    check_mended(rig, DAMAGES[name](rig.scene.skin.layout), taxels(rig, found, seed))


@pytest.mark.parametrize("name", DAMAGES)
@pytest.mark.parametrize("seed", [1, 2])
def test_a_damaged_layout_is_put_right_from_pokes(name, seed):
    rig, found = poked(seed)
    check_mended(rig, DAMAGES[name](rig.scene.skin.layout), found[Method.SURFACE])


def test_with_the_papers_rig_errors_single_mistakes_are_put_right():
    rig, found = poked(1, "paper")
    for name in ("mirrored", "turned", "swapped"):
        check_mended(rig, DAMAGES[name](rig.scene.skin.layout), found[Method.SURFACE])


def test_with_the_papers_rig_errors_a_ring_closes_where_one_end_is_less_sure():
    closed = 0
    for seed in range(1, 7):
        rig, found = poked(seed, "paper")
        layout = DAMAGES["cycle"](rig.scene.skin.layout)
        mend = repair_layout(ModuleModel(layout, rig.scene.skin.anchor, rig.surface), found[Method.SURFACE])
        assert mend.misfits
        closed += np.array_equal(mend.layout.module_of, rig.scene.skin.layout.module_of)
    assert closed >= 5, "measured: nine of ten"


def test_a_layout_that_is_right_is_left_as_it_is():
    rig, found = poked(1)
    layout = rig.scene.skin.layout
    mend = repair_layout(ModuleModel(layout, rig.scene.skin.anchor, rig.surface), found[Method.SURFACE])
    assert (mend.layout, mend.changes, mend.left) == (layout, (), ())


@pytest.mark.parametrize(
    "damage",
    [
        lambda layout: damaged(layout, m0=mirrored),
        lambda layout: damaged(layout, m3=turned(90)),
        lambda layout: damaged(layout, m2=both(90)),
        lambda layout: exchanged(layout, 0, 3),
    ],
)
def test_square_modules_in_space_are_put_right_without_a_surface(damage):
    rig = make_rig(RigErrors.noise(), 1, "flat-patch")
    rng = np.random.default_rng(4)
    contacts = simulate_contacts(rig, unguided(rig, 3, rng), rng)
    found = estimate_taxels(contacts, rig.channels.tolist(), [Method.FREE], rig.scene.noise, None)[Method.FREE]
    known = {
        channel: replace(estimate, position=rig.places[row] + rng.normal(0.0, 0.001, 3), normal=np.array([0.0, 0.0, 1.0]))
        for row, (channel, estimate) in enumerate(found.items())
    }
    assert rig.surface is None
    check_mended(rig, damage(rig.scene.skin.layout), known)


def test_of_two_modules_the_turned_one_is_named_and_not_the_other():
    rig, found = poked(1)
    layout = rig.scene.skin.layout
    two = Layout(layout.modules[:2], layout.width)
    model = ModuleModel(damaged(two, m1=turned(120)), rig.scene.skin.anchor, rig.surface)
    (said,) = find_misplaced_modules(model, found[Method.SURFACE])
    assert (said.module, said.kind) == (layout.modules[1].id, MisplacementKind.TURNED)


def test_pokes_of_a_wrong_layout_are_solved_as_well_as_those_of_the_right_one_once_it_is_put_right():
    rig, found = poked(2)
    wrong = ModuleModel(several(rig.scene.skin.layout), rig.scene.skin.anchor, rig.surface)
    right = wrong.with_layout(repair_layout(wrong, found[Method.SURFACE]).layout)
    rng = np.random.default_rng(2)
    make = make_rig(RigErrors.noise(), 2)
    contacts = simulate_contacts(make, unguided(make, 3, rng), rng)

    known: list[bool] = []

    def error(model):
        solved = estimate_taxels(
            contacts, rig.channels.tolist(), [Method.SURFACE, Method.MODULES], rig.scene.noise, rig.surface, model=model
        )[Method.MODULES]
        known[:] = [estimate.position is not None for estimate in solved.values()]
        off = [
            estimate.position - place
            for estimate, place in zip(solved.values(), rig.places, strict=True)
            if estimate.position is not None
        ]
        return float(np.mean(np.linalg.norm(off, axis=1)))

    planned = error(ModuleModel(rig.scene.skin.layout, rig.scene.skin.anchor, rig.surface))
    error(wrong)
    assert known.count(False) == 12, "the search of a module that is planned as its mirror image does not settle: it is blind"
    assert error(right) == pytest.approx(planned, abs=1e-4)
    assert all(known)


# What cannot be put right


def test_a_swap_with_a_module_that_is_not_known_is_not_put_right():
    rig, found = poked(1)
    layout = rig.scene.skin.layout
    unseen = set(layout.modules[5].channels.tolist())
    estimates = {channel: estimate for channel, estimate in found[Method.SURFACE].items() if channel not in unseen}
    model = ModuleModel(exchanged(layout, 1, 5), rig.scene.skin.anchor, rig.surface)
    (said,) = find_misplaced_modules(model, estimates)
    assert said.kind is MisplacementKind.SWAPPED
    mend = repair_layout(model, estimates)
    assert (mend.layout, mend.changes) == (model.layout, ())
    assert mend.left == (Unrepaired(UnrepairedKind.NO_RING, (said.module, said.other)),)


def of_kinds(*kinds):
    return Layout(
        tuple(
            Module(10 + number, KINDS[kind], 12 * number, np.array([0.04 * number, 0.0]), 0.0, False)
            for number, kind in enumerate(kinds)
        ),
        12 * len(kinds),
    )


def swap(module, other):
    return MisplacedModule(module, MisplacementKind.SWAPPED, 0.04, 0.001, other=other)


def test_modules_of_other_kinds_do_not_exchange_their_channels():
    layout = of_kinds("triangle_12", "triangle_10pad", "triangle_12")
    same, left = correct_layout(layout, [swap(10, 11), swap(11, 10)])
    assert same is layout
    assert left == (Unrepaired(UnrepairedKind.UNLIKE, (10, 11)),)
    other, left = correct_layout(layout, [swap(10, 12), swap(12, 10)])
    assert left == ()
    assert [module.first_channel for module in other.modules] == [24, 12, 0]


def test_rings_exchange_and_open_chains_do_not():
    layout = of_kinds(*["triangle_12"] * 5)
    ring, left = correct_layout(layout, [swap(10, 11), swap(11, 12), swap(12, 10), swap(13, 14)])
    # What lies in 11's place has the channels of 10, and so on.
    assert [module.first_channel for module in ring.modules] == [24, 0, 12, 36, 48]
    assert left == (Unrepaired(UnrepairedKind.NO_RING, (13, 14)),)
    same, left = correct_layout(layout, [swap(10, 11), swap(11, 12), swap(12, 11)])
    assert [module.first_channel for module in same.modules] == [0, 24, 12, 36, 48]
    assert left == (Unrepaired(UnrepairedKind.NO_RING, (10, 11)),)


def test_a_module_that_lies_beside_its_place_however_it_is_turned_is_left():
    layout = of_kinds("triangle_12", "triangle_12")
    near = MisplacedModule(10, MisplacementKind.TURNED, 0.02, 0.016, turn=float(np.pi))
    far = MisplacedModule(11, MisplacementKind.MIRRORED, 0.05, 0.018)
    mended, left = correct_layout(layout, [near, far])
    assert [change.module for change in changes_of(layout, mended)] == [10]
    assert left == (Unrepaired(UnrepairedKind.STILL_OFF, (11,), 0.018),)


def test_a_correction_that_lies_no_nearer_is_none(monkeypatch):
    rig, found = poked(1)
    model = ModuleModel(rig.scene.skin.layout, rig.scene.skin.anchor, rig.surface)
    wrong = MisplacedModule(28, MisplacementKind.TURNED, 0.01, 0.001, turn=float(np.radians(120.0)))
    monkeypatch.setattr("skincal.modules.health.find_misplaced_modules", lambda *_: (wrong,))
    mend = repair_layout(model, found[Method.SURFACE])
    assert (mend.layout, mend.changes) == (model.layout, ())
    assert mend.left[0] == Unrepaired(UnrepairedKind.NO_NEARER, (28,))


@pytest.mark.parametrize(
    ("seen", "straight", "mirrored"),
    [(175.0, 180, 180), (168.0, 180, 168), (-57.0, -60, -60), (-47.0, -47, -47), (22.0, 0, 0)],
)
def test_a_turn_is_meant_that_lays_the_module_on_itself_or_one_in_steps(seen, straight, mirrored):
    """A parallelogram lies on itself after half a turn, and its mirror image lies on it after none."""
    outline = np.array([[-0.02, -0.01], [0.01, -0.01], [0.02, 0.01], [-0.01, 0.01]])
    module = Module(1, ModuleKind("slanted", np.zeros((1, 2)), outline, 0), 0, np.zeros(2), 0.0, False)
    for turn, expected in ((False, straight), (True, mirrored)):
        assert np.degrees(_meant(float(np.radians(seen)), module, mirrored=turn)) == pytest.approx(expected)


# What the file is to say


def test_a_change_says_what_the_file_is_to_say():
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
