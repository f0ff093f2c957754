"""Stiff and extreme cases of the stability study: few or parallel axes, extreme weights, lengths and forces, bad meshes.

Readings follow the paper's (1), (2) and (6), in general directions, so that no zero or one hides an error. The solvers get the
rounded numbers, and these are the inputs of the study.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, fields, is_dataclass, replace
from typing import Any, TypeAlias

import numpy as np

from skincal.contacts.outcome import Contact
from skincal.geometry import FloatArray, IntArray, rotations
from skincal.mesh.surface import Surface, make_surface
from skincal.model.scene import KnownDistance, NoiseSettings
from skincal.model.skin import MODULE_KINDS, Anchor, Layout, Module
from skincal.modules.pose import ModuleGround, ModuleModel, ModulePoses, ModulesInSpace, ModulesOnSurface

TAXEL_POINT = np.array([0.031, -0.047, 0.083])
"""m, link frame: a typical position on a forearm."""
MINUS_Z = np.array([0.0, 0.0, -1.0])
MODULE_KIND = MODULE_KINDS["triangle_12"]
PADS_PER_MODULE = len(MODULE_KIND.pads)


@dataclass(frozen=True, slots=True)
class CaseSizes:
    """Sizes of the cases."""

    contacts: int
    grid: int
    """Squares along each side of a sheet."""
    many: int
    """Contacts of the case with most of them."""
    draws: int = 20
    """Perturbations of a case. The largest change of 20 is 0.87 of that of 120 in the median, of 8 it is 0.79."""
    only: frozenset[str] = frozenset()
    """Names of the cases; empty for all."""


FULL_SIZES = CaseSizes(contacts=24, grid=24, many=3_000)
QUICK_SIZES = CaseSizes(contacts=10, grid=8, many=300, draws=8)


@dataclass(frozen=True, slots=True, eq=False)
class Readings:
    """The numbers of n contacts."""

    forces: FloatArray
    """(n, 3) float, N, sensor frame."""
    moments: FloatArray
    """(n, 3) float, N m, about the sensor's origin."""
    responses: FloatArray
    """(n,) float > 0, of a taxel; (n, k) of each pad of a module, zero if it did not answer."""
    poses: FloatArray
    """(g, 4, 4) float: link_from_sensor of each arm pose."""
    pose_of: IntArray
    """(n,) index into `poses`."""
    other_response: FloatArray
    """(n,) float: of a stronger taxel, or of another module; zero without one."""

    @property
    def strongest(self) -> FloatArray:
        """(n,) float: largest response in each of the taxel's n contacts."""
        return np.maximum(self.responses, self.other_response)

    def ordered(self, order: IntArray) -> Readings:
        """Reorder the contacts. `order` may repeat some."""
        return replace(self, **{own.name: getattr(self, own.name)[order] for own in fields(self) if own.name != "poses"})


def perturbed(inputs: Any, rng: np.random.Generator) -> Any:
    """Move every float in the arrays of `inputs` (a dataclass, a tuple or an array) up or down by one unit in its last place.

    Zeros and the last row of poses stay.
    """
    values: Any = inputs
    if isinstance(inputs, tuple):
        return tuple(perturbed(each, rng) for each in values)
    if is_dataclass(inputs) and not isinstance(inputs, type):
        return replace(inputs, **{own.name: perturbed(getattr(inputs, own.name), rng) for own in fields(inputs)})
    if not isinstance(inputs, np.ndarray) or values.dtype.kind != "f":
        return values
    array: FloatArray = values
    towards = np.where(rng.integers(0, 2, array.shape) == 0, -np.inf, np.inf)
    moved = np.where(array == 0, 0.0, np.nextafter(array, towards))
    if array.shape[-2:] == (4, 4):
        moved[..., 3, :] = array[..., 3, :]
    return moved


@dataclass(frozen=True, slots=True, eq=False)
class RawMesh:
    """A surface as `make_surface` gets it."""

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
    """One taxel, to be solved by the free method, or with a mesh by the surface method."""

    name: str
    readings: Readings
    mesh: RawMesh | None = None
    blind: bool = False
    """Whether all axes are parallel to the last digit, so that rank 2 is right."""
    repeats: int = 1
    """How often each reading occurs."""
    family: str = ""
    """Kind of difficulty, a row of the figure."""

    @property
    def solver(self) -> str:
        """Name of the method that solves the case."""
        return "free" if self.mesh is None else "surface"


@dataclass(frozen=True, slots=True, eq=False)
class PlacedModule:
    """True pose of a module, and its pads."""

    at: ModulePoses
    """One pose; a triangle of the mesh, or -1."""
    mesh: RawMesh | None = None
    mirror: bool = False

    @property
    def flat(self) -> FloatArray:
        """(k, 2) float, metres: the pads in the module's plane."""
        return MODULE_KIND.pads * np.array([-1.0 if self.mirror else 1.0, 1.0])

    @property
    def ground(self) -> ModuleGround:
        """Space or surface in which the module moves."""
        if self.mesh is None:
            return ModulesInSpace()
        return ModulesOnSurface(make_surface(self.mesh.vertices, self.mesh.triangles))

    def pad_positions(self) -> FloatArray:
        """(k, 3) float, metres: the pads' positions."""
        return self.ground.place_pads(self.at.select(np.zeros(PADS_PER_MODULE, dtype=np.int64)), self.flat).points


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class ModuleCase(Case):
    """Case of the modules method: one module and its pokes."""

    module: PlacedModule
    start: ModulePoses
    """Start of the search, one pose."""
    noise: NoiseSettings = field(default_factory=NoiseSettings)
    out_of_reach: bool = False
    """Whether the answer is farther off than a search goes. Then blind pads are compared, and no positions."""

    @property
    def solver(self) -> str:
        """Name of the method that solves the case."""
        return "modules"


