"""Readings, meshes and modules that are hard to solve: stiff, nearly parallel, few, far away, in the wrong unit, degenerate.

All are made of a taxel's place or a module's pose, directions of push, forces and arm poses by the paper's (1), (2) and (6), in
general directions so that no zero or one hides an error. What the solvers get are the rounded numbers, the inputs of the study.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field, fields, replace
from typing import Any, TypeAlias

import numpy as np

from skincal.contacts.outcome import Contact
from skincal.geometry import FloatArray, IntArray
from skincal.mesh.surface import Surface, make_surface
from skincal.model.scene import KnownDistance, NoiseSettings
from skincal.model.skin import KINDS, Anchor, Layout, Module
from skincal.modules.pose import ModuleGround, ModuleModel, ModulePoses, ModulesInSpace, ModulesOnSurface, rotations

TAXEL = np.array([0.031, -0.047, 0.083])
"""m, link frame: where a forearm's taxel may be."""
DOWN = np.array([0.0, 0.0, -1.0])
KIND = KINDS["triangle_12"]
PADS = len(KIND.pads)
_TAXEL_SEED, _MODULE_SEED = 20260721, 20261122


@dataclass(frozen=True, slots=True, eq=False)
class Readings:
    """The numbers that n contacts come with: every one of them is an input."""

    forces: FloatArray
    """(n, 3) float, N, sensor frame."""
    moments: FloatArray
    """(n, 3) float, N m, about the sensor's origin."""
    responses: FloatArray
    """(n,) float > 0: t_j of a taxel; (n, k) of each pad of a module, zero where it did not answer."""
    poses: FloatArray
    """(g, 4, 4) float: link_from_sensor of each arm pose."""
    pose_of: IntArray
    """(n,) int: which of `poses` a contact has."""
    beside: FloatArray
    """(n,) float: of another taxel, stronger than the one, or of another module; zero where none answered."""

    @property
    def strongest(self) -> FloatArray:
        """(n,) float: max_y t_y of a taxel's contacts."""
        return np.maximum(self.responses, self.beside)

    def ordered(self, order: IntArray) -> Readings:
        """Return the contacts in another order; one named twice is there twice."""
        return replace(self, **{own.name: getattr(self, own.name)[order] for own in fields(self) if own.name != "poses"})

    def moved(self, rng: np.random.Generator) -> Readings:
        """Return the readings with every number moved by one unit in its last place, up or down."""
        answers = None
        if self.responses.ndim == 1:
            # The strongest first: it may be the taxel itself, which then has that one number.
            own, top = self.beside == 0, moved(self.strongest, rng)
            answers = np.where(own, top, moved(self.responses, rng)), np.where(own, 0.0, top)
        poses = self.poses.copy()
        poses[:, :3] = moved(poses[:, :3], rng)
        forces, moments = moved(self.forces, rng), moved(self.moments, rng)
        responses, beside = answers or (moved(self.responses, rng), moved(self.beside, rng))
        return Readings(forces, moments, responses, poses, self.pose_of, beside)


def moved(values: FloatArray, rng: np.random.Generator) -> FloatArray:
    """Return each of `values` moved by one unit in its last place, up or down; zero has none and stays."""
    towards = np.where(rng.integers(0, 2, values.shape) == 0, -np.inf, np.inf)
    return np.where(values == 0, 0.0, np.nextafter(values, towards))


@dataclass(frozen=True, slots=True, eq=False)
class RawMesh:
    """A surface as it is given to `make_surface`."""

    vertices: FloatArray
    """(nv, 3) float, metres."""
    triangles: IntArray
    """(nt, 3) int."""

    @property
    def corners(self) -> FloatArray:
        """(nt, 3, 3) float: the vertices of each triangle."""
        return self.vertices[self.triangles]


@dataclass(frozen=True, slots=True, eq=False)
class Case:
    """One taxel, to be solved by the free method, or on a mesh by the surface method."""

    name: str
    readings: Readings
    mesh: RawMesh | None = None
    blind: bool = False
    """All axes are parallel to the last digit: rank 2 is right."""
    copies: int = 1
    """How many times each reading is there, to the last digit, in the draws too."""
    many: bool = False
    """Too many readings to solve them 200 times in 80 digits: the draws take the exact answer's derivative. The sensor is
    in the link frame, which stays, and the taxel is the strongest."""

    @property
    def solver(self) -> str:
        """The method that has to solve it."""
        return "free" if self.mesh is None else "surface"


@dataclass(frozen=True, slots=True, eq=False)
class PlacedModule:
    """Where a module lies, and what its maker says of its pads."""

    at: ModulePoses
    """One pose; a triangle of the mesh, or -1."""
    mesh: RawMesh | None = None
    mirror: bool = False

    @property
    def flat(self) -> FloatArray:
        """(k, 2) float, metres: the pads in the module's plane."""
        return KIND.pads * np.array([-1.0 if self.mirror else 1.0, 1.0])

    @property
    def ground(self) -> ModuleGround:
        """What it lies on."""
        return (
            ModulesInSpace() if self.mesh is None else ModulesOnSurface(make_surface(self.mesh.vertices, self.mesh.triangles))
        )


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class ModuleCase(Case):
    """One module, to be placed."""

    module: PlacedModule
    start: ModulePoses
    """Where the search begins, one pose."""
    noise: NoiseSettings = field(default_factory=NoiseSettings)
    lost: bool = False
    """The answer is farther off than a search goes: what is said of the pads is compared, and not their places."""

    @property
    def solver(self) -> str:
        """The method that has to solve it."""
        return "modules"


