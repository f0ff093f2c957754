"""Pokes on a module that are hard to fit a board to: stiff, nearly parallel, few, far away, in the wrong unit, badly begun.

Made like those of `cases.py`, in general directions: of a board's pose, pads that answer, directions of push, forces and arm
poses. What the solvers get are the rounded numbers, the inputs of the study.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from skincal.geometry.arrays import FloatArray, IntArray
from skincal.mesh.surface import make_surface
from skincal.model.scene import NoiseSettings
from skincal.model.skin import KINDS
from skincal.modules.pose import ModuleGround, ModulePoses, ModulesInSpace, ModulesOnSurface, rotations
from skincal.studies.cases import TAXEL, Mesh, Sizes, arm_poses, cone, moved, sheet, unit

KIND = KINDS["triangle_12"]
PADS = len(KIND.pads)
_SEED = 20261122


@dataclass(frozen=True, slots=True, eq=False)
class BoardReadings:
    """The numbers that n pokes on a module come with: every one of them is an input."""

    forces: FloatArray
    """(n, 3) float, N, sensor frame."""
    moments: FloatArray
    """(n, 3) float, N m, about the sensor's origin."""
    responses: FloatArray
    """(n, k) float: t_j of each pad, nought where it did not answer."""
    beside: FloatArray
    """(n,) float: of a taxel of another module; nought where none answered."""
    poses: FloatArray
    """(g, 4, 4) float: link_from_sensor of each arm pose."""
    pose_of: IntArray
    """(n,) int: which of `poses` a poke has."""

    def moved(self, rng: np.random.Generator) -> BoardReadings:
        """Return the readings with every number moved by one unit in its last place, up or down."""
        poses = self.poses.copy()
        poses[:, :3] = moved(poses[:, :3], rng)
        forces, moments, responses, beside = (
            moved(one, rng) for one in (self.forces, self.moments, self.responses, self.beside)
        )
        return BoardReadings(forces, moments, responses, beside, poses, self.pose_of)

    def ordered(self, order: IntArray) -> BoardReadings:
        """Return the pokes in another order; one named twice is there twice."""
        return replace(
            self, forces=self.forces[order], moments=self.moments[order], responses=self.responses[order],
            beside=self.beside[order], pose_of=self.pose_of[order],
        )  # fmt: skip


@dataclass(frozen=True, slots=True, eq=False)
class Board:
    """Where a board lies, and what its maker says of its pads."""

    at: ModulePoses
    """One pose; a triangle of the mesh, or -1."""
    mesh: Mesh | None = None
    mirror: bool = False

    @property
    def flat(self) -> FloatArray:
        """(k, 2) float, metres: the pads in the board's plane."""
        return KIND.pads * np.array([-1.0 if self.mirror else 1.0, 1.0])

    @property
    def ground(self) -> ModuleGround:
        """What it lies on."""
        return (
            ModulesInSpace() if self.mesh is None else ModulesOnSurface(make_surface(self.mesh.vertices, self.mesh.triangles))
        )


@dataclass(frozen=True, slots=True, eq=False)
class BoardCase:
    """One module, to be placed."""

    name: str
    readings: BoardReadings
    board: Board
    start: ModulePoses
    """Where the search begins, one pose."""
    noise: NoiseSettings = field(default_factory=NoiseSettings)
    copies: int = 1
    """How many times each poke is there, to the last digit, in the draws too."""
    lost: bool = False
    """The answer is farther off than a search goes: what is said of the pads is compared, and not their places."""


Touched = Sequence[Sequence[int]]
ALL_OVER: Touched = ((0, 1), (4,), (8, 9, 10), (6,), (3, 11), (1,), (5, 6), (9,), (2, 3), (7, 8, 11))
"""Pads that answer in turn, neighbours."""


