"""Poses of modules: where a pose puts the module's pads, and how that changes with the pose.

On a surface a module has three unknowns: it is bent and not stretched, so its pose is a place on the surface and a
direction along it, and its pads lie at the ends of straight geodesics (`skincal.mesh.geodesics`). On a mesh these unfold
into a plane: with x', y' the directions of the module's x and y carried to a pad at (bx, by),

    dP/da = x',   dP/db = y',   dP/dtheta = bx y' - by x',

exactly, within a triangle. Without a surface a module is flat and has six unknowns: a shift t and a turn w about its origin,
dP/dt = I, dP/dw = -S(P - origin). Turns are counted as the way of a point `LEVER` from the origin, so all unknowns are
metres.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, TypeAlias

import numpy as np

from skincal.geometry import FloatArray, IntArray, cross_matrix, crossed
from skincal.model.errors import InputError
from skincal.model.skin import Anchor, Layout, Module

if TYPE_CHECKING:
    from skincal.mesh.geodesics import MeshPoints
    from skincal.mesh.surface import Surface
    from skincal.model.scene import KnownDistance

LEVER = 0.010
"""m: a turn is counted as the way of a point this far from the module's origin, about as far as its outer pads."""


@dataclass(frozen=True, slots=True, eq=False)
class ModulePoses:
    """Poses of n modules, link frame."""

    points: FloatArray
    """(n, 3) float, metres: the modules' origins."""
    x: FloatArray
    """(n, 3) float, unit: where the modules' x axes point there."""
    normals: FloatArray
    """(n, 3) float, unit, outward, there."""
    triangles: IntArray
    """(n,) of the surface; -1 without one."""

    def take(self, rows: IntArray) -> ModulePoses:
        """Return some of them."""
        return ModulePoses(self.points[rows], self.x[rows], self.normals[rows], self.triangles[rows])


@dataclass(frozen=True, slots=True, eq=False)
class Pads:
    """Where n pads lie."""

    points: FloatArray
    """(n, 3) float, metres, link frame."""
    gradients: FloatArray
    """(n, 3, d) float: change of a pad's place with the d unknowns of its module."""
    normals: FloatArray
    """(n, 3) float, unit, outward."""
    triangles: IntArray
    """(n,) of the surface; -1 without one."""


class ModulesOnSurface:
    """A surface that modules are bent onto."""

    unknowns = 3
    """d, of each module."""

    def __init__(self, surface: Surface) -> None:
        self.surface = surface

    def place_pads(self, poses: ModulePoses, flat: FloatArray) -> Pads:
        """Return where pads at `flat` (n, 2), metres, of modules at `poses` (n,) lie: at the ends of geodesics."""
        end = _walked(self.surface, poses, flat)
        normals = self.surface.normals[end.triangles]
        x, y = end.x, crossed(normals, end.x)
        turn = (flat[:, :1] * y - flat[:, 1:] * x) / LEVER
        return Pads(end.points, np.stack([x, y, turn], axis=2), normals, end.triangles)

    def move(self, poses: ModulePoses, moves: FloatArray) -> ModulePoses:
        """Return the poses (n,) moved by `moves` (n, 3): at the ends of geodesics, turned there."""
        end = _walked(self.surface, poses, moves[:, :2])
        normals = self.surface.normals[end.triangles]
        y = crossed(normals, end.x)
        c, s = np.cos(moves[:, 2:] / LEVER), np.sin(moves[:, 2:] / LEVER)
        return ModulePoses(end.points, c * end.x + s * y, normals, end.triangles)

    def axes(self, normals: FloatArray) -> FloatArray:
        """Return (n, 1, 3) the axes that the last unknown turns places about, the normals: a module turns in its plane."""
        return normals[:, None]


class ModulesInSpace:
    """No surface: modules are flat and lie anywhere."""

    unknowns = 6

    def place_pads(self, poses: ModulePoses, flat: FloatArray) -> Pads:
        """Return where pads at `flat` (n, 2), metres, of modules at `poses` (n,) lie, in the planes of the modules."""
        arms = flat[:, :1] * poses.x + flat[:, 1:] * crossed(poses.normals, poses.x)
        gradients = np.concatenate([np.tile(np.eye(3), (len(flat), 1, 1)), -cross_matrix(arms) / LEVER], axis=2)
        return Pads(poses.points + arms, gradients, poses.normals, poses.triangles)

    def move(self, poses: ModulePoses, moves: FloatArray) -> ModulePoses:
        """Return the poses (n,) moved by `moves` (n, 6): shifted and turned."""
        turn = rotations(moves[:, 3:] / LEVER)
        x, normals = (np.sum(turn * v[:, None], axis=2) for v in (poses.x, poses.normals))
        return ModulePoses(poses.points + moves[:, :3], x, normals, poses.triangles)

    def axes(self, normals: FloatArray) -> FloatArray:
        """Return (n, 3, 3) the axes that the last three unknowns turn places about: those of the link."""
        return np.tile(np.eye(3), (len(normals), 1, 1))


ModuleGround: TypeAlias = ModulesOnSurface | ModulesInSpace
"""What modules lie on."""


def _walked(surface: Surface, poses: ModulePoses, ways: FloatArray) -> MeshPoints:
    """Return where straight ways (n, 2) from poses end, metres."""
    # Imported only now: a scene without a mesh loads nothing of it.
    from skincal.mesh.geodesics import MeshPoints, geodesics_of

    return geodesics_of(surface).walk(MeshPoints(poses.triangles, poses.points, poses.x), ways)