def contacts_of(case: Case, order: IntArray) -> list[Contact]:
    """Return the contacts; the channel behind those of the taxel, or of the module's pads, is the one beside them."""
    readings = case.readings.ordered(order)
    # The same array for all contacts of a pose: a million of them need no copies.
    poses, pose_of = list(readings.poses), readings.pose_of.tolist()
    answers = np.column_stack([readings.responses, readings.beside])
    # A taxel's contacts keep their numbers, a module's are numbered anew.
    numbers = np.arange(len(order)) if isinstance(case, ModuleCase) else order
    return [
        Contact(
            number + 1, 0.0, 1.0, readings.forces[at], readings.moments[at], np.flatnonzero(answers[at]),
            answers[at][answers[at] > 0], poses[pose], f"pose {pose}", 0.0, True,
        )
        for at, (number, pose) in enumerate(zip(numbers.tolist(), pose_of, strict=True))
    ]  # fmt: skip


def model_of(cases: Sequence[ModuleCase], surface: Surface | None, distances: Sequence[KnownDistance] = ()) -> ModuleModel:
    """Return one module for each case, its plan where the search begins; the channel behind all of them is another one's."""
    at = [case.start for case in cases]
    anchors = [Anchor(np.zeros(2), pose.points[0], pose.x[0], pose.normals[0]) for pose in at]
    modules = tuple(
        Module(number, KIND, number * PADS, np.zeros(2), 0.0, case.module.mirror, anchor)
        for number, (case, anchor) in enumerate(zip(cases, anchors, strict=True))
    )
    return ModuleModel(Layout(modules, len(modules) * PADS + 1), None, surface, distances)


@dataclass(frozen=True, slots=True)
class CaseSizes:
    """How large the cases are."""

    contacts: int
    grid: int
    """Squares along each side of a sheet."""
    many: int
    draws: int
    """Of a taxel; a quarter of them of a module, which has as many answers as pads."""


FULL = CaseSizes(contacts=24, grid=24, many=1_000_000, draws=200)
QUICK = CaseSizes(contacts=10, grid=8, many=20_000, draws=40)
Cases: TypeAlias = Iterator[Case]


def unit(v: FloatArray) -> FloatArray:
    """Return `v` (..., 3) at length 1."""
    return v / np.linalg.norm(v, axis=-1, keepdims=True)


def cone(rng: np.random.Generator, count: int, angle: float, axis: FloatArray | None = None) -> FloatArray:
    """Return (count, 3) unit directions within `angle`, rad, of `axis` (3,), a random one if None; most near the rim."""
    axis = unit(rng.normal(size=3)) if axis is None else axis
    aside = unit(np.cross(axis, rng.normal(size=(count, 3))))
    return unit(axis + np.tan(angle * rng.uniform(0.5, 1.0, (count, 1))) * aside)


def arm_poses(rng: np.random.Generator, count: int, reach: float) -> FloatArray:
    """Return (count, 4, 4) poses with a general rotation and the sensor `reach` metres away."""
    poses = np.tile(np.eye(4), (count, 1, 1))
    for pose in poses:
        rotation = np.asarray(np.linalg.qr(rng.normal(size=(3, 3)))[0])
        pose[:3, :3] = rotation * np.sign(np.linalg.det(rotation))
        pose[:3, 3] = reach * unit(rng.normal(size=3))
    return poses


def _sensed(
    rng: np.random.Generator, directions: FloatArray, places: FloatArray, forces: FloatArray | float, poses: FloatArray
) -> tuple[FloatArray, FloatArray, IntArray]:
    """Return what the sensor reads of forces about `forces`, N, at `places`: forces, moments, and which pose each poke has."""
    count = len(directions)
    pose_of = np.arange(count) % len(poses)
    rotations_, shifts = poses[pose_of, :3, :3], poses[pose_of, :3, 3]
    force = directions * np.broadcast_to(forces, count)[:, None] * rng.uniform(0.8, 1.2, (count, 1))
    # R' v as a row times R.
    felt = np.einsum("ni,nij->nj", force, rotations_)
    lever = np.einsum("ni,nij->nj", places - shifts, rotations_)
    return felt, np.asarray(np.cross(lever, felt), dtype=float), pose_of


def press(
    rng: np.random.Generator,
    directions: FloatArray,
    *,
    taxel: FloatArray = TAXEL,
    weights: FloatArray | float = 1.0,
    forces: FloatArray | float = 8.0,
    scatter: FloatArray | float = 0.001,
    poses: FloatArray | None = None,
    pitch: float = 0.0,
) -> Readings:
    """Press a taxel in `directions` (n, 3) unit, link frame; what the sensor reads, poses in turn.

    Parameters
    ----------
    scatter : m, how far off the taxel the contacts are
    pitch : m, the torque about the push over the force: a finger that twists, or two contacts
    """
    count = len(directions)
    poses = np.eye(4)[None] if poses is None else poses
    places = taxel + np.broadcast_to(scatter, count)[:, None] * unit(np.cross(directions, rng.normal(size=(count, 3))))
    felt, moments, pose_of = _sensed(rng, directions, places, forces, poses)
    strongest = rng.uniform(50.0, 200.0, count)
    weights = np.broadcast_to(weights, count)
    responses, beside = np.where(weights == 1.0, [strongest, 0.0 * strongest], [strongest * weights, strongest])
    return Readings(felt, moments + pitch * felt, responses, poses, pose_of, beside)