def press_board(
    rng: np.random.Generator,
    board: Board,
    count: int,
    *,
    tilt: float = 0.5,
    lean: FloatArray | None = None,
    touched: Touched = ALL_OVER,
    answers: FloatArray | None = None,
    forces: FloatArray | float = 8.0,
    scatter: float = 0.0005,
    poses: FloatArray | None = None,
) -> BoardReadings:
    """Press a board's pads in turn; what sensor and skin read, arm poses in turn.

    Parameters
    ----------
    tilt : rad, within which pushes lie about one direction
    lean : (3,) unit, that direction; None against the board's normal
    answers : (n, k) float, what the pads answer; None for what is usual of `touched`
    scatter : m, how far off the middle the contacts are
    """
    flat = board.flat
    pads = board.ground.laid(board.at.take(np.zeros(len(flat), dtype=np.int64)), flat)
    directions = cone(rng, count, tilt, -board.at.normals[0] if lean is None else lean)
    if answers is None:
        answers = np.zeros((count, len(flat)))
        for poke, row in enumerate(answers):
            own = list(touched[poke % len(touched)])
            row[own] = rng.uniform(50.0, 200.0, len(own))
    middles = answers @ pads.points / answers.sum(axis=1, keepdims=True)
    places = middles + scatter * unit(np.cross(directions, rng.normal(size=(count, 3))))
    poses = np.eye(4)[None] if poses is None else poses
    pose_of = np.arange(count) % len(poses)
    turns, shifts = poses[pose_of, :3, :3], poses[pose_of, :3, 3]
    force = directions * np.broadcast_to(forces, count)[:, None] * rng.uniform(0.8, 1.2, (count, 1))
    felt = np.einsum("ni,nij->nj", force, turns)
    lever = np.einsum("ni,nij->nj", places - shifts, turns)
    return BoardReadings(felt, np.asarray(np.cross(lever, felt), dtype=float), answers, np.zeros(count), poses, pose_of)


def in_space(rng: np.random.Generator, mirror: bool = False, at: FloatArray = TAXEL) -> Board:
    """Return a board without a surface, in a general direction."""
    turn = arm_poses(rng, 1, 1.0)[0, :3, :3]
    return Board(ModulePoses(at[None].copy(), turn[None, :, 0], turn[None, :, 2], np.full(1, -1)), mirror=mirror)


def on_sheet(
    rng: np.random.Generator, sizes: Sizes, bend: float = 0.0, aside: float = 0.0, away: float = 0.0, mirror: bool = False
) -> Board:
    """Return a board on a sheet, near its middle and turned.

    Parameters
    ----------
    bend : 1/m, the sheet's curvature
    aside : m, from the middle towards the rim
    away : m, of the sheet from the origin
    """
    mesh = sheet(rng, sizes.grid, bend)
    mesh = replace(mesh, vertices=mesh.vertices + away * unit(rng.normal(size=3)))
    surface = make_surface(mesh.vertices, mesh.triangles)
    middle = len(mesh.triangles) // 4 + sizes.grid // 4
    corners = mesh.corners[middle]
    x = unit(corners[1] - corners[0])
    begin = ModulePoses(np.array([[0.2, 0.5, 0.3]]) @ corners, x[None], surface.normals[middle][None], np.array([middle]))
    way = np.array([[0.0013 + aside, 0.0021, 0.01 * rng.uniform(-1.0, 1.0)]])
    return Board(ModulesOnSurface(surface).moved(begin, way), mesh, mirror)


def beside(rng: np.random.Generator, board: Board, shift: float = 0.002, turn: float = 0.1) -> ModulePoses:
    """Return a pose so far, metres and radians, from where the board lies."""
    ground = board.ground
    if ground.unknowns == 3:
        way = shift * unit(np.append(rng.normal(size=2), 0.0))
        return ground.moved(board.at, np.array([[*way[:2], 0.010 * turn]]))
    # Tilted by a third of what it is turned in its plane.
    axis = board.at.normals[0] + 0.33 * unit(rng.normal(size=3))
    turned = rotations(turn * unit(axis)[None])[0]
    at = board.at
    return ModulePoses(at.points + shift * unit(rng.normal(size=3)), at.x @ turned.T, at.normals @ turned.T, at.triangles)


