"""One turn for a module or one for each taxel, and plain mistakes of the axes."""

from dataclasses import replace

import numpy as np
import pytest

from skincal.axes.module_axes import (
    SIGNED_PERMUTATIONS,
    AxisMistakeKind,
    ModulePlan,
    find_axes,
    score_permutations,
    share_of_own_errors,
)
from skincal.axes.skin_turns import TurnState, find_noise, find_turns, joined, pokes_by_taxel
from skincal.axes.turn_fit import AxisPokes
from skincal.contacts.outcome import Contact
from skincal.contacts.value_order import OrderOfValues, ValueOrderCounts
from skincal.geometry import rotation_by
from skincal.model.skin_axes import ValueOrder
from tests.skincal.axes.axis_support import FORCE_NOISE_N, READING_NOISE, make_pokes, random_rotation

MODULES, TAXELS, POKES = 3, 4, 5


def skin(seed, *, own_axes=False, change=None, module_change=None, lean=15.0, pokes=POKES):
    """Make pokes on modules; `change` maps true readings to those that come, `module_change` replaces it on module 1."""
    rng = np.random.default_rng([7, seed])
    found, plans = {}, []
    for module in range(MODULES):
        rotation = random_rotation(rng)
        # Glued by hand: some degrees off the plan.
        axes = rotation @ rotation_by(np.radians(3.0) * rng.normal(size=3))
        channels = tuple(range(TAXELS * module, TAXELS * (module + 1)))
        plans.append(ModulePlan(module, channels, rotation))
        for channel in channels:
            turned = axes @ rotation_by(np.array([0.0, 0.0, rng.uniform(-3.0, 3.0)])) if own_axes else axes
            made = make_pokes(rng, turned, pokes, lean)
            matrix = module_change if module_change is not None and module == 1 else change
            readings = made.readings if matrix is None else made.readings @ matrix.T
            found[channel] = AxisPokes(made.forces, readings, made.pokes + 100 * channel)
    return found, plans


def findings(seed, **how):
    pokes, plans = skin(seed, **how)
    turns = find_turns(pokes, FORCE_NOISE_N)
    return turns, find_axes(turns, plans)


@pytest.mark.parametrize("seed", range(3))
def test_taxels_in_the_axes_of_their_module_share_one_turn(seed):
    _, found = findings(seed)
    assert all(module.is_shared and not module.is_separate for module in found.modules)
    assert found.log_odds_shared > 10.0
    assert found.mistakes == ()
    assert all(np.degrees(module.spread) < 2.0 for module in found.modules)


@pytest.mark.parametrize("seed", range(3))
def test_taxels_with_axes_of_their_own_are_separate(seed):
    _, found = findings(seed, own_axes=True)
    assert all(module.is_separate for module in found.modules)
    assert found.log_odds_shared < -50.0
    assert found.mistakes == ()


def test_straight_pokes_decide_little_between_one_turn_and_many():
    """All normals of a flat module agree in both cases, and nothing tells the turns in the plane."""
    for own_axes in (False, True):
        turns, found = findings(4, own_axes=own_axes, lean=0.0)
        assert all(turn.state is TurnState.IN_PLANE_UNKNOWN for turn in turns.taxels.values())
        assert not any(module.is_separate for module in found.modules)