def pressed(name: str, rng: np.random.Generator, directions: FloatArray, mesh: RawMesh | None = None, **how: Any) -> Case:
    """Return the case of a taxel that is pressed so."""
    return Case(name, press(rng, directions, **how), mesh)


# ---- cases of the free method ----


def _parallel(rng: np.random.Generator, sizes: CaseSizes) -> Cases:
    n = sizes.contacts
    for digits in range(1, 10):
        yield pressed(f"axes within 1e-{digits} rad", rng, cone(rng, n, 10.0**-digits), scatter=0.0)
    for digits in (2, 4, 6, 8):
        yield pressed(f"axes within 1e-{digits} rad, contacts 1 mm off", rng, cone(rng, n, 10.0**-digits))
    for digits in (3, 7):
        yield pressed(f"axes within 1e-{digits} rad of z", rng, cone(rng, n, 10.0**-digits, DOWN), scatter=0.0)
    poses = arm_poses(rng, 4, 0.3)
    yield pressed("axes within 1e-5 rad, 4 arm poses", rng, cone(rng, n, 1e-5), scatter=0.0, poses=poses)


def _few_axes(rng: np.random.Generator, sizes: CaseSizes) -> Cases:
    n, axis = sizes.contacts, cone(rng, 1, 0.5)
    same, forces, weights = np.repeat(axis, n, axis=0), np.geomspace(0.01, 100.0, n), np.geomspace(1, 1e-12, n)
    yield replace(pressed("one axis", rng, axis), blind=True)
    yield replace(pressed("one axis, far sensor, general pose", rng, axis, poses=arm_poses(rng, 1, 30.0)), blind=True)
    yield replace(pressed("one axis, read many times", rng, axis), blind=True, copies=n)
    yield replace(pressed("one axis, many forces", rng, same, forces=forces, scatter=0.0), blind=True)
    yield replace(pressed("one axis, weights 1 to 1e-12", rng, same, weights=weights, scatter=0.0), blind=True)
    yield pressed("two axes that cross", rng, cone(rng, 2, 0.8), scatter=0.0)
    yield pressed("two axes 1 mm apart", rng, cone(rng, 2, 0.8))
    yield pressed("two axes within 1e-6 rad", rng, cone(rng, 2, 1e-6), scatter=0.0)
    yield pressed("two axes, one weighs 1e-12", rng, cone(rng, 2, 0.8), weights=np.array([1.0, 1e-12]))