def _case(
    rng: np.random.Generator, name: str, board: Board, readings: BoardReadings, noise: NoiseSettings | None = None
) -> BoardCase:
    return BoardCase(name, readings, board, beside(rng, board), NoiseSettings() if noise is None else noise)


def _parallel(rng: np.random.Generator, sizes: Sizes) -> Iterator[BoardCase]:
    n, board = sizes.contacts, in_space(rng)
    lean = unit(-board.at.normals[0] + 0.4 * rng.normal(size=3))
    for digits in (1, 2, 4, 6):
        close = press_board(rng, board, n, tilt=10.0**-digits, lean=lean, scatter=0.0)
        yield _case(rng, f"module, axes within 1e-{digits} rad", board, close)
    flat = on_sheet(rng, sizes)
    readings = press_board(rng, flat, n, tilt=1e-6, lean=unit(-flat.at.normals[0] + 0.4 * rng.normal(size=3)))
    yield _case(rng, "module on a sheet, axes within 1e-6 rad", flat, readings)
    grazing = unit(np.cross(flat.at.normals[0], rng.normal(size=3)) - 0.02 * flat.at.normals[0])
    yield _case(
        rng,
        "module on a sheet, axes graze it by 0.02 rad",
        flat,
        press_board(rng, flat, n, tilt=0.01, lean=grazing, scatter=1e-5),
    )


def _few(rng: np.random.Generator, sizes: Sizes) -> Iterator[BoardCase]:
    board, flat, n = in_space(rng), on_sheet(rng, sizes), sizes.contacts
    for name, one in (("module", board), ("module on a sheet", flat)):
        yield _case(rng, f"{name}, one poke", one, press_board(rng, one, 1, touched=((4,),)))
        yield _case(rng, f"{name}, two pokes", one, press_board(rng, one, 2, touched=((4,), (8, 9)), scatter=0.0001))
        yield _case(rng, f"{name}, three pokes", one, press_board(rng, one, 3, touched=((0,), (5,), (9,)), scatter=0.0001))
        # Without noise of the skin: its direction is that of a board whose tilt the pokes do not tell.
        single = press_board(rng, one, n, touched=((4,),))
        yield _case(rng, f"{name}, one pad poked", one, single, NoiseSettings(contact=0.0))
        answers = np.zeros((n, PADS))
        answers[:, 4] = 120.0
        answers[np.arange(n), np.array([3, 5, 6])[np.arange(n) % 3]] = 0.012
        near = press_board(rng, one, n, answers=answers, scatter=0.0)
        yield _case(rng, f"{name}, one pad poked, neighbours answer by 1e-4", one, near, NoiseSettings(contact=1e-7))