EXCHANGED_XY = np.array([[0.0, 1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])
EXCHANGED_XZ = np.array([[0.0, 0.0, 1.0], [0.0, 1.0, 0.0], [1.0, 0.0, 0.0]])
QUARTER = np.array([[0.0, 1.0, 0.0], [-1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])
MISTAKES = [
    (np.diag([-1.0, 1.0, 1.0]), AxisMistakeKind.OPPOSITE, ("x",), ("-x", "y", "z")),
    (np.diag([1.0, -1.0, 1.0]), AxisMistakeKind.OPPOSITE, ("y",), ("x", "-y", "z")),
    (np.diag([1.0, 1.0, -1.0]), AxisMistakeKind.OPPOSITE, ("z",), ("x", "y", "-z")),
    (EXCHANGED_XY, AxisMistakeKind.EXCHANGED, ("x", "y"), ("y", "x", "z")),
    (EXCHANGED_XZ, AxisMistakeKind.EXCHANGED, ("x", "z"), ("z", "y", "x")),
    (np.roll(np.eye(3), 1, axis=0), AxisMistakeKind.OTHER, (), ("z", "x", "y")),
]


@pytest.mark.parametrize("seed", range(3))
@pytest.mark.parametrize(("change", "kind", "axes", "directions"), MISTAKES)
def test_a_plain_mistake_is_named_within_20_pokes(seed, change, kind, axes, directions):
    """Twenty pokes in all: one or two on each taxel."""
    pokes, plans = skin(seed, change=change, pokes=2)
    few = dict(list(pokes.items())[:10])
    found = find_axes(find_turns(few, FORCE_NOISE_N), plans)
    (mistake,) = found.mistakes
    assert (mistake.kind, mistake.module, mistake.axes, mistake.directions) == (kind, None, axes, directions)
    assert mistake.log_odds > np.log(20.0)


def test_taxels_that_one_poke_presses_count_as_one():
    pokes, plans = skin(1, change=EXCHANGED_XY, pokes=3, lean=7.0)
    turns = find_turns(pokes, FORCE_NOISE_N)
    together = {channel: replace(each, pokes=np.arange(3)) for channel, each in turns.pokes.items()}
    share = share_of_own_errors(plans[0].channels, together)
    assert share == pytest.approx(1.0 / TAXELS)
    (alone,) = find_axes(turns, plans).mistakes
    (mistake,) = find_axes(replace(turns, pokes=together), plans).mistakes
    assert mistake.kind is alone.kind is AxisMistakeKind.EXCHANGED
    assert mistake.log_odds < 0.8 * alone.log_odds
    turn = find_axes(turns, plans).modules[0].turn
    every, fourth = (score_permutations(turn, plans[0], 0.0, each) for each in (1.0, share))
    # A fit has a quarter of the information, so scores of one hand differ by a quarter.
    right_handed = [place for place, permutation in enumerate(SIGNED_PERMUTATIONS) if np.linalg.det(permutation) > 0]
    assert np.diff(fourth[right_handed]) == pytest.approx(share * np.diff(every[right_handed]), rel=1e-9)


def curved_skin(change):
    """Make pokes on a module that a curved part bends by 30 degrees to each side; each taxel has its own axes."""
    rng, found = np.random.default_rng(11), {}
    plan = random_rotation(rng)
    for channel, bend in enumerate(np.radians(np.linspace(-30.0, 30.0, 6))):
        made = make_pokes(rng, plan @ rotation_by(np.array([0.05, bend, 0.05])), 8, 15.0)
        found[channel] = AxisPokes(made.forces, made.readings @ change.T, made.pokes + 100 * channel)
    return found, [ModulePlan(1, tuple(found), plan)]


@pytest.mark.parametrize(("change", "kind", "axes", "directions"), [*MISTAKES[:2], MISTAKES[3], (np.eye(3), None, (), ())])
def test_mistakes_of_taxels_with_axes_of_their_own_are_named_on_a_curved_module(change, kind, axes, directions):
    """x mirrored, y mirrored, and x and y exchanged differ by turns that only the plan tells."""
    pokes, plans = curved_skin(change)
    found = find_axes(find_turns(pokes, FORCE_NOISE_N), plans)
    assert found.modules[0].is_separate
    assert [(mistake.kind, mistake.axes, mistake.directions) for mistake in found.mistakes] == (
        [] if kind is None else [(kind, axes, directions)]
    )


@pytest.mark.parametrize("seed", range(4))
def test_a_right_scene_has_no_mistake_with_few_pokes(seed):
    pokes, plans = skin(seed, pokes=2)
    for count in (1, 3, 10):
        assert find_axes(find_turns(dict(list(pokes.items())[:count]), FORCE_NOISE_N), plans).mistakes == ()


@pytest.mark.parametrize(("matrix", "turn"), [(QUARTER, 90.0), (QUARTER @ QUARTER, 180.0), (QUARTER.T, 270.0)])
def test_one_turned_module_is_named_with_its_angle(matrix, turn):
    _, found = findings(5, module_change=matrix)
    (mistake,) = found.mistakes
    assert (mistake.kind, mistake.module) == (AxisMistakeKind.TURNED, 1)
    # Readings that are turned by -90 degrees have axes that are turned by 90 degrees.
    assert mistake.turn_deg == pytest.approx(turn)


def test_a_wrong_order_of_values_comes_before_all_other_mistakes():
    """Readings of other taxels look like any mistake: they are not named, also while the order is only doubted."""
    pokes, plans = skin(9, change=EXCHANGED_XY)
    turns = find_turns(pokes, FORCE_NOISE_N)
    for counts, kinds in ((ValueOrderCounts(12, 4, 12), [AxisMistakeKind.ORDER]), (ValueOrderCounts(3, 1, 2), [])):
        found = find_axes(turns, plans, OrderOfValues(counts, ValueOrder.BY_TAXEL))
        assert [mistake.kind for mistake in found.mistakes] == kinds
    # Right, and with another axis in the place of z: a third of the pokes is on z by chance in the other order.
    for counts in (ValueOrderCounts(12, 12, 4), ValueOrderCounts(12, 0, 4)):
        found = find_axes(turns, plans, OrderOfValues(counts, ValueOrder.BY_TAXEL))
        assert [mistake.kind for mistake in found.mistakes] == [AxisMistakeKind.EXCHANGED]


def test_without_a_plan_pushes_tell_a_negated_z_and_a_mirror():
    for change, axes in ((np.diag([1.0, 1.0, -1.0]), ("z",)), (np.diag([-1.0, 1.0, 1.0]), ("y",)), (np.eye(3), None)):
        pokes, _ = skin(6, change=change)
        found = find_axes(find_turns(pokes, FORCE_NOISE_N), ())
        assert [mistake.axes for mistake in found.mistakes] == ([] if axes is None else [axes])


def test_the_noise_of_the_readings_and_their_ratio_are_found():
    pokes, _ = skin(8, own_axes=True, pokes=12)
    noise = find_noise(list(pokes.values()), FORCE_NOISE_N)
    size = np.median(np.linalg.norm(joined(list(pokes.values())).readings, axis=1))
    assert max(noise.reading, noise.angle * size) == pytest.approx(READING_NOISE, rel=0.25)
    assert np.exp(noise.log_ratio) == pytest.approx(0.6, rel=0.03)
    assert noise.log_ratio_sd < 0.1


def test_contacts_give_forces_in_the_link_frame_and_only_readings_of_pressed_taxels():
    turned = np.eye(4)
    turned[:3, :3] = rotation_by(np.array([0.0, 0.0, np.pi / 2.0]))
    vectors = np.array([[1.0, 2.0, -8.0], [0.5, 0.1, -5.0], [0.1, 0.2, -1.0], [np.nan, np.nan, np.nan]])
    contact = Contact(
        7, 0.0, 0.3, np.array([1.0, 2.0, -6.0]), np.zeros(3), np.array([4, 5, 6, 9]), np.array([8.0, 6.0, 1.0, 7.0]), turned,
        "", 0.0, True, vectors=vectors,
    )  # fmt: skip
    found = pokes_by_taxel([contact])
    assert sorted(found) == [4, 5]
    assert found[4].forces == pytest.approx(np.array([[-2.0, 1.0, -6.0]]))
    assert found[5].readings == pytest.approx(vectors[1:2])
    assert found[5].pokes.tolist() == [7]