def _stiff(rng: np.random.Generator, sizes: CaseSizes) -> Cases:
    n, at = sizes.contacts, np.arange(sizes.contacts)
    wide, falling = cone(rng, n, 0.8), np.geomspace(1, 1e-12, n)
    yield pressed("weights 1 to 1e-12", rng, wide, weights=falling)
    yield pressed("weights 1 or 1e-12", rng, wide, weights=np.where(at % 2, 1.0, 1e-12))
    for digits in (3, 6, 9, 12):
        yield pressed(f"one heavy axis, the rest weigh 1e-{digits}", rng, wide, weights=np.where(at == 0, 1.0, 10.0**-digits))
    for digits in (3, 6, 9):
        parts = np.concatenate([cone(rng, n // 2, 10.0**-digits, wide[0]), cone(rng, n - n // 2, 0.8, wide[0])])
        for light in (1e-6, 1e-12):
            name = f"heavy axes within 1e-{digits} rad, light ones of {light:.0e} fix the depth"
            yield pressed(name, rng, parts, weights=np.where(at < n // 2, 1.0, light), scatter=0.0)
    for digits in (2, 4):
        close, weights = cone(rng, n, 10.0**-digits), np.where(at == 0, 1.0, 1e-12)
        yield pressed(f"one heavy axis, 1e-12 within 1e-{digits} rad of it", rng, close, weights=weights, scatter=0.0)
    for light in (1e-3, 1e-6, 1e-9):
        name, weights = f"one heavy axis with a torque, the rest weigh {light:.0e}", np.where(at == 0, 1.0, light)
        yield pressed(name, rng, wide, weights=weights, pitch=0.02)
    parts, weights = np.concatenate([cone(rng, 3, 1e-9, DOWN), cone(rng, n - 3, 0.04, DOWN)]), np.where(at < 3, 1.0, 1e-4)
    name = "heavy axes within 1e-9 rad of z and 1 cm off, light ones of 1e-4"
    yield pressed(name, rng, parts, weights=weights, scatter=np.where(at < 3, 0.01, 0.0))
    yield pressed("weights 1 to 1e-12, 5 arm poses", rng, wide, poses=arm_poses(rng, 5, 0.4), weights=falling)


def _scales(rng: np.random.Generator, sizes: CaseSizes) -> Cases:
    n = sizes.contacts
    wide = cone(rng, n, 0.6)
    for lever in (1e-3, 1e-1, 1e1, 1e4):
        yield pressed(f"levers of {lever:g} m", rng, wide, poses=arm_poses(rng, 3, lever))
        yield pressed(f"taxel {lever:g} m from the link", rng, wide, taxel=TAXEL + lever * unit(rng.normal(size=3)))
    for force in (1e-6, 1e-3, 1e2, 1e4):
        yield pressed(f"forces of {force:g} N", rng, wide, forces=force, poses=arm_poses(rng, 2, 0.3))
    yield pressed("forces 1e-6 to 1e4 N", rng, wide, forces=np.geomspace(1e-6, 1e4, n), poses=arm_poses(rng, 2, 0.3))
    good = press(rng, wide, poses=arm_poses(rng, 3, 0.3))
    in_mm = good.poses * np.array([1.0, 1.0, 1.0, 1e3])
    in_mm[:, 3, 3] = 1.0
    yield Case("arm in millimetres by mistake", replace(good, poses=in_mm))
    yield Case("newton millimetres by mistake", replace(good, moments=good.moments * 1e3))
    close = cone(rng, n, 1e-4)
    yield pressed("axes within 1e-4 rad, levers of 1000 m", rng, close, poses=arm_poses(rng, 3, 1e3), scatter=0.0)


def _counts(rng: np.random.Generator, sizes: CaseSizes) -> Cases:
    poses = arm_poses(rng, 7, 0.3)
    yield pressed("7 arm poses", rng, cone(rng, sizes.contacts, 0.5), poses=poses)
    twice = press(rng, cone(rng, sizes.contacts, 0.5), poses=poses)
    yield Case("every reading there 10 times", twice.ordered(np.tile(np.arange(sizes.contacts), 10)))
    yield replace(pressed(f"{sizes.many} readings", rng, cone(rng, sizes.many, 0.5)), many=True)


# ---- cases of the surface method ----


def sheet(rng: np.random.Generator, squares: int, bend: float = 20.0, side: float = 0.06) -> RawMesh:
    """Return a bent square sheet of 2 squares^2 triangles in a general direction, its middle at `TAXEL`.

    Parameters
    ----------
    bend : 1/m, curvature; zero is flat, below zero is a hollow
    side : m
    """
    steps = np.linspace(-side / 2, side / 2, squares + 1)
    x, y = (grid.ravel() for grid in np.meshgrid(steps, steps, indexing="ij"))
    local = np.stack([x, y, -bend * (x * x + 0.5 * y * y)], axis=1)
    i = (np.arange(squares)[:, None] * (squares + 1) + np.arange(squares)).ravel()
    lower = np.stack([i, i + squares + 1, i + 1], axis=1)
    upper = np.stack([i + 1, i + squares + 1, i + squares + 2], axis=1)
    return RawMesh(local @ arm_poses(rng, 1, 1.0)[0, :3, :3].T + TAXEL, np.concatenate([lower, upper]))


def _near(mesh: RawMesh, point: FloatArray = TAXEL) -> int:
    """Return the triangle whose middle is nearest to `point`."""
    return int(np.linalg.norm(mesh.corners.mean(axis=1) - point, axis=1).argmin())


INSIDE, EDGE, VERTEX = (0.2, 0.5, 0.3), (0.4, 0.6, 0.0), (1.0, 0.0, 0.0)


def _at(
    mesh: RawMesh, shares: tuple[float, float, float] = INSIDE, triangle: int | None = None
) -> tuple[FloatArray, FloatArray]:
    """Return a point of a triangle, for None the middle one, and the direction straight into it."""
    corners = mesh.corners[_near(mesh) if triangle is None else triangle]
    normal = np.asarray(np.cross(corners[1] - corners[0], corners[2] - corners[0]), dtype=float)
    return np.array(shares) @ corners, -unit(normal)


def _on_sheet(rng: np.random.Generator, sizes: CaseSizes) -> Cases:
    n = sizes.contacts
    for name, bend in (("a bent sheet", 20.0), ("a hollow", -20.0), ("a flat sheet", 0.0)):
        mesh = sheet(rng, sizes.grid, bend)
        for place, shares in (("inside a triangle", INSIDE), ("on an edge", EDGE), ("on a vertex", VERTEX)):
            taxel, push = _at(mesh, shares)
            scatter = 0.0005 if place == "inside a triangle" else 0.0
            yield pressed(f"{name}, {place}", rng, cone(rng, n, 0.5, push), mesh, taxel=taxel, scatter=scatter)
        for place, shares in (("an edge", EDGE), ("a vertex", VERTEX)):
            taxel, push = _at(mesh, shares)
            yield pressed(f"{name}, 0.3 mm over {place}", rng, cone(rng, n, 0.5, push), mesh, taxel=taxel - 3e-4 * push)


def _stiff_on_sheet(rng: np.random.Generator, sizes: CaseSizes) -> Cases:
    n = sizes.contacts
    mesh = sheet(rng, sizes.grid)
    taxel, push = _at(mesh)
    wide = cone(rng, n, 0.6, push)
    for digits in (1, 3, 6, 9):
        yield pressed(f"surface, axes within 1e-{digits} rad", rng, cone(rng, n, 10.0**-digits, push), mesh, taxel=taxel)
    yield pressed("surface, one axis", rng, wide[:1], mesh, taxel=taxel)
    yield pressed("surface, two axes", rng, wide[:2], mesh, taxel=taxel)
    yield pressed("surface, weights 1 to 1e-12", rng, wide, mesh, taxel=taxel, weights=np.geomspace(1, 1e-12, n))
    weights = np.where(np.arange(n) == 0, 1.0, 1e-9)
    yield pressed("surface, one heavy axis, the rest weigh 1e-9", rng, wide, mesh, taxel=taxel, weights=weights)
    poses = arm_poses(rng, 5, 0.4)
    yield pressed("surface, 5 arm poses", rng, wide, mesh, taxel=taxel, poses=poses)
    yield pressed("surface, levers of 1e4 m", rng, wide, mesh, taxel=taxel, poses=arm_poses(rng, 3, 1e4))
    yield pressed("surface, forces 1e-6 to 1e4 N", rng, wide, mesh, taxel=taxel, forces=np.geomspace(1e-6, 1e4, n))
    good = press(rng, wide, taxel=taxel, poses=poses)
    yield Case("surface, newton millimetres by mistake", replace(good, moments=good.moments * 1e3), mesh)
    yield Case("surface, mesh in millimetres by mistake", good, replace(mesh, vertices=mesh.vertices * 1e3))
    yield Case("surface, every reading there 10 times", good.ordered(np.tile(np.arange(n), 10)), mesh)
    away = 1000.0 * unit(rng.normal(size=3))
    far = replace(mesh, vertices=mesh.vertices + away)
    yield pressed("mesh 1 km from the origin", rng, wide, far, taxel=taxel + away)
    poses = arm_poses(rng, 4, 0.4)
    poses[:, :3, 3] += away
    yield pressed("mesh 1 km from the origin, sensor beside it", rng, wide, far, taxel=taxel + away, poses=poses)


def _on_coarse_sheet(rng: np.random.Generator, sizes: CaseSizes) -> Cases:
    """Yield triangles half a metre wide: rounding of their size is far more than that of the readings."""
    n = sizes.contacts
    mesh = sheet(rng, 2, bend=1.0, side=1.0)
    weights, uneven, scatter = np.where(np.arange(n) < 3, 1.0, 1e-3), np.array([1.0, 1e-8]), np.array([0.0075, 0.0])
    near = (1 - 6e-4, 0.0, 6e-4)
    for place, shares in (("inside", INSIDE), ("at an edge", EDGE), ("at a vertex", VERTEX), ("near a vertex", near)):
        taxel, push = _at(mesh, shares)
        name = f"coarse sheet, {place}"
        close = cone(rng, n, 1e-6, unit(push + 0.6 * unit(np.cross(push, rng.normal(size=3)))))
        yield pressed(f"{name}, axes within 1e-6 rad", rng, close, mesh, taxel=taxel, weights=weights, scatter=0.0)
        two = cone(rng, 2, 1e-4, push)
        yield pressed(f"{name}, two axes, one weighs 1e-8", rng, two, mesh, taxel=taxel, weights=uneven, scatter=scatter)
        grazing = cone(rng, n, 1e-5, unit(np.cross(push, rng.normal(size=3)) + 1e-6 * push))
        yield pressed(f"{name}, axes within 1e-5 rad, tangent", rng, grazing, mesh, taxel=taxel, weights=1e-3, scatter=0.0)


def _tangent(rng: np.random.Generator, sizes: CaseSizes) -> Cases:
    n = sizes.contacts
    mesh = sheet(rng, sizes.grid, bend=0.0)
    taxel, push = _at(mesh)
    aside = unit(np.cross(push, rng.normal(size=3)))
    for digits in (2, 4, 6, 9):
        grazing = unit(aside + 10.0**-digits * push)
        yield pressed(f"one axis 1e-{digits} rad from the surface", rng, grazing[None], mesh, taxel=taxel, scatter=0.0)
        turned = unit(grazing + np.cross(grazing, push) * rng.uniform(-0.5, 0.5, (n, 1)))
        yield pressed(f"axes 1e-{digits} rad from the surface", rng, turned, mesh, taxel=taxel, scatter=1e-4)
    first = np.arange(n) == 0
    lights = {1e-6: (1e-3, 1e-6), 1e-9: (1e-3, 1e-6, 1e-9), 1e-10: (1e-9,), 1e-11: (1e-9, 1e-12)}
    for heavy, light in ((heavy, light) for heavy, some in lights.items() for light in some):
        directions = np.concatenate([unit(aside + heavy * push)[None], cone(rng, n - 1, 0.5, unit(push + 0.3 * aside))])
        weights, scatter = np.where(first, 1.0, light), np.where(first, 0.0, 1e-3)
        name = f"heavy axis {heavy:.0e} rad from the surface, the rest weigh {light:.0e}"
        yield pressed(name, rng, directions, mesh, taxel=taxel, weights=weights, scatter=scatter)


def _gaps(rng: np.random.Generator, sizes: CaseSizes) -> Cases:
    n = sizes.contacts
    mesh = sheet(rng, sizes.grid)
    taxel, push = _at(mesh)
    reach = 1.6 * 0.06 / sizes.grid
    around = np.linalg.norm(mesh.corners.mean(axis=1) - taxel, axis=1) > reach
    holed = replace(mesh, triangles=mesh.triangles[around])
    yield pressed("at a hole", rng, cone(rng, n, 0.5, push), holed, taxel=taxel)
    yield pressed("at a hole, one axis", rng, cone(rng, 1, 0.2, push), holed, taxel=taxel)
    for name, vertex in (("at the rim", sizes.grid // 2), ("at a corner of the rim", 0)):
        taxel, push = _at(mesh, triangle=_near(mesh, mesh.vertices[vertex]))
        outside = taxel + 1.5 * (taxel - TAXEL) * (reach / np.linalg.norm(taxel - TAXEL))
        yield pressed(name, rng, cone(rng, n, 0.5, push), mesh, taxel=outside)


def _degenerate(rng: np.random.Generator, sizes: CaseSizes) -> Cases:
    n = sizes.contacts
    for ratio in (1e2, 1e4, 1e6):
        squares = sheet(rng, sizes.grid, bend=0.0)
        # Squeezed along a direction of the plane: needles of that ratio.
        _, push = _at(squares, triangle=0)
        thin = unit(squares.vertices[1] - squares.vertices[0])
        offset = squares.vertices - TAXEL
        needles = replace(squares, vertices=squares.vertices - np.outer(offset @ thin, thin) * (1 - 1 / ratio))
        name, directions = f"needles {ratio:.0e} times as long as wide", cone(rng, n, 0.5, push)
        yield pressed(name, rng, directions, needles, taxel=_at(needles)[0], scatter=0.0)
    for height in (1e-9, 1e-12, 0.0):
        split, taxel, push = _with_sliver(sheet(rng, sizes.grid), height)
        name = "a triangle without area" if height == 0.0 else f"a triangle {height:.0e} m high"
        yield pressed(name, rng, cone(rng, n, 0.5, push), split, taxel=taxel, scatter=0.0)
    mesh = sheet(rng, sizes.grid)
    twice = replace(mesh, triangles=np.concatenate([mesh.triangles, mesh.triangles[:, [1, 2, 0]]]))
    taxel, push = _at(mesh)
    yield pressed("every triangle there twice", rng, cone(rng, n, 0.5, push), twice, taxel=taxel)


def _with_sliver(mesh: RawMesh, height: float) -> tuple[RawMesh, FloatArray, FloatArray]:
    """Return the mesh with a sliver along an edge of its middle triangle, a point of the sliver and the push into it."""
    middle = _near(mesh)
    a, b, c = mesh.triangles[middle]
    first, second, third = mesh.corners[middle]
    between, push = _at(mesh, (0.55, 0.45, 0.0))
    if height == 0.0:
        # A corner given twice: no rounding can give it an area.
        return replace(mesh, triangles=np.concatenate([mesh.triangles, [[a, b, a]]])), between, push
    across = np.asarray(np.cross(second - first, push), dtype=float)
    inward = unit(across) * np.sign(across @ (third - first))
    new = len(mesh.vertices)
    vertices = np.concatenate([mesh.vertices, [between + height * inward]])
    rest = np.delete(mesh.triangles, middle, axis=0)
    triangles = np.concatenate([rest, [[a, b, new], [b, c, new], [c, a, new]]])
    return RawMesh(vertices, triangles), between, push


def _two_sheets(rng: np.random.Generator, sizes: CaseSizes) -> Cases:
    """Yield sheets one behind the other, both met by a heavy axis; light axes say that it is the one behind."""
    n = sizes.contacts
    front = sheet(rng, sizes.grid)
    taxel, push = _at(front)
    behind, beyond = 0.01 * push, front.triangles + len(front.vertices)
    both = RawMesh(np.concatenate([front.vertices, front.vertices + behind]), np.concatenate([front.triangles, beyond]))
    for light in (1.0, 1e-6, 1e-9, 1e-12):
        weights = np.where(np.arange(n) == 0, 1.0, light)
        directions = np.concatenate([push[None], cone(rng, n - 1, 0.5, push)])
        name = f"two sheets, axes of weight {light:.0e} tell which"
        yield pressed(name, rng, directions, both, taxel=taxel + behind, weights=weights)


# ---- cases of the modules method ----

Touched = Sequence[Sequence[int]]
ALL_OVER: Touched = ((0, 1), (4,), (8, 9, 10), (6,), (3, 11), (1,), (5, 6), (9,), (2, 3), (7, 8, 11))
"""Pads that answer in turn, neighbours."""


def press_module(
    rng: np.random.Generator,
    module: PlacedModule,
    count: int,
    *,
    tilt: float = 0.5,
    lean: FloatArray | None = None,
    touched: Touched = ALL_OVER,
    answers: FloatArray | None = None,
    forces: FloatArray | float = 8.0,
    scatter: float = 0.0005,
    poses: FloatArray | None = None,
) -> Readings:
    """Press a module's pads in turn; what sensor and skin read, arm poses in turn.

    Parameters
    ----------
    tilt : rad, within which pushes lie about one direction
    lean : (3,) unit, that direction; None against the module's normal
    answers : (n, k) float, what the pads answer; None for what is usual of `touched`
    scatter : m, how far off the middle the contacts are
    """
    flat = module.flat
    pads = module.ground.place_pads(module.at.select(np.zeros(len(flat), dtype=np.int64)), flat)
    directions = cone(rng, count, tilt, -module.at.normals[0] if lean is None else lean)
    if answers is None:
        answers = np.zeros((count, len(flat)))
        for poke, row in enumerate(answers):
            own = list(touched[poke % len(touched)])
            row[own] = rng.uniform(50.0, 200.0, len(own))
    middles = answers @ pads.points / answers.sum(axis=1, keepdims=True)
    places = middles + scatter * unit(np.cross(directions, rng.normal(size=(count, 3))))
    poses = np.eye(4)[None] if poses is None else poses
    felt, moments, pose_of = _sensed(rng, directions, places, forces, poses)
    return Readings(felt, moments, answers, poses, pose_of, np.zeros(count))


def in_space(rng: np.random.Generator, mirror: bool = False, at: FloatArray = TAXEL) -> PlacedModule:
    """Return a module without a surface, in a general direction."""
    turn = arm_poses(rng, 1, 1.0)[0, :3, :3]
    return PlacedModule(ModulePoses(at[None].copy(), turn[None, :, 0], turn[None, :, 2], np.full(1, -1)), mirror=mirror)


def on_sheet(
    rng: np.random.Generator, sizes: CaseSizes, bend: float = 0.0, aside: float = 0.0, away: float = 0.0, mirror: bool = False
) -> PlacedModule:
    """Return a module on a sheet, near its middle and turned.

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
    return PlacedModule(ModulesOnSurface(surface).move(begin, way), mesh, mirror)


def beside(rng: np.random.Generator, module: PlacedModule, shift: float = 0.002, turn: float = 0.1) -> ModulePoses:
    """Return a pose so far, metres and radians, from where the module lies."""
    ground = module.ground
    if ground.unknowns == 3:
        way = shift * unit(np.append(rng.normal(size=2), 0.0))
        return ground.move(module.at, np.array([[*way[:2], 0.010 * turn]]))
    # Tilted by a third of what it is turned in its plane.
    axis = module.at.normals[0] + 0.33 * unit(rng.normal(size=3))
    turned = rotations(turn * unit(axis)[None])[0]
    at = module.at
    return ModulePoses(at.points + shift * unit(rng.normal(size=3)), at.x @ turned.T, at.normals @ turned.T, at.triangles)


def _case(
    name: str, rng: np.random.Generator, module: PlacedModule, readings: Readings, noise: NoiseSettings | None = None
) -> ModuleCase:
    start, noise = beside(rng, module), noise or NoiseSettings()
    return ModuleCase(name, readings, module.mesh, module=module, start=start, noise=noise)


def placed(
    name: str, rng: np.random.Generator, module: PlacedModule, count: int, noise: NoiseSettings | None = None, **how: Any
) -> ModuleCase:
    """Return the case of a module that is pressed so."""
    return _case(name, rng, module, press_module(rng, module, count, **how), noise)


ModuleCases: TypeAlias = Iterator[ModuleCase]


def _module_parallel(rng: np.random.Generator, sizes: CaseSizes) -> ModuleCases:
    n, module = sizes.contacts, in_space(rng)
    lean = unit(-module.at.normals[0] + 0.4 * rng.normal(size=3))
    for digits in (1, 2, 4, 6):
        yield placed(f"module, axes within 1e-{digits} rad", rng, module, n, tilt=10.0**-digits, lean=lean, scatter=0.0)
    flat = on_sheet(rng, sizes)
    lean = unit(-flat.at.normals[0] + 0.4 * rng.normal(size=3))
    yield placed("module on a sheet, axes within 1e-6 rad", rng, flat, n, tilt=1e-6, lean=lean)
    lean = unit(np.cross(flat.at.normals[0], rng.normal(size=3)) - 0.02 * flat.at.normals[0])
    yield placed("module on a sheet, axes graze it by 0.02 rad", rng, flat, n, tilt=0.01, lean=lean, scatter=1e-5)


def _module_few(rng: np.random.Generator, sizes: CaseSizes) -> ModuleCases:
    n, modules = sizes.contacts, {"module": in_space(rng), "module on a sheet": on_sheet(rng, sizes)}
    answers = np.zeros((n, PADS))
    answers[:, 4] = 120.0
    answers[np.arange(n), np.array([3, 5, 6])[np.arange(n) % 3]] = 0.012
    for name, module in modules.items():
        yield placed(f"{name}, one poke", rng, module, 1, touched=((4,),))
        yield placed(f"{name}, two pokes", rng, module, 2, touched=((4,), (8, 9)), scatter=0.0001)
        yield placed(f"{name}, three pokes", rng, module, 3, touched=((0,), (5,), (9,)), scatter=0.0001)
        # Without noise of the skin: its direction is that of a module whose tilt the pokes do not tell.
        yield placed(f"{name}, one pad poked", rng, module, n, NoiseSettings(contact=0.0), touched=((4,),))
        near, noise = f"{name}, one pad poked, neighbours answer by 1e-4", NoiseSettings(contact=1e-7)
        yield placed(near, rng, module, n, noise, answers=answers, scatter=0.0)


def _module_stiff(rng: np.random.Generator, sizes: CaseSizes) -> ModuleCases:
    n, poses = sizes.contacts, arm_poses(rng, 3, 0.3)
    noises = {
        "force noise of 1e-6 N, moment 1 N m": NoiseSettings(force=1e-6, moment=1.0),
        "force noise of 1 N, moment 1e-6 N m": NoiseSettings(force=1.0, moment=1e-6),
        "contacts told to 1e-6 m": NoiseSettings(contact=1e-6, force=1e-4, moment=1e-6),
    }
    fine, some = NoiseSettings(contact=1e-7, force=1e-6), [(4,)] * (n // 3) + [(0,), (9,), (7, 8)] * n
    parted = np.where(np.arange(n) < n // 3, 1e4, 1e-4)
    answers = np.array([np.roll(np.r_[np.geomspace(1.0, 1e-12, 4), np.zeros(PADS - 4)], 3 * i) for i in range(n)])
    for name, module in (("module", in_space(rng)), ("module on a sheet", on_sheet(rng, sizes))):
        # With fewer the light ones leave the module to three.
        mixed = rng.permutation(np.geomspace(1e-6, 1e4, max(n, 10)))
        yield placed(f"{name}, forces 1e-6 to 1e4 N", rng, module, len(mixed), forces=mixed, poses=poses)
        usual = press_module(rng, module, n, poses=poses)
        for words, noise in noises.items():
            yield _case(f"{name}, {words}", rng, module, usual, noise)
        uneven = f"{name}, pokes of 1e4 N on one pad, of 1e-4 N elsewhere"
        yield placed(uneven, rng, module, n, fine, touched=some, forces=parted, scatter=0.0)
        yield placed(f"{name}, answers 1 to 1e-12", rng, module, n, answers=100.0 * answers)


def _module_scales(rng: np.random.Generator, sizes: CaseSizes) -> ModuleCases:
    n, module, flat = sizes.contacts, in_space(rng), on_sheet(rng, sizes)
    yield placed("module, levers of 0.001 m", rng, module, n, poses=arm_poses(rng, 3, 1e-3))
    poses = arm_poses(rng, 3, 1e4)
    yield placed("module, levers of 10000 m", rng, module, n, poses=poses)
    yield placed("module on a sheet, levers of 10000 m", rng, flat, n, poses=poses)
    across, normal = arm_poses(rng, 1, 1e2), flat.at.normals[0]
    across[0, :3, 3] -= (across[0, :3, 3] @ normal) * normal
    yield placed("module on a sheet, levers of 100 m across the push", rng, flat, n, tilt=1e-4, poses=across)
    good = press_module(rng, module, n, poses=arm_poses(rng, 3, 0.3))
    wrong = _case("module, newton millimetres by mistake", rng, module, replace(good, moments=good.moments * 1e3))
    yield replace(wrong, lost=True)
    away = 1000.0 * unit(rng.normal(size=3))
    far, beside_it = in_space(rng, at=TAXEL + away), arm_poses(rng, 3, 0.3)
    beside_it[:, :3, 3] += away
    yield placed("module 1 km from the origin, sensor beside it", rng, far, n, poses=beside_it)
    yield placed("module on a sheet 1 km from the origin", rng, on_sheet(rng, sizes, away=1000.0), n)


def _lying(rng: np.random.Generator, sizes: CaseSizes) -> ModuleCases:
    n, poses = sizes.contacts, arm_poses(rng, 7, 0.3)
    modules = {
        "module": in_space(rng), "module, mirrored": in_space(rng, mirror=True), "module on a sheet": on_sheet(rng, sizes),
        "module on a sheet, mirrored": on_sheet(rng, sizes, mirror=True), "module on a bent sheet": on_sheet(rng, sizes, 8.0),
        "module over the rim of a sheet": on_sheet(rng, sizes, aside=0.025),
    }  # fmt: skip
    for name, module in modules.items():
        yield placed(f"{name}, 7 arm poses", rng, module, n, poses=poses)
    for name in ("module", "module on a sheet"):
        module, usual = modules[name], press_module(rng, modules[name], n, poses=poses)
        yield replace(_case(f"{name}, every poke there 10 times", rng, module, usual), copies=10)
        two = replace(usual, beside=0.6 * usual.responses.max(axis=1) * (np.arange(n) % 2))
        yield _case(f"{name}, another one answers too", rng, module, two)
        begun = beside(rng, module, 0.0075, np.radians(50.0))
        yield ModuleCase(f"{name}, begun 50 degrees and 7.5 mm off", usual, module.mesh, module=module, start=begun)


# ---- all of them; the numbers of one family do not depend on the others ----

TAXEL_FAMILIES: tuple[Callable[[np.random.Generator, CaseSizes], Cases], ...] = (
    _parallel, _few_axes, _stiff, _scales, _counts, _on_sheet, _stiff_on_sheet, _tangent, _gaps, _degenerate, _two_sheets,
    _on_coarse_sheet,
)  # fmt: skip
MODULE_FAMILIES: tuple[Callable[[np.random.Generator, CaseSizes], ModuleCases], ...] = (
    _module_parallel, _module_few, _module_stiff, _module_scales, _lying,
)  # fmt: skip


def all_cases(sizes: CaseSizes) -> Cases:
    """Yield every case of a taxel."""
    for number, family in enumerate(TAXEL_FAMILIES):
        yield from family(np.random.default_rng([_TAXEL_SEED, number]), sizes)


def all_module_cases(sizes: CaseSizes) -> ModuleCases:
    """Yield every case of a module."""
    for number, family in enumerate(MODULE_FAMILIES):
        yield from family(np.random.default_rng([_MODULE_SEED, number]), sizes)