def contacts_of(case: Case, order: IntArray) -> list[Contact]:
    """Make contacts in this order. The last channel is that of `other_response`."""
    readings = case.readings.ordered(order)
    answers = np.column_stack([readings.responses, readings.other_response])
    # Contacts of a taxel keep their numbers, those of a module are numbered in order.
    numbers = np.arange(len(order)) if isinstance(case, ModuleCase) else order
    return [
        Contact(
            poke=number + 1, start_s=0.0, end_s=1.0, force=readings.forces[at], moment=readings.moments[at],
            channels=np.flatnonzero(answers[at]), responses=answers[at][answers[at] > 0],
            link_from_sensor=readings.poses[pose], pose=f"pose {pose}", tare_change=0.0, final=True,
        )
        for at, (number, pose) in enumerate(zip(numbers.tolist(), readings.pose_of.tolist(), strict=True))
    ]  # fmt: skip


def model_of(cases: Sequence[ModuleCase], surface: Surface | None, distances: Sequence[KnownDistance] = ()) -> ModuleModel:
    """Make a layout of one module for each case, anchored at the start of its search."""
    anchors = [
        Anchor(np.zeros(2), *(part[0] for part in (case.start.points, case.start.x, case.start.normals))) for case in cases
    ]
    modules = tuple(
        Module(number, MODULE_KIND, number * PADS_PER_MODULE, np.zeros(2), 0.0, case.module.mirror, anchor)
        for number, (case, anchor) in enumerate(zip(cases, anchors, strict=True))
    )
    return ModuleModel(Layout(modules, len(modules) * PADS_PER_MODULE + 1), None, surface, distances)


# ---- geometry and presses ----


def unit(v: FloatArray) -> FloatArray:
    """Scale `v` (..., 3) to length 1."""
    return v / np.linalg.norm(v, axis=-1, keepdims=True)


def cone(rng: np.random.Generator, count: int, angle: float, axis: FloatArray | None = None) -> FloatArray:
    """Draw (count, 3) unit directions within `angle` (rad) of `axis` (3,), by default a random one. Most are near the rim."""
    axis = unit(rng.normal(size=3)) if axis is None else axis
    aside = unit(np.cross(axis, rng.normal(size=(count, 3))))
    return unit(axis + np.tan(angle * rng.uniform(0.5, 1.0, (count, 1))) * aside)


def arm_poses(rng: np.random.Generator, count: int, reach: float) -> FloatArray:
    """Draw (count, 4, 4) poses with a general rotation and the sensor `reach` metres away."""
    poses = np.tile(np.eye(4), (count, 1, 1))
    for pose in poses:
        rotation = np.asarray(np.linalg.qr(rng.normal(size=(3, 3)))[0])
        pose[:3, :3] = rotation * np.sign(np.linalg.det(rotation))
        pose[:3, 3] = reach * unit(rng.normal(size=3))
    return poses


def sensor_readings(
    rng: np.random.Generator, directions: FloatArray, points: FloatArray, forces: FloatArray | float, poses: FloatArray
) -> tuple[FloatArray, FloatArray, IntArray]:
    """Compute forces and moments (n, 3) in the sensor frame of pushes of about `forces` N at `points`, and their poses."""
    count = len(directions)
    pose_of = np.arange(count) % len(poses)
    turns, shifts = poses[pose_of, :3, :3], poses[pose_of, :3, 3]
    force = directions * np.broadcast_to(forces, count)[:, None] * rng.uniform(0.8, 1.2, (count, 1))
    # R' v as a row times R.
    felt, lever = (np.einsum("ni,nij->nj", v, turns) for v in (force, points - shifts))
    return felt, np.asarray(np.cross(lever, felt), dtype=float), pose_of


@dataclass(frozen=True, slots=True, eq=False)
class TaxelPresses:
    """Presses of one taxel, from the arm poses in turn."""

    directions: FloatArray
    """(n, 3) float, unit, link frame."""
    taxel: FloatArray = field(default_factory=TAXEL_POINT.copy)
    weights: FloatArray | float = 1.0
    forces: FloatArray | float = 8.0
    """N."""
    scatter: FloatArray | float = 0.001
    """m, distance of the contact points from the taxel."""
    poses: FloatArray = field(default_factory=lambda: np.eye(4)[None])
    pitch: float = 0.0
    """m, torque about the push over the force: a finger that twists, or two contacts."""

    def simulate(self, rng: np.random.Generator) -> Readings:
        """Simulate the readings."""
        count = len(self.directions)
        aside = unit(np.cross(self.directions, rng.normal(size=(count, 3))))
        points = self.taxel + np.broadcast_to(self.scatter, count)[:, None] * aside
        felt, moments, pose_of = sensor_readings(rng, self.directions, points, self.forces, self.poses)
        strongest = rng.uniform(50.0, 200.0, count)
        weights = np.broadcast_to(self.weights, count)
        responses, other = np.where(weights == 1.0, [strongest, 0.0 * strongest], [strongest * weights, strongest])
        return Readings(felt, moments + self.pitch * felt, responses, self.poses, pose_of, other)


