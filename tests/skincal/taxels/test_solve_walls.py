"""Parts with several walls: a push enters from outside, so the outer one of two walls that face it is touched."""

from dataclasses import replace
from functools import lru_cache
from pathlib import Path

import numpy as np
import pytest

from skincal.contacts.outcome import Contact
from skincal.files.layout_sources import Grid, parse_layout
from skincal.guide.believed_positions import plan_from_layout
from skincal.guide.guide import Guide
from skincal.mesh.lay import place_layout
from skincal.mesh.surface import make_surface
from skincal.model.scene import NoiseSettings
from skincal.model.skin import Anchor
from skincal.modules.pose import ModuleModel
from skincal.modules.pose_fit import find_starts
from skincal.session.session import Session
from skincal.simulation.contacts import simulate_contacts
from skincal.simulation.operator import Habits, aimed_presses
from skincal.simulation.rig_errors import RigErrors
from skincal.simulation.simulated_rig import Rig
from skincal.taxels.result import Estimate, Method, State
from skincal.taxels.solve import RIVAL_ESTIMATE_MAX_ODDS
from tests.skincal.estimate_support import solve
from tests.skincal.mesh.mesh_support import bent_plate, together, tube, turned_over
from tests.skincal.poke_script import small_scene
from tests.skincal.taxels.test_solve_rival import plates, press

NOISE = NoiseSettings()
TOP = Anchor(np.zeros(2), np.array([0.0, 0.0, 0.07]), np.array([1.0, 0, 0]), np.array([0.0, 0, 1.0]))


@lru_cache
def plate_scene():
    """The bent plate with 16 x 16 taxels of 5 mm."""
    layout = parse_layout(Grid(16, 16, 5.0).layout_text(), Path("grid.toml"))
    scene = small_scene(channels=256)
    return replace(scene, skin=replace(scene.skin, layout=layout, anchor=TOP)), bent_plate()


def follow_guide(method, seed, pokes):
    """The places and pushes of a simulated hand that follows the guide, and its session."""
    scene, surface = plate_scene()
    layout = scene.skin.layout
    plan = plan_from_layout(layout, place_layout(layout, TOP, surface))
    rig = Rig(scene, surface, replace(RigErrors.paper(), mount_shift=0.003), np.random.default_rng(seed))
    session, guide, rng = Session(scene, surface), Guide(plan, scene.noise, method), np.random.default_rng(seed + 100)
    targets, made = {}, []
    for poke in range(1, pokes + 1):
        target = targets[poke] = guide.update(session.snapshot(), targets.get).target
        aimed = aimed_presses(rig, np.zeros(1, dtype=int), target.place[None], target.push[None], Habits(), rng)
        made.append(aimed)
        for contact in simulate_contacts(rig, aimed, rng, None, poke, Habits()):
            session.add(contact)
    return made, session


@pytest.mark.parametrize("seed", [0, 2])
def test_a_hand_presses_a_thin_plate_from_outside_and_so_all_estimates_lie_there(seed):
    made, session = follow_guide(Method.MODULES, seed, 6)
    for press_ in made:
        assert np.hypot(*press_.points[0, [0, 2]]) > 0.0685
        assert press_.directions[0] @ press_.normals[0] < -np.cos(np.radians(60.0))
    found = session.snapshot().estimates
    known = [e for e in (*found[Method.SURFACE], *found[Method.MODULES]) if e.position is not None and e.contacts]
    assert len(known) > 20
    for estimate in known:
        assert estimate.normal @ estimate.position > 0, "not on the inner face, whose normals point toward the axis"
        assert np.hypot(*estimate.position[[0, 2]]) > 0.0685


def double_tube(*inner: float):
    """Tubes of 40 mm radius with walls of 2 mm, and an inner tube of each further radius, normals outward."""
    walls = [tube(72, 40, radius=r, turn=1.0) for r in (0.04, *inner)]
    return together(walls[0], turned_over(tube(72, 40, radius=0.038, turn=1.0)), *walls[1:])


def poke_tube(rng, number, tilt_deg):
    """A poke on the outer wall near [40, 0, 75] mm, with the noise of the model."""
    around, along = rng.normal(0, 0.0015, 2)
    normal = np.array([np.cos(around / 0.04), np.sin(around / 0.04), 0.0])
    aside = np.cross(normal, rng.normal(size=3))
    push = -normal + np.tan(np.radians(tilt_deg) * rng.uniform()) * aside / np.linalg.norm(aside)
    force = 8.0 * push / np.linalg.norm(push)
    moment = np.cross(0.04 * normal + [0, 0, 0.075 + along], force) + 0.01 * rng.standard_normal(3)
    return Contact(
        number, 0, 1, force + 0.1 * rng.standard_normal(3), moment, np.array([0]), np.array([50.0]), np.eye(4), "", 0.0, True
    )


