"""A soft sheet that is not laid as planned, from the independent simulator: the case "sheet" of the study `unmodelled`.

A grid is stretched by 3 % along one direction, sheared by 2 degrees along another, and folded along a line, where 2 mm of it
are lost. Directions, sign and line are drawn. The grid is glued to the forearm, and poked as the guide asks, on a rig that is
only noisy. The same pokes are solved as a sheet, as one rigid board, and taxel by taxel.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any, TypeAlias

import numpy as np

from skincal.contacts.outcome import Contact
from skincal.files.layout_sources import Grid, parse_layout
from skincal.geometry import FloatArray
from skincal.guide.believed_positions import plan_from_layout, planned_sheet_pokes
from skincal.guide.guidance import GuidePhase, Target
from skincal.guide.guide import Guide
from skincal.guide.progress import GuideSettings
from skincal.guide.surroundings import Surroundings
from skincal.mesh.lay import place_layout
from skincal.methods import estimate_taxels
from skincal.model.scene import Scene
from skincal.model.skin import Layout, SkinKind
from skincal.modules.pose import ModuleModel
from skincal.session.session import Session
from skincal.simulation.example_parts import forearm
from skincal.studies.independent_simulator import (
    MAX_ATTEMPTS_PER_TARGET,
    NOISY_RIG,
    POKE_CYCLE_S,
    Operator,
    Presses,
    RigModel,
    Sensor,
    Skin,
    SmoothSurface,
    dot,
    forward_kinematics,
    sensor_wrenches,
    unit,
)
from skincal.taxels.result import Estimate, Method

SHEET_CASE = "sheet"
SHEET_GRID = Grid(6, 8, 9.0)
SHEET_STRETCH, SHEAR_RAD, FOLD_M = 0.03, float(np.radians(2.0)), 0.002
FOLD_MAX_OFFSET = 0.3
"""Largest distance of the fold from the middle, over the size of the sheet across it."""
ARM_POSE = "2"
SHEET_COUNTS = (24, 48, 96)
"""Pokes after which a session is evaluated: one for two taxels, one and two a taxel."""
AS_BOARD = "board"
"""The modules method on the same pokes, with the sheet taken for one rigid board."""
AT_END = "finished"
"""Row of the numbers when the guide asks for no more pokes."""
MAX_POKES = 300
Numbers: TypeAlias = dict[str, dict[str, Any]]
"""By method, with `AS_BOARD`: the result of `Compare`."""
Compare: TypeAlias = Callable[[Sequence[Estimate], FloatArray], dict[str, Any]]
"""Compares estimates with the true positions (n, 3), metres."""


def deformed(flat: FloatArray, rng: np.random.Generator) -> FloatArray:
    """Stretch, shear and fold positions (n, 2), metres, of a sheet."""
    middle = flat.mean(axis=0)
    off = flat - middle
    along, sheared, across = (np.array([np.cos(angle), np.sin(angle)]) for angle in rng.uniform(0.0, 2.0 * np.pi, 3))
    stretched = rng.choice([-1.0, 1.0]) * SHEET_STRETCH * (off @ along)[:, None] * along
    shift = np.tan(SHEAR_RAD) * (off @ np.array([-sheared[1], sheared[0]]))[:, None] * sheared
    far = off @ across
    beyond = far > FOLD_MAX_OFFSET * rng.uniform(-1.0, 1.0) * np.ptp(far)
    return flat + stretched + shift - FOLD_M * beyond[:, None] * across


class SimulatedSheet:
    """A sheet on the forearm, and a hand that pokes it.

    Parameters
    ----------
    world : errors of the rig
    grid : of the sheet
    """

    def __init__(self, seed: int, world: RigModel = NOISY_RIG, grid: Grid = SHEET_GRID) -> None:
        mount, shape, skin, sensor, self._hand, self._noise = np.random.default_rng([seed, 31]).spawn(6)
        example = forearm()
        layout = parse_layout(grid.layout_text(), Path("sheet"))
        self.scene = _with_layout(example.scene, layout)
        self.surface, self.world, self.channels = example.surface, world, layout.channels
        self._part = SmoothSurface(self.surface.vertices, self.surface.triangles)
        anchor = self.scene.skin.anchor
        assert anchor is not None
        turn, shift = world.mount_turn * mount.standard_normal(), world.mount_shift * mount.standard_normal(2)
        c, s = np.cos(turn), np.sin(turn)
        # A way of no length has no direction: the little that is added gives it one.
        flat = deformed(layout.places[self.channels], shape) @ np.array([[c, s], [-s, c]]) + shift + 1e-9
        feet, up = self._part.nearest(anchor.point[None])
        x = unit(anchor.x[None] - dot(anchor.x[None], up) * up)
        start = np.repeat(feet, len(flat), axis=0)
        self.places = self._part.march(start, flat[:, :1] * x + flat[:, 1:] * np.cross(up, x))[0]
        self._skin = Skin(world, self.places, np.exp(world.gains * skin.standard_normal(len(flat))))
        self._operator, self._sensor = Operator(world, up[0], self._hand), Sensor(world, sensor)
        self._pose = forward_kinematics(self.scene)[ARM_POSE]

    def poke(self, number: int, place: FloatArray) -> Contact | None:
        """Poke at a place (3,), again if no taxel answers; `None` if none does."""
        for _ in range(MAX_ATTEMPTS_PER_TARGET):
            presses: Presses = self._operator.press(self._part, place[None], self._hand)
            responses = self._skin.responses(presses, self._hand)[0]
            own = np.flatnonzero(responses > self.scene.contacts.response_min)
            if not 0 < len(own) <= self.scene.contacts.taxels_max:
                continue
            read = self._sensor.read(sensor_wrenches(self._pose[None], presses.points, presses.forces, 0.0), self._noise)[0]
            begin = POKE_CYCLE_S * number
            return Contact(
                poke=number, start_s=begin, end_s=begin + self.scene.contacts.still_s, force=read[:3], moment=read[3:],
                channels=self.channels[own], responses=responses[own], link_from_sensor=self._pose, pose=ARM_POSE,
                tare_change=0.0, final=True,
            )  # fmt: skip
        return None


def _with_layout(scene: Scene, layout: Layout) -> Scene:
    """Put another layout on a scene, its middle where the scene's own layout has its anchor."""
    anchor = scene.skin.anchor
    assert anchor is not None
    centred = replace(anchor, at=layout.places[layout.channels].mean(axis=0))
    return replace(scene, skin=replace(scene.skin, layout=layout, channels=layout.width, anchor=centred))