def taxel_case(name: str, rng: np.random.Generator, directions: FloatArray, mesh: RawMesh | None = None, **how: Any) -> Case:
    """Make the case of a taxel with the other fields of `TaxelPresses`."""
    return Case(name, TaxelPresses(directions, **how).simulate(rng), mesh)


Cases: TypeAlias = Iterator[Case]

# ---- cases of the free method ----


def _parallel(rng: np.random.Generator, sizes: CaseSizes) -> Cases:
    n = sizes.contacts
    for digits in (1, 2, 3, 4, 6, 8, 9):
        yield taxel_case(f"axes within 1e-{digits} rad", rng, cone(rng, n, 10.0**-digits), scatter=0.0)
    for digits in (2, 5, 8):
        yield taxel_case(f"axes within 1e-{digits} rad, contacts 1 mm off", rng, cone(rng, n, 10.0**-digits))
    yield taxel_case("axes within 1e-7 rad of z", rng, cone(rng, n, 1e-7, MINUS_Z), scatter=0.0)
    yield taxel_case("axes within 1e-5 rad, 4 arm poses", rng, cone(rng, n, 1e-5), scatter=0.0, poses=arm_poses(rng, 4, 0.3))


def _few_axes(rng: np.random.Generator, sizes: CaseSizes) -> Cases:
    n, axis = sizes.contacts, cone(rng, 1, 0.5)
    same, forces, weights = np.repeat(axis, n, axis=0), np.geomspace(0.01, 100.0, n), np.geomspace(1, 1e-12, n)
    for case in (
        taxel_case("one axis", rng, axis),
        taxel_case("one axis, far sensor, general pose", rng, axis, poses=arm_poses(rng, 1, 30.0)),
        replace(taxel_case("one axis, read many times", rng, axis), repeats=n),
        taxel_case("one axis, many forces", rng, same, forces=forces, scatter=0.0),
        taxel_case("one axis, weights 1 to 1e-12", rng, same, weights=weights, scatter=0.0),
    ):
        yield replace(case, blind=True)
    yield taxel_case("two axes that cross", rng, cone(rng, 2, 0.8), scatter=0.0)
    yield taxel_case("two axes 1 mm apart", rng, cone(rng, 2, 0.8))
    yield taxel_case("two axes within 1e-6 rad", rng, cone(rng, 2, 1e-6), scatter=0.0)
    yield taxel_case("two axes, one weighs 1e-12", rng, cone(rng, 2, 0.8), weights=np.array([1.0, 1e-12]))


