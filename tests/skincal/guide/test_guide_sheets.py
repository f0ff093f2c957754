"""The guide, the verdict and the methods on a soft sheet, on a simulator that shares no code with the program."""

from dataclasses import replace

import numpy as np
import pytest

from skincal.following.session_guide import costs_of
from skincal.guide.believed_positions import believed_from_measured, measured_positions, plan_from_layout
from skincal.guide.guidance import GuidePhase
from skincal.guide.guide import TARGET_MAX_CELL_SHARE, Guide
from skincal.guide.progress import GuideSettings, count_sheet_pokes_left
from skincal.guide.surroundings import Surroundings
from skincal.guide.verdict import check
from skincal.mesh.lay import place_layout
from skincal.mesh.search import nearest_points
from skincal.model.skin import SkinKind
from skincal.modules.pose import ModuleModel
from skincal.pokes import NO_LANDMARK_POKES
from skincal.rig.correction_fit import RigRequest, TaxelGroups, _rigid_groups
from skincal.session.session import Session
from skincal.session.solving import methods_of
from skincal.studies.unmodelled_sheet import SimulatedSheet
from skincal.taxels.result import Estimate, Method, State

SETTINGS = GuideSettings()
METHODS = {Method.SURFACE, Method.MODULES}


def sheet(seed=3):
    """Each test has its own: a poke changes the generators of the hand and the sensor."""
    return SimulatedSheet(seed)


def plan_of(of):
    layout = of.scene.skin.layout
    plan = plan_from_layout(layout, place_layout(layout, of.scene.skin.anchor, of.surface), of.surface)
    assert plan is not None
    return plan


def guided(of, pokes, answers=True):
    """Poke as the guide asks; yield guidance before each poke, and at the end."""
    session, plan = Session(of.scene, of.surface, METHODS), plan_of(of)
    around = Surroundings(of.scene.skin.layout, plan.channels)
    guide = Guide(plan, of.scene.noise, Method.MODULES, surroundings=around)
    contacts, targets = {}, {}
    for number in range(1, pokes + 2):
        guidance = guide.update(session.snapshot(), targets.get)
        yield guidance, guide, session
        if number > pokes or guidance.target is None:
            return
        targets[number] = guidance.target
        contact = of.poke(number, guidance.target.place) if answers else None
        if contact is not None:
            session.add(contact)
            contacts[number] = contact


def test_a_sheet_of_48_taxels_is_not_finished_after_four_pokes_and_its_number_of_pokes_is_said():
    of = sheet()
    plan, noise = plan_of(of), of.scene.noise
    said = costs_of(plan, METHODS, noise)[Method.MODULES]
    board = costs_of(replace(plan, sheet=None), METHODS, noise)[Method.MODULES]
    assert board == 10, "as many as can be tested"
    every = list(guided(of, 100))
    ends = [number for number, (guidance, *_) in enumerate(every) if guidance.phase is GuidePhase.ENOUGH]
    assert ends, "it ends"
    assert every[4][0].phase is not GuidePhase.ENOUGH
    assert sum(map(bool, every[4][0].needs)) == 48, "no taxel is finished"
    assert said == pytest.approx(ends[0], rel=0.6)
    left = [guidance.pokes_left for guidance, *_ in every[: ends[0]]]
    assert left[0] == said
    assert min(left) >= 1
    assert every[ends[0]][0].pokes_left == 0


def test_a_sheet_that_slid_around_a_bend_is_believed_on_the_mesh():
    """The offset of its middle, for all taxels alike, would lead those beyond the bend below or above the mesh."""
    of = sheet()
    plan = plan_of(of)
    along = np.array([0.0, 1.0, 0.0]) if np.ptp(plan.places[:, 0]) < np.ptp(plan.places[:, 1]) else np.array([1.0, 0.0, 0.0])
    known = [
        Estimate(channel, Method.SURFACE, State.TOUCHED, 1, position=place + 0.01 * along, covariance=1e-6 * np.eye(3))
        for channel, place in zip(plan.channels.tolist(), plan.places, strict=True)
    ]
    shifted = believed_from_measured(replace(plan, carrier=None), *measured_positions(known), 0.0)
    off = [
        np.linalg.norm(each - nearest_points(of.surface, each)[0], axis=1).max()
        for each in (shifted, believed_from_measured(plan, *measured_positions(known), 0.0))
    ]
    assert off[0] > 0.0005
    assert off[1] < 1e-9


def test_targets_lie_all_over_the_cells_of_the_taxels():
    of = sheet()
    half = TARGET_MAX_CELL_SHARE * of.scene.skin.layout.spacing
    off = []
    for guidance, *_ in guided(of, 30):
        if guidance.target is not None:
            row = guidance.channels.tolist().index(guidance.target.channel)
            off.append(guidance.target.place - guidance.places[row])
    away = np.linalg.norm(off, axis=1)
    assert away.max() <= np.sqrt(2.0) * half
    assert np.linalg.norm(np.mean(off, axis=0)) < 0.25 * half, "evenly to all sides"
    assert np.sqrt(np.mean(away**2)) == pytest.approx(half * np.sqrt(2.0 / 3.0), rel=0.15)


def test_pokes_left_fall_with_the_error_and_end_at_zero():
    every, errors = np.ones(48, dtype=bool), np.full(48, 0.002)
    assert count_sheet_pokes_left(40, 0, every, np.full(48, np.inf), SETTINGS, 9) == 40
    assert count_sheet_pokes_left(40, 30, every, errors, SETTINGS, 9) == 42
    assert count_sheet_pokes_left(40, 60, every, np.full(48, 0.0015), SETTINGS, 3) == 3
    assert count_sheet_pokes_left(40, 60, ~every, errors, SETTINGS, 9) == 0


def test_held_out_pokes_agree_with_the_errors_of_a_sheet():
    of = sheet()
    *_, (_, _, session) = guided(of, 60)
    channels = of.channels.tolist()
    model = ModuleModel(of.scene.skin.layout, of.scene.skin.anchor, of.surface)
    tried = check(session.snapshot(), channels, Method.MODULES, of.scene.noise, of.surface, model)
    assert tried.has_enough
    assert tried.agrees
    assert tried.off_plan is None, "a sheet may be off its plan"


def test_a_sheet_without_a_mesh_has_no_modules_method():
    scene, surface = sheet().scene, sheet().surface
    assert Method.MODULES in methods_of(scene, surface)
    assert methods_of(scene, None) == (Method.FREE,)
    layout = scene.skin.layout
    board = replace(
        scene, skin=replace(scene.skin, layout=type(layout)(layout.modules, layout.width, given_kind=SkinKind.BOARD))
    )
    assert Method.MODULES in methods_of(board, None)


def test_the_rig_s_correction_moves_the_taxels_of_a_sheet_one_by_one():
    of = sheet()
    *_, (_, _, session) = guided(of, 30)
    groups = _rigid_groups(RigRequest(of.scene, of.surface, session.contacts, NO_LANDMARK_POKES))
    assert isinstance(groups, TaxelGroups)