def rotations(vectors: FloatArray) -> FloatArray:
    """Return (n, 3, 3) the turns about `vectors` (n, 3) by their lengths, radians (Rodrigues)."""
    angles = np.sqrt(np.sum(vectors * vectors, axis=1))[:, None, None]
    s = cross_matrix(vectors)
    squared = vectors[:, :, None] * vectors[:, None] - angles**2 * np.eye(3)
    return np.eye(3) + np.sinc(angles / np.pi) * s + 0.5 * np.sinc(angles / (2.0 * np.pi)) ** 2 * squared


def module_pads(module: Module) -> FloatArray:
    """Return (k, 2) the places of a module's channels in its own plane, metres, mirrored where it is."""
    pads = module.kind.pads[~np.isnan(module.kind.pads[:, 0])]
    return pads * np.array([-1.0 if module.mirror else 1.0, 1.0])


class ModuleModel:
    """The modules of a layout, and where the plan puts them.

    Parameters
    ----------
    layout, anchor : of the scene; without an anchor the plan does not say where
    surface : None where there is none
    distances : known between its modules
    """

    def __init__(
        self, layout: Layout, anchor: Anchor | None, surface: Surface | None, distances: Sequence[KnownDistance] = ()
    ) -> None:
        self.layout = layout
        self.distances = tuple(distances)
        self.ground: ModuleGround = ModulesInSpace() if surface is None else ModulesOnSurface(surface)
        self.pads: list[FloatArray] = [module_pads(module) for module in layout.modules]
        """Of each module, `module_pads`."""
        self.place_of: IntArray = np.full(layout.width, -1, dtype=np.int64)
        """(width,) which of its module's pads a channel is; -1 where there is no taxel."""
        for module in layout.modules:
            self.place_of[module.channels] = np.arange(len(module.channels))
        self._anchor = anchor
        self._surface = surface
        self._plans: dict[int, ModulePoses | None] = {}
        self._planned: dict[int, FloatArray] = {}

    def with_layout(self, layout: Layout) -> ModuleModel:
        """Return the model of another layout of these modules on the same part, without known distances."""
        model = ModuleModel(layout, self._anchor, self._surface)
        pairs = zip(self.layout.modules, layout.modules, strict=True)
        # Laying a module out on a mesh costs milliseconds: a plan that is the same is not made anew.
        same = [index for index, (before, after) in enumerate(pairs) if _same_plan(before, after)]
        model._plans = {index: self._plans[index] for index in same if index in self._plans}
        model._planned = {index: self._planned[index] for index in same if index in self._planned}
        return model

    def plan(self, module: int) -> ModulePoses | None:
        """Return where the plan puts a module, one pose; None where it does not say, or is of another part."""
        if module not in self._plans:
            own = self.layout.modules[module]
            try:
                self._plans[module] = _planned(own, own.anchor or self._anchor, self.ground)
            except InputError:
                # Laying the layout out reports it.
                self._plans[module] = None
        return self._plans[module]

    def planned(self, module: int) -> FloatArray | None:
        """Return where the plan puts a module's pads, (k, 3) float, metres; None where it does not say."""
        plan = self.plan(module)
        if plan is not None and module not in self._planned:
            pads = self.pads[module]
            self._planned[module] = self.ground.place_pads(plan.take(np.zeros(len(pads), dtype=np.int64)), pads).points
        return self._planned.get(module)

    def modules_of(self, channels: Iterable[int]) -> list[int]:
        """Return the indices of the modules that some channels belong to, ascending."""
        owners = {int(self.layout.module_of[channel]) for channel in channels if 0 <= channel < self.layout.width}
        return sorted(owners - {-1})

    def channels_of(self, modules: Iterable[int]) -> list[int]:
        """Return the taxels of modules, module by module."""
        return [channel for module in modules for channel in self.layout.modules[module].channels.tolist()]


def _same_plan(module: Module, other: Module) -> bool:
    same_place = module.place is other.place and module.kind is other.kind
    return same_place and (module.angle, module.mirror) == (other.angle, other.mirror)


def _planned(module: Module, anchor: Anchor | None, ground: ModuleGround) -> ModulePoses | None:
    """Return where the plan puts a module; None without an anchor."""
    if anchor is None:
        return None
    way = module.place - anchor.at
    if isinstance(ground, ModulesOnSurface):
        from skincal.mesh.lay import place_anchor

        start = place_anchor(ground.surface, anchor, f"the anchor of module {module.id}")
        at = ModulePoses(start.points, start.x, ground.surface.normals[start.triangles], start.triangles)
        return ground.move(at, np.array([[*way, module.angle * LEVER]]))
    normal = anchor.normal / np.linalg.norm(anchor.normal)
    x = anchor.x - (anchor.x @ normal) * normal
    x = x / np.linalg.norm(x)
    y = np.cross(normal, x)
    own = np.cos(module.angle) * x + np.sin(module.angle) * y
    return ModulePoses((anchor.point + way[0] * x + way[1] * y)[None], own[None], normal[None], np.full(1, -1, dtype=np.int64))


def join_poses(poses: Sequence[ModulePoses]) -> ModulePoses:
    """Return all poses of several as one."""
    return ModulePoses(
        np.concatenate([pose.points for pose in poses]),
        np.concatenate([pose.x for pose in poses]),
        np.concatenate([pose.normals for pose in poses]),
        np.concatenate([pose.triangles for pose in poses]),
    )