def _stiff(rng: np.random.Generator, sizes: Sizes) -> Iterator[BoardCase]:
    n, poses = sizes.contacts, arm_poses(rng, 3, 0.3)
    for name, board in (("module", in_space(rng)), ("module on a sheet", on_sheet(rng, sizes))):
        # With fewer the light ones leave the module to three.
        count = max(n, 10)
        mixed = press_board(rng, board, count, forces=rng.permutation(np.geomspace(1e-6, 1e4, count)), poses=poses)
        yield _case(rng, f"{name}, forces 1e-6 to 1e4 N", board, mixed)
        usual = press_board(rng, board, n, poses=poses)
        yield _case(rng, f"{name}, force noise of 1e-6 N, moment 1 N m", board, usual, NoiseSettings(force=1e-6, moment=1.0))
        yield _case(rng, f"{name}, force noise of 1 N, moment 1e-6 N m", board, usual, NoiseSettings(force=1.0, moment=1e-6))
        sharp = NoiseSettings(contact=1e-6, force=1e-4, moment=1e-6)
        yield _case(rng, f"{name}, contacts told to 1e-6 m", board, usual, sharp)
        heavy = np.arange(n) < n // 3
        some: Touched = [(4,)] * (n // 3) + [(0,), (9,), (7, 8)] * n
        parted = press_board(rng, board, n, touched=some, forces=np.where(heavy, 1e4, 1e-4), scatter=0.0)
        fine = NoiseSettings(contact=1e-7, force=1e-6)
        yield _case(rng, f"{name}, pokes of 1e4 N on one pad, of 1e-4 N elsewhere", board, parted, fine)
        answers = np.array([np.roll(np.r_[np.geomspace(1.0, 1e-12, 4), np.zeros(PADS - 4)], 3 * i) for i in range(n)])
        light = press_board(rng, board, n, answers=100.0 * answers)
        yield _case(rng, f"{name}, answers 1 to 1e-12", board, light)


def _scales(rng: np.random.Generator, sizes: Sizes) -> Iterator[BoardCase]:
    n, board, flat = sizes.contacts, in_space(rng), on_sheet(rng, sizes)
    for lever in (1e-3, 1e4):
        poses = arm_poses(rng, 3, lever)
        yield _case(rng, f"module, levers of {lever:g} m", board, press_board(rng, board, n, poses=poses))
        if lever > 1:
            yield _case(rng, f"module on a sheet, levers of {lever:g} m", flat, press_board(rng, flat, n, poses=poses))
    across = arm_poses(rng, 1, 1e2)
    normal = flat.at.normals[0]
    across[0, :3, 3] -= (across[0, :3, 3] @ normal) * normal
    yield _case(
        rng, "module on a sheet, levers of 100 m across the push", flat, press_board(rng, flat, n, tilt=1e-4, poses=across)
    )
    good = press_board(rng, board, n, poses=arm_poses(rng, 3, 0.3))
    yield replace(
        _case(rng, "module, newton millimetres by mistake", board, replace(good, moments=good.moments * 1e3)), lost=True
    )
    away = 1000.0 * unit(rng.normal(size=3))
    far, beside_it = in_space(rng, at=TAXEL + away), arm_poses(rng, 3, 0.3)
    beside_it[:, :3, 3] += away
    yield _case(rng, "module 1 km from the origin, sensor beside it", far, press_board(rng, far, n, poses=beside_it))
    distant = on_sheet(rng, sizes, away=1000.0)
    yield _case(rng, "module on a sheet 1 km from the origin", distant, press_board(rng, distant, n))


def _lying(rng: np.random.Generator, sizes: Sizes) -> Iterator[BoardCase]:
    n, poses = sizes.contacts, arm_poses(rng, 7, 0.3)
    boards = {
        "module": in_space(rng), "module, mirrored": in_space(rng, mirror=True), "module on a sheet": on_sheet(rng, sizes),
        "module on a sheet, mirrored": on_sheet(rng, sizes, mirror=True), "module on a bent sheet": on_sheet(rng, sizes, 8.0),
        "module over the rim of a sheet": on_sheet(rng, sizes, aside=0.025),
    }  # fmt: skip
    for name, board in boards.items():
        yield _case(rng, f"{name}, 7 arm poses", board, press_board(rng, board, n, poses=poses))
    for name in ("module", "module on a sheet"):
        board, usual = boards[name], press_board(rng, boards[name], n, poses=poses)
        yield replace(_case(rng, f"{name}, every poke there 10 times", board, usual), copies=10)
        yield _case(
            rng,
            f"{name}, another one answers too",
            board,
            replace(usual, beside=0.6 * usual.responses.max(axis=1) * (np.arange(n) % 2)),
        )
        begun = beside(rng, board, 0.0075, np.radians(50.0))
        yield BoardCase(f"{name}, begun 50 degrees and 7.5 mm off", usual, board, begun)


FAMILIES: tuple[Callable[[np.random.Generator, Sizes], Iterator[BoardCase]], ...] = (_parallel, _few, _stiff, _scales, _lying)


def all_board_cases(sizes: Sizes) -> Iterator[BoardCase]:
    """Yield every case; the numbers of one family do not depend on the others."""
    for number, family in enumerate(FAMILIES):
        yield from family(np.random.default_rng([_SEED, number]), sizes)