@pytest.mark.parametrize("inner", [(), (0.034,)], ids=["tube", "tube with a frame 4 mm below its cover"])
@pytest.mark.parametrize(("pokes", "tilt_deg"), [(1, 15.0), (2, 5.0), (2, 28.0), (3, 5.0), (6, 15.0)])
def test_of_two_walls_that_face_the_push_the_outer_one_counts(inner, pokes, tilt_deg):
    surface, far = double_tube(*inner), 0
    for seed in range(60):
        rng = np.random.default_rng(seed)
        contacts = [poke_tube(rng, number, tilt_deg) for number in range(1, pokes + 1)]
        estimate = solve(contacts, [0], Method.SURFACE, NOISE, surface)[0]
        assert estimate.state is State.TOUCHED
        radius = np.hypot(*estimate.position[:2])
        if estimate.position[0] < 0:
            # Only if the noise makes it very unlikely to be the near wall, and then that is a rival.
            far += 1
            assert estimate.rival is not None
            assert estimate.rival.position[0] > 0
        else:
            assert radius == pytest.approx(0.04, abs=1e-4), "not the frame, into whose gap no tip gets"
        if pokes == 1:
            assert estimate.rival is None
    assert far <= 1


def test_one_axis_through_two_plates_means_the_first():
    estimate = solve([press(1, np.zeros(3), [0.1, 0.0, -1.0])], [0], Method.SURFACE, NOISE, plates(0.0, -0.03))[0]
    np.testing.assert_allclose(estimate.position, 0.0, atol=1e-12)
    assert estimate.rival is None


def test_the_odds_of_a_covered_wall_hold_where_one_push_in_twenty_reaches_it():
    """Both walls are poked as often here, and what is poked below counts a twentieth."""
    noise = NoiseSettings(force=1e-9, moment=0.02, contact=1e-9, reach=1e-9)
    surface, rng = plates(0.0, -0.02, cells=4), np.random.default_rng(2)
    off, variance, seen = 0.0, 0.0, 0
    for _ in range(900):
        depth = -0.02 * int(rng.integers(2))
        tilts = rng.normal(0, 0.1, (3, 2))
        contacts = [
            press(i, [0.0, 0.0, depth], [*tilt, -1.0], 0.02 * rng.standard_normal(3)) for i, tilt in enumerate(tilts, start=1)
        ]
        estimate = solve(contacts, [0], Method.SURFACE, noise, surface)[0]
        if estimate.position is None or estimate.rival is None:
            continue
        assert 1.0 <= estimate.rival.odds < RIVAL_ESTIMATE_MAX_ODDS
        is_wrong, share = abs(estimate.position[2] - depth) > 0.01, 1.0 / (1.0 + estimate.rival.odds)
        weight = 1.0 if depth == 0.0 else 1 / 20
        seen, off, variance = seen + 1, off + weight * (is_wrong - share), variance + weight**2 * share * (1 - share)
    assert seen > 50
    assert abs(off) < 3.5 * np.sqrt(variance)


def shifted(*shift):
    """A plate of 120 mm that faces +z."""
    plate = plates(0.0)
    return make_surface(plate.vertices + np.array(shift), plate.triangles)


def test_the_floor_beside_a_step_is_not_covered_by_it():
    # A step 8 mm high begins 2 mm from the poke; the force comes from above the step, through its edge.
    step = shifted(0.062, 0.0, 0.008)
    push = [-0.9, 0.0, -1.0]
    estimate = solve(
        [press(i, [0.0, y, 0.0], push) for i, y in enumerate((-1e-4, 1e-4), start=1)],
        [0], Method.SURFACE, NOISE, together(plates(0.0), step),
    )[0]  # fmt: skip
    assert estimate.rival is not None, "the step's top and the floor fit one direction alike"
    assert sorted([estimate.position[2], estimate.rival.position[2]]) == pytest.approx([0.0, 0.008], abs=1e-9)


def test_a_place_in_a_gap_counts_where_no_wall_over_it_fits():
    # The cover has its hole where the push comes in.
    cover = shifted(0.2, 0.0, 0.005)
    estimate = solve([press(1, np.zeros(3), [0.0, 0, -1.0])], [0], Method.SURFACE, NOISE, together(plates(0.0), cover))[0]
    np.testing.assert_allclose(estimate.position, 0.0, atol=1e-12)


def test_a_module_s_search_begins_on_the_outer_face():
    scene, surface = plate_scene()
    layout = scene.skin.layout
    laid, model = place_layout(layout, TOP, surface), ModuleModel(layout, None, surface)
    # The middle of a bent grid's taxels lies 6 mm under its skin, beyond the plate's inner face.
    every = {
        channel: Estimate(channel, Method.SURFACE, State.TOUCHED, 1, laid.places[channel], laid.normals[channel], rms=0.001)
        for channel in layout.channels.tolist()
    }
    start = find_starts(model, [0], [every])[0]
    np.testing.assert_allclose(start.points[0], TOP.point, atol=1e-3)
    assert start.normals[0, 2] > 0.99