def run_sheet(seed: int, compare: Compare) -> dict[str, Any]:
    """Poke a sheet as the guide asks, until it asks no more and for the last of `SHEET_COUNTS`.

    Returns
    -------
    JSON: `pokes` until the guide asks no more, `planned` pokes by the layout alone, and `Numbers` by `compare` for each of
    `SHEET_COUNTS` and `AT_END`
    """
    sheet = SimulatedSheet(seed)
    scene, layout = sheet.scene, sheet.scene.skin.layout
    assert layout is not None
    laid = place_layout(layout, scene.skin.anchor, sheet.surface)
    plan = None if laid is None else plan_from_layout(layout, laid, sheet.surface)
    assert plan is not None
    session = Session(scene, sheet.surface, {Method.FREE, Method.SURFACE, Method.MODULES})
    around, settings = Surroundings(layout, plan.channels), GuideSettings()
    guide = Guide(plan, scene.noise, Method.MODULES, surroundings=around)
    contacts: dict[int, Contact] = {}
    targets: dict[int, Target | None] = {}
    guidance = guide.update(session.snapshot(), targets.get)
    found: dict[str, Any] = {"planned": planned_sheet_pokes(plan, scene.noise, settings), "pokes": None}
    for number in range(1, MAX_POKES + 1):
        # After the end each taxel in turn, as an operator goes on who wants more.
        least = int(guidance.own.argmin())
        place = guidance.places[least] if guidance.target is None else guidance.target.place
        targets[number] = guidance.target
        contact = sheet.poke(number, place)
        if contact is not None:
            session.add(contact)
            contacts[number] = contact
        elif guidance.target is not None:
            guide.skip(guidance.target)
        guidance = guide.update(session.snapshot(), targets.get)
        is_end = found["pokes"] is None and guidance.phase is GuidePhase.ENOUGH
        if is_end:
            found |= {"pokes": number, "given_up": len(guidance.given_up)}
        if is_end or number in SHEET_COUNTS:
            found[AT_END if is_end else str(number)] = _numbers(sheet, session, list(contacts.values()), compare)
        if is_end and number in SHEET_COUNTS:
            found[str(number)] = found[AT_END]
        if found["pokes"] is not None and number >= SHEET_COUNTS[-1]:
            break
    return found


def _numbers(sheet: SimulatedSheet, session: Session, contacts: Sequence[Contact], compare: Compare) -> Numbers:
    """Compare the estimates of all methods with the truth."""
    layout, channels = sheet.scene.skin.layout, sheet.channels.tolist()
    assert layout is not None
    board = ModuleModel(Layout(layout.modules, layout.width, given_kind=SkinKind.BOARD), sheet.scene.skin.anchor, sheet.surface)
    as_board = estimate_taxels(contacts, channels, [Method.MODULES], sheet.scene.noise, sheet.surface, model=board)
    every: dict[str, Iterable[Estimate]] = {AS_BOARD: as_board[Method.MODULES].values()}
    every |= {
        SHEET_CASE if method is Method.MODULES else method.value: of for method, of in session.snapshot().estimates.items()
    }
    return {name: compare(list(of), sheet.places) for name, of in every.items()}