def _stiff(rng: np.random.Generator, sizes: CaseSizes) -> Cases:
    n, at = sizes.contacts, np.arange(sizes.contacts)
    wide, falling = cone(rng, n, 0.8), np.geomspace(1, 1e-12, n)
    yield taxel_case("weights 1 to 1e-12", rng, wide, weights=falling)
    yield taxel_case("weights 1 to 1e-12, 5 arm poses", rng, wide, poses=arm_poses(rng, 5, 0.4), weights=falling)
    yield taxel_case("weights 1 or 1e-12", rng, wide, weights=np.where(at % 2, 1.0, 1e-12))
    for light in (1e-3, 1e-6, 1e-9, 1e-12):
        weights = np.where(at == 0, 1.0, light)
        yield taxel_case(f"one heavy axis, the rest weigh {light:.0e}", rng, wide, weights=weights)
        yield taxel_case(f"one heavy axis with a torque, the rest weigh {light:.0e}", rng, wide, weights=weights, pitch=0.02)
    for digits, light in ((3, 1e-6), (6, 1e-12), (9, 1e-6), (9, 1e-12)):
        parts = np.concatenate([cone(rng, n // 2, 10.0**-digits, wide[0]), cone(rng, n - n // 2, 0.8, wide[0])])
        name = f"heavy axes within 1e-{digits} rad, light ones of {light:.0e} fix the depth"
        yield taxel_case(name, rng, parts, weights=np.where(at < n // 2, 1.0, light), scatter=0.0)
    for digits in (2, 4):
        close, weights = cone(rng, n, 10.0**-digits), np.where(at == 0, 1.0, 1e-12)
        yield taxel_case(f"one heavy axis, 1e-12 within 1e-{digits} rad of it", rng, close, weights=weights, scatter=0.0)
    parts, weights = np.concatenate([cone(rng, 3, 1e-9, MINUS_Z), cone(rng, n - 3, 0.04, MINUS_Z)]), np.where(at < 3, 1.0, 1e-4)
    name = "heavy axes within 1e-9 rad of z and 1 cm off, light ones of 1e-4"
    yield taxel_case(name, rng, parts, weights=weights, scatter=np.where(at < 3, 0.01, 0.0))


def _scales(rng: np.random.Generator, sizes: CaseSizes) -> Cases:
    n = sizes.contacts
    wide = cone(rng, n, 0.6)
    for lever in (1e-3, 1e1, 1e4):
        yield taxel_case(f"levers of {lever:g} m", rng, wide, poses=arm_poses(rng, 3, lever))
        yield taxel_case(f"taxel {lever:g} m from the link", rng, wide, taxel=TAXEL_POINT + lever * unit(rng.normal(size=3)))
    for words, force in (("of 1e-06", 1e-6), ("of 10000", 1e4), ("1e-6 to 1e4", np.geomspace(1e-6, 1e4, n))):
        yield taxel_case(f"forces {words} N", rng, wide, forces=force, poses=arm_poses(rng, 2, 0.3))
    good = TaxelPresses(wide, poses=arm_poses(rng, 3, 0.3)).simulate(rng)
    in_mm = good.poses * np.array([1.0, 1.0, 1.0, 1e3])
    in_mm[:, 3, 3] = 1.0
    yield Case("arm in millimetres by mistake", replace(good, poses=in_mm))
    yield Case("newton millimetres by mistake", replace(good, moments=good.moments * 1e3))
    far = arm_poses(rng, 3, 1e3)
    yield taxel_case("axes within 1e-4 rad, levers of 1000 m", rng, cone(rng, n, 1e-4), poses=far, scatter=0.0)


def _counts(rng: np.random.Generator, sizes: CaseSizes) -> Cases:
    poses = arm_poses(rng, 7, 0.3)
    yield taxel_case("7 arm poses", rng, cone(rng, sizes.contacts, 0.5), poses=poses)
    once = TaxelPresses(cone(rng, sizes.contacts, 0.5), poses=poses).simulate(rng)
    yield Case("every reading there 10 times", once.ordered(np.tile(np.arange(sizes.contacts), 10)))
    yield taxel_case(f"{sizes.many} readings", rng, cone(rng, sizes.many, 0.5))


# ---- cases of the surface method ----


def sheet(rng: np.random.Generator, squares: int, bend: float = 20.0, side: float = 0.06) -> RawMesh:
    """Make a square mesh of `squares` x `squares` x 2 triangles, randomly turned, with its middle at `TAXEL_POINT`.

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
    return RawMesh(local @ arm_poses(rng, 1, 1.0)[0, :3, :3].T + TAXEL_POINT, np.concatenate([lower, upper]))


INSIDE, EDGE, VERTEX = (0.2, 0.5, 0.3), (0.4, 0.6, 0.0), (1.0, 0.0, 0.0)


def _nearest_triangle(mesh: RawMesh, point: FloatArray = TAXEL_POINT) -> int:
    return int(np.linalg.norm(mesh.corners.mean(axis=1) - point, axis=1).argmin())


def _point_on(mesh: RawMesh, shares: tuple[float, ...] = INSIDE, triangle: int | None = None) -> tuple[FloatArray, FloatArray]:
    """Return the point of a triangle (by default the middle one) with these barycentric shares, and the direction into it."""
    corners = mesh.corners[_nearest_triangle(mesh) if triangle is None else triangle]
    normal = np.asarray(np.cross(corners[1] - corners[0], corners[2] - corners[0]), dtype=float)
    return np.array(shares) @ corners, -unit(normal)


def _on_sheet(rng: np.random.Generator, sizes: CaseSizes) -> Cases:
    for name, bend in (("a bent sheet", 20.0), ("a hollow", -20.0), ("a flat sheet", 0.0)):
        mesh = sheet(rng, sizes.grid, bend)
        for place, shares, height, scatter in (
            ("inside a triangle", INSIDE, 0.0, 0.0005), ("on an edge", EDGE, 0.0, 0.0), ("on a vertex", VERTEX, 0.0, 0.0),
            ("0.3 mm over an edge", EDGE, 3e-4, 0.001), ("0.3 mm over a vertex", VERTEX, 3e-4, 0.001),
        ):  # fmt: skip
            taxel, push = _point_on(mesh, shares)
            how = {"taxel": taxel - height * push, "scatter": scatter}
            yield taxel_case(f"{name}, {place}", rng, cone(rng, sizes.contacts, 0.5, push), mesh, **how)


def _stiff_on_sheet(rng: np.random.Generator, sizes: CaseSizes) -> Cases:
    n = sizes.contacts
    mesh = sheet(rng, sizes.grid)
    taxel, push = _point_on(mesh)
    wide, poses = cone(rng, n, 0.6, push), arm_poses(rng, 5, 0.4)
    ways: dict[str, tuple[FloatArray, dict[str, Any]]] = {
        **{f"axes within 1e-{digits} rad": (cone(rng, n, 10.0**-digits, push), {}) for digits in (1, 3, 6, 9)},
        "one axis": (wide[:1], {}),
        "two axes": (wide[:2], {}),
        "weights 1 to 1e-12": (wide, {"weights": np.geomspace(1, 1e-12, n)}),
        "one heavy axis, the rest weigh 1e-9": (wide, {"weights": np.where(np.arange(n) == 0, 1.0, 1e-9)}),
        "5 arm poses": (wide, {"poses": poses}),
        "levers of 1e4 m": (wide, {"poses": arm_poses(rng, 3, 1e4)}),
        "forces 1e-6 to 1e4 N": (wide, {"forces": np.geomspace(1e-6, 1e4, n)}),
    }
    for name, (directions, how) in ways.items():
        yield taxel_case(f"surface, {name}", rng, directions, mesh, taxel=taxel, **how)
    good = TaxelPresses(wide, taxel=taxel, poses=poses).simulate(rng)
    yield Case("surface, newton millimetres by mistake", replace(good, moments=good.moments * 1e3), mesh)
    yield Case("surface, mesh in millimetres by mistake", good, replace(mesh, vertices=mesh.vertices * 1e3))
    yield Case("surface, every reading there 10 times", good.ordered(np.tile(np.arange(n), 10)), mesh)
    away = 1000.0 * unit(rng.normal(size=3))
    far, near_poses = replace(mesh, vertices=mesh.vertices + away), poses.copy()
    near_poses[:, :3, 3] += away
    yield taxel_case("mesh 1 km from the origin", rng, wide, far, taxel=taxel + away)
    yield taxel_case("mesh and sensor 1 km from the origin", rng, wide, far, taxel=taxel + away, poses=near_poses)


def _on_coarse_sheet(rng: np.random.Generator, sizes: CaseSizes) -> Cases:
    """Triangles half a metre wide: rounding of their size is far more than that of the readings."""
    n = sizes.contacts
    mesh = sheet(rng, 2, bend=1.0, side=1.0)
    weights, uneven, scatter = np.where(np.arange(n) < 3, 1.0, 1e-3), np.array([1.0, 1e-8]), np.array([0.0075, 0.0])
    near = (1 - 6e-4, 0.0, 6e-4)
    for place, shares in (("inside", INSIDE), ("at an edge", EDGE), ("at a vertex", VERTEX), ("near a vertex", near)):
        taxel, push = _point_on(mesh, shares)
        name = f"coarse sheet, {place}"
        close = cone(rng, n, 1e-6, unit(push + 0.6 * unit(np.cross(push, rng.normal(size=3)))))
        yield taxel_case(f"{name}, axes within 1e-6 rad", rng, close, mesh, taxel=taxel, weights=weights, scatter=0.0)
        two = cone(rng, 2, 1e-4, push)
        yield taxel_case(f"{name}, two axes, one weighs 1e-8", rng, two, mesh, taxel=taxel, weights=uneven, scatter=scatter)
        grazing = cone(rng, n, 1e-5, unit(np.cross(push, rng.normal(size=3)) + 1e-6 * push))
        yield taxel_case(f"{name}, axes within 1e-5 rad, tangent", rng, grazing, mesh, taxel=taxel, weights=1e-3, scatter=0.0)


def _tangent(rng: np.random.Generator, sizes: CaseSizes) -> Cases:
    n = sizes.contacts
    mesh = sheet(rng, sizes.grid, bend=0.0)
    taxel, push = _point_on(mesh)
    aside = unit(np.cross(push, rng.normal(size=3)))
    for digits in (2, 6, 9):
        grazing = unit(aside + 10.0**-digits * push)
        yield taxel_case(f"one axis 1e-{digits} rad from the surface", rng, grazing[None], mesh, taxel=taxel, scatter=0.0)
        turned = unit(grazing + np.cross(grazing, push) * rng.uniform(-0.5, 0.5, (n, 1)))
        yield taxel_case(f"axes 1e-{digits} rad from the surface", rng, turned, mesh, taxel=taxel, scatter=1e-4)
    first = np.arange(n) == 0
    for heavy, light in ((1e-6, 1e-3), (1e-9, 1e-3), (1e-9, 1e-6), (1e-9, 1e-9), (1e-11, 1e-9), (1e-11, 1e-12)):
        directions = np.concatenate([unit(aside + heavy * push)[None], cone(rng, n - 1, 0.5, unit(push + 0.3 * aside))])
        weights, scatter = np.where(first, 1.0, light), np.where(first, 0.0, 1e-3)
        name = f"heavy axis {heavy:.0e} rad from the surface, the rest weigh {light:.0e}"
        yield taxel_case(name, rng, directions, mesh, taxel=taxel, weights=weights, scatter=scatter)


def _gaps(rng: np.random.Generator, sizes: CaseSizes) -> Cases:
    n = sizes.contacts
    mesh = sheet(rng, sizes.grid)
    taxel, push = _point_on(mesh)
    reach = 1.6 * 0.06 / sizes.grid
    around = np.linalg.norm(mesh.corners.mean(axis=1) - taxel, axis=1) > reach
    holed = replace(mesh, triangles=mesh.triangles[around])
    yield taxel_case("at a hole", rng, cone(rng, n, 0.5, push), holed, taxel=taxel)
    yield taxel_case("at a hole, one axis", rng, cone(rng, 1, 0.2, push), holed, taxel=taxel)
    for name, vertex in (("at the rim", sizes.grid // 2), ("at a corner of the rim", 0)):
        taxel, push = _point_on(mesh, triangle=_nearest_triangle(mesh, mesh.vertices[vertex]))
        outside = taxel + 1.5 * (taxel - TAXEL_POINT) * (reach / np.linalg.norm(taxel - TAXEL_POINT))
        yield taxel_case(name, rng, cone(rng, n, 0.5, push), mesh, taxel=outside)


def _degenerate(rng: np.random.Generator, sizes: CaseSizes) -> Cases:
    n = sizes.contacts
    for ratio in (1e2, 1e4, 1e6):
        squares = sheet(rng, sizes.grid, bend=0.0)
        # Squeezed along a direction of the plane: needles of that ratio.
        _, push = _point_on(squares, triangle=0)
        thin, offset = unit(squares.vertices[1] - squares.vertices[0]), squares.vertices - TAXEL_POINT
        needles = replace(squares, vertices=squares.vertices - np.outer(offset @ thin, thin) * (1 - 1 / ratio))
        name, directions = f"needles {ratio:.0e} times as long as wide", cone(rng, n, 0.5, push)
        yield taxel_case(name, rng, directions, needles, taxel=_point_on(needles)[0], scatter=0.0)
    for height in (1e-9, 1e-12, 0.0):
        split, taxel, push = _with_sliver(sheet(rng, sizes.grid), height)
        name = "a triangle without area" if height == 0.0 else f"a triangle {height:.0e} m high"
        yield taxel_case(name, rng, cone(rng, n, 0.5, push), split, taxel=taxel, scatter=0.0)
    mesh = sheet(rng, sizes.grid)
    twice = replace(mesh, triangles=np.concatenate([mesh.triangles, mesh.triangles[:, [1, 2, 0]]]))
    taxel, push = _point_on(mesh)
    yield taxel_case("every triangle there twice", rng, cone(rng, n, 0.5, push), twice, taxel=taxel)


def _with_sliver(mesh: RawMesh, height: float) -> tuple[RawMesh, FloatArray, FloatArray]:
    """Return the mesh with a sliver along an edge of its middle triangle, a point of the sliver and the push into it."""
    middle = _nearest_triangle(mesh)
    a, b, c = mesh.triangles[middle]
    first, second, third = mesh.corners[middle]
    between, push = _point_on(mesh, (0.55, 0.45, 0.0))
    if height == 0.0:
        # A corner given twice: no rounding can give it an area.
        return replace(mesh, triangles=np.concatenate([mesh.triangles, [[a, b, a]]])), between, push
    across = np.asarray(np.cross(second - first, push), dtype=float)
    inward = unit(across) * np.sign(across @ (third - first))
    new = len(mesh.vertices)
    vertices = np.concatenate([mesh.vertices, [between + height * inward]])
    rest = np.delete(mesh.triangles, middle, axis=0)
    return RawMesh(vertices, np.concatenate([rest, [[a, b, new], [b, c, new], [c, a, new]]])), between, push


def _two_sheets(rng: np.random.Generator, sizes: CaseSizes) -> Cases:
    """Two sheets 10 mm apart, both crossed by an axis. The other axes decide for the one behind.

    Light ones (1e-6) would not: then a push is more likely from outside, which the reference does not know.
    """
    n = sizes.contacts
    front = sheet(rng, sizes.grid)
    taxel, push = _point_on(front)
    behind, beyond = 0.01 * push, front.triangles + len(front.vertices)
    both = RawMesh(np.concatenate([front.vertices, front.vertices + behind]), np.concatenate([front.triangles, beyond]))
    directions = np.concatenate([push[None], cone(rng, n - 1, 0.5, push)])
    yield taxel_case("two sheets, the axes tell which", rng, directions, both, taxel=taxel + behind, weights=np.ones(n))


# ---- cases of the modules method ----

Touched: TypeAlias = Sequence[Sequence[int]]
ALL_OVER: Touched = ((0, 1), (4,), (8, 9, 10), (6,), (3, 11), (1,), (5, 6), (9,), (2, 3), (7, 8, 11))
"""Pads that answer in turn, neighbours."""
ModuleCases: TypeAlias = Iterator[ModuleCase]


@dataclass(frozen=True, slots=True, eq=False)
class ModulePresses:
    """Presses of a module's pads in turn, from the arm poses in turn."""

    count: int
    tilt: float = 0.5
    """rad, within which pushes lie about one direction."""
    lean: FloatArray | None = None
    """(3,) unit, that direction; by default against the module's normal."""
    touched: Touched = ALL_OVER
    answers: FloatArray | None = None
    """(n, k) float, responses of the pads; by default random ones of the `touched` pads."""
    forces: FloatArray | float = 8.0
    scatter: float = 0.0005
    """m, distance of the contact points from the middle of the answering pads."""
    poses: FloatArray = field(default_factory=lambda: np.eye(4)[None])

    def simulate(self, rng: np.random.Generator, module: PlacedModule) -> Readings:
        """Simulate the readings."""
        directions = cone(rng, self.count, self.tilt, -module.at.normals[0] if self.lean is None else self.lean)
        answers = self.answers
        if answers is None:
            answers = np.zeros((self.count, PADS_PER_MODULE))
            for poke, row in enumerate(answers):
                own = list(self.touched[poke % len(self.touched)])
                row[own] = rng.uniform(50.0, 200.0, len(own))
        middles = answers @ module.pad_positions() / answers.sum(axis=1, keepdims=True)
        points = middles + self.scatter * unit(np.cross(directions, rng.normal(size=(self.count, 3))))
        felt, moments, pose_of = sensor_readings(rng, directions, points, self.forces, self.poses)
        return Readings(felt, moments, answers, self.poses, pose_of, np.zeros(self.count))


def in_space(rng: np.random.Generator, mirror: bool = False, at: FloatArray = TAXEL_POINT) -> PlacedModule:
    """Make a module without a surface, in a general direction."""
    turn = arm_poses(rng, 1, 1.0)[0, :3, :3]
    return PlacedModule(ModulePoses(at[None].copy(), turn[None, :, 0], turn[None, :, 2], np.full(1, -1)), mirror=mirror)


def on_sheet(
    rng: np.random.Generator, sizes: CaseSizes, bend: float = 0.0, aside: float = 0.0, away: float = 0.0, mirror: bool = False
) -> PlacedModule:
    """Make a module on a sheet, near its middle and turned.

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


def offset_pose(rng: np.random.Generator, module: PlacedModule, shift: float = 0.002, turn: float = 0.1) -> ModulePoses:
    """Return the module's pose displaced by `shift` (m) and `turn` (rad)."""
    ground, at = module.ground, module.at
    if ground.unknowns == 3:
        way = shift * unit(np.append(rng.normal(size=2), 0.0))
        return ground.move(at, np.array([[*way[:2], 0.010 * turn]]))
    # Tilted by a third of the turn in its plane.
    axis = at.normals[0] + 0.33 * unit(rng.normal(size=3))
    turned = rotations(turn * unit(axis)[None])[0]
    return ModulePoses(at.points + shift * unit(rng.normal(size=3)), at.x @ turned.T, at.normals @ turned.T, at.triangles)


def module_case(
    name: str,
    rng: np.random.Generator,
    module: PlacedModule,
    pokes: Readings | int,
    noise: NoiseSettings | None = None,
    **how: Any,
) -> ModuleCase:
    """Make the case of a module with these readings, or with a number of pokes and other fields of `ModulePresses`."""
    readings = ModulePresses(pokes, **how).simulate(rng, module) if isinstance(pokes, int) else pokes
    start, noise = offset_pose(rng, module), noise or NoiseSettings()
    return ModuleCase(name, readings, module.mesh, module=module, start=start, noise=noise)


def _module_parallel(rng: np.random.Generator, sizes: CaseSizes) -> ModuleCases:
    n, module = sizes.contacts, in_space(rng)
    lean = unit(-module.at.normals[0] + 0.4 * rng.normal(size=3))
    for digits in (1, 2, 4, 6):
        yield module_case(f"module, axes within 1e-{digits} rad", rng, module, n, tilt=10.0**-digits, lean=lean, scatter=0.0)
    flat = on_sheet(rng, sizes)
    lean = unit(-flat.at.normals[0] + 0.4 * rng.normal(size=3))
    yield module_case("module on a sheet, axes within 1e-6 rad", rng, flat, n, tilt=1e-6, lean=lean)
    lean = unit(np.cross(flat.at.normals[0], rng.normal(size=3)) - 0.02 * flat.at.normals[0])
    yield module_case("module on a sheet, axes graze it by 0.02 rad", rng, flat, n, tilt=0.01, lean=lean, scatter=1e-5)


def _module_few(rng: np.random.Generator, sizes: CaseSizes) -> ModuleCases:
    n, modules = sizes.contacts, {"module": in_space(rng), "module on a sheet": on_sheet(rng, sizes)}
    answers = np.zeros((n, PADS_PER_MODULE))
    answers[:, 4] = 120.0
    answers[np.arange(n), np.array([3, 5, 6])[np.arange(n) % 3]] = 0.012
    for name, module in modules.items():
        yield module_case(f"{name}, one poke", rng, module, 1, touched=((4,),))
        yield module_case(f"{name}, two pokes", rng, module, 2, touched=((4,), (8, 9)), scatter=0.0001)
        yield module_case(f"{name}, three pokes", rng, module, 3, touched=((0,), (5,), (9,)), scatter=0.0001)
        # Without noise of the skin: its direction is that of a module whose tilt the pokes do not determine.
        yield module_case(f"{name}, one pad poked", rng, module, n, NoiseSettings(contact=0.0), touched=((4,),))
        near, noise = f"{name}, one pad poked, neighbours answer by 1e-4", NoiseSettings(contact=1e-7)
        yield module_case(near, rng, module, n, noise, answers=answers, scatter=0.0)


def _module_stiff(rng: np.random.Generator, sizes: CaseSizes) -> ModuleCases:
    n, poses = sizes.contacts, arm_poses(rng, 3, 0.3)
    noises = {
        "force noise of 1e-6 N, moment 1 N m": NoiseSettings(force=1e-6, moment=1.0),
        "force noise of 1 N, moment 1e-6 N m": NoiseSettings(force=1.0, moment=1e-6),
        "contacts known to 1e-6 m": NoiseSettings(contact=1e-6, force=1e-4, moment=1e-6),
    }
    fine, some = NoiseSettings(contact=1e-7, force=1e-6), [(4,)] * (n // 3) + [(0,), (9,), (7, 8)] * n
    parted = np.where(np.arange(n) < n // 3, 1e4, 1e-4)
    answers = np.array([np.roll(np.r_[np.geomspace(1.0, 1e-12, 4), np.zeros(PADS_PER_MODULE - 4)], 3 * i) for i in range(n)])
    for name, module in (("module", in_space(rng)), ("module on a sheet", on_sheet(rng, sizes))):
        # With fewer, the light ones leave the module to three.
        mixed = rng.permutation(np.geomspace(1e-6, 1e4, max(n, 10)))
        yield module_case(f"{name}, forces 1e-6 to 1e4 N", rng, module, len(mixed), forces=mixed, poses=poses)
        usual = ModulePresses(n, poses=poses).simulate(rng, module)
        for words, noise in noises.items():
            yield module_case(f"{name}, {words}", rng, module, usual, noise)
        uneven = f"{name}, pokes of 1e4 N on one pad, of 1e-4 N elsewhere"
        yield module_case(uneven, rng, module, n, fine, touched=some, forces=parted, scatter=0.0)
        yield module_case(f"{name}, answers 1 to 1e-12", rng, module, n, answers=100.0 * answers)


def _module_scales(rng: np.random.Generator, sizes: CaseSizes) -> ModuleCases:
    n, module, flat = sizes.contacts, in_space(rng), on_sheet(rng, sizes)
    yield module_case("module, levers of 0.001 m", rng, module, n, poses=arm_poses(rng, 3, 1e-3))
    poses = arm_poses(rng, 3, 1e4)
    yield module_case("module, levers of 10000 m", rng, module, n, poses=poses)
    yield module_case("module on a sheet, levers of 10000 m", rng, flat, n, poses=poses)
    across, normal = arm_poses(rng, 1, 1e2), flat.at.normals[0]
    across[0, :3, 3] -= (across[0, :3, 3] @ normal) * normal
    yield module_case("module on a sheet, levers of 100 m across the push", rng, flat, n, tilt=1e-4, poses=across)
    good = ModulePresses(n, poses=arm_poses(rng, 3, 0.3)).simulate(rng, module)
    wrong = replace(good, moments=good.moments * 1e3)
    yield replace(module_case("module, newton millimetres by mistake", rng, module, wrong), out_of_reach=True)
    away = 1000.0 * unit(rng.normal(size=3))
    far, near_poses = in_space(rng, at=TAXEL_POINT + away), arm_poses(rng, 3, 0.3)
    near_poses[:, :3, 3] += away
    yield module_case("module and sensor 1 km from the origin", rng, far, n, poses=near_poses)
    yield module_case("module on a sheet 1 km from the origin", rng, on_sheet(rng, sizes, away=1000.0), n)


def _module_grounds(rng: np.random.Generator, sizes: CaseSizes) -> ModuleCases:
    n, poses = sizes.contacts, arm_poses(rng, 7, 0.3)
    modules = {
        "module": in_space(rng), "module, mirrored": in_space(rng, mirror=True), "module on a sheet": on_sheet(rng, sizes),
        "module on a sheet, mirrored": on_sheet(rng, sizes, mirror=True), "module on a bent sheet": on_sheet(rng, sizes, 8.0),
        "module over the rim of a sheet": on_sheet(rng, sizes, aside=0.025),
    }  # fmt: skip
    for name, module in modules.items():
        yield module_case(f"{name}, 7 arm poses", rng, module, n, poses=poses)
    for name in ("module", "module on a sheet"):
        module, usual = modules[name], ModulePresses(n, poses=poses).simulate(rng, modules[name])
        yield replace(module_case(f"{name}, every poke there 10 times", rng, module, usual), repeats=10)
        two = replace(usual, other_response=0.6 * usual.responses.max(axis=1) * (np.arange(n) % 2))
        yield module_case(f"{name}, another one answers too", rng, module, two)
        start = offset_pose(rng, module, 0.0075, np.radians(50.0))
        yield replace(module_case(f"{name}, begun 50 degrees and 7.5 mm off", rng, module, usual), start=start)


# ---- all cases; the numbers of one family do not depend on the others ----

TAXEL_SEED, MODULE_SEED = 20260721, 20261122
TAXEL_FAMILIES: dict[str, Callable[[np.random.Generator, CaseSizes], Cases]] = {
    "near-parallel axes": _parallel, "one or two axes": _few_axes, "stiff weights": _stiff, "lengths, forces, units": _scales,
    "poses and many readings": _counts, "sheets: inside, edges, vertices": _on_sheet, "stiff on a sheet": _stiff_on_sheet,
    "axes tangent to a sheet": _tangent, "holes and rims": _gaps, "degenerate triangles": _degenerate,
    "two sheets": _two_sheets, "coarse sheet": _on_coarse_sheet,
}  # fmt: skip
MODULE_FAMILIES: dict[str, Callable[[np.random.Generator, CaseSizes], ModuleCases]] = {
    "near-parallel axes": _module_parallel, "few pokes": _module_few, "stiff": _module_stiff,
    "lengths, forces, units": _module_scales, "space, sheets and rims": _module_grounds,
}  # fmt: skip


Outputs: TypeAlias = dict[str, Any]
"""Numbers by name: arrays of floats from the program, of exact numbers from its reference."""


@dataclass(frozen=True, slots=True, eq=False)
class AddedCase:
    """Inputs (a dataclass of arrays), and two ways to compute the outputs."""

    name: str
    inputs: Any
    shipped: Callable[[Any], Outputs]
    exact: Callable[[Any], Outputs]
    pokes: int
    family: str = ""


def cases_of(
    families: Mapping[str, Callable[[np.random.Generator, CaseSizes], Iterator[Any]]], seed: int, sizes: CaseSizes
) -> Iterator[Any]:
    """Yield the cases of some families."""
    for number, (name, family) in enumerate(families.items()):
        for case in family(np.random.default_rng([seed, number]), sizes):
            yield replace(case, family=name)


def taxel_cases(sizes: CaseSizes) -> Cases:
    """Yield the cases of one taxel."""
    return cases_of(TAXEL_FAMILIES, TAXEL_SEED, sizes)


def module_cases(sizes: CaseSizes) -> ModuleCases:
    """Yield the cases of one module."""
    return cases_of(MODULE_FAMILIES, MODULE_SEED, sizes)
