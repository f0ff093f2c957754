"""Poses of modules: positions of the pads at a pose, and their derivatives by the pose.

On a surface a module has three unknowns. It is bent and not stretched, so its pose is a point on the surface and a direction
along it, and its pads lie at the ends of straight geodesics (`skincal.mesh.geodesics`). On a mesh these unfold into a plane:
with x', y' the directions of the module's x and y carried to a pad at (bx, by),

    dP/da = x',   dP/db = y',   dP/dtheta = bx y' - by x',

exactly, within a triangle. Without a surface a module is flat and has six unknowns: a shift t and a turn w about its origin,
dP/dt = I, dP/dw = -S(P - origin). A turn is the path of a point `MODULE_TURN_TO_LENGTH_RADIUS_M` from the origin, so all
unknowns are metres.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, TypeAlias

import numpy as np

from skincal.geometry import FloatArray, IntArray, cross_matrix, crossed, rotations, select_rows, tangent_axes
from skincal.model.errors import InputError
from skincal.model.skin import Anchor, Layout, Module, SkinKind

if TYPE_CHECKING:
    from skincal.mesh.geodesics import MeshPoints
    from skincal.mesh.surface import Surface
    from skincal.model.scene import KnownDistance
    from skincal.modules.sheet_basis import SheetBasis

MODULE_TURN_TO_LENGTH_RADIUS_M = 0.010
"""Distance from a module's origin at which turns are counted as metres: about that of its outer pads."""


@dataclass(frozen=True, slots=True, eq=False)
class ModulePoses:
    """Poses of n modules, link frame."""

    points: FloatArray
    """(n, 3) float, metres: the modules' origins."""
    x: FloatArray
    """(n, 3) float, unit: the modules' x axes there."""
    normals: FloatArray
    """(n, 3) float, unit, outward, there."""
    triangles: IntArray
    """(n,) of the surface; -1 without one."""

    def select(self, rows: IntArray | slice) -> ModulePoses:
        return select_rows(self, rows)


@dataclass(frozen=True, slots=True, eq=False)
class Pads:
    """Positions of n pads."""

    points: FloatArray
    """(n, 3) float, metres, link frame."""
    gradients: FloatArray
    """(n, 3, d) float: derivative of a pad's position by the d unknowns of its module."""
    normals: FloatArray
    """(n, 3) float, unit, outward."""
    triangles: IntArray
    """(n,) of the surface; -1 without one."""


class ModulesOnSurface:
    """Surface that modules are bent onto."""

    unknowns = 3
    """Of each module."""

    def __init__(self, surface: Surface) -> None:
        self.surface = surface

    def place_pads(self, poses: ModulePoses, flat: FloatArray) -> Pads:
        """Place pads at `flat` (n, 2), metres, of modules at `poses` (n,): at the ends of geodesics."""
        end = _walked(self.surface, poses, flat)
        normals = self.surface.normals[end.triangles]
        x, y = end.x, crossed(normals, end.x)
        turn = (flat[:, :1] * y - flat[:, 1:] * x) / MODULE_TURN_TO_LENGTH_RADIUS_M
        return Pads(end.points, np.stack([x, y, turn], axis=2), normals, end.triangles)

    def move(self, poses: ModulePoses, moves: FloatArray) -> ModulePoses:
        """Move the poses (n,) by `moves` (n, 3): to the ends of geodesics, turned there."""
        end = _walked(self.surface, poses, moves[:, :2])
        normals = self.surface.normals[end.triangles]
        y = crossed(normals, end.x)
        c, s = np.cos(moves[:, 2:] / MODULE_TURN_TO_LENGTH_RADIUS_M), np.sin(moves[:, 2:] / MODULE_TURN_TO_LENGTH_RADIUS_M)
        return ModulePoses(end.points, c * end.x + s * y, normals, end.triangles)

    def axes(self, normals: FloatArray) -> FloatArray:
        """Rotation axes (n, 1, 3) of the last unknown: the normals."""
        return normals[:, None]


class ModulesInSpace:
    """Modules without a surface: flat, and anywhere in space."""

    unknowns = 6

    def place_pads(self, poses: ModulePoses, flat: FloatArray) -> Pads:
        """Place pads at `flat` (n, 2), metres, of modules at `poses` (n,), in the planes of the modules."""
        arms = flat[:, :1] * poses.x + flat[:, 1:] * crossed(poses.normals, poses.x)
        gradients = np.concatenate(
            [np.tile(np.eye(3), (len(flat), 1, 1)), -cross_matrix(arms) / MODULE_TURN_TO_LENGTH_RADIUS_M], axis=2
        )
        return Pads(poses.points + arms, gradients, poses.normals, poses.triangles)

    def move(self, poses: ModulePoses, moves: FloatArray) -> ModulePoses:
        """Move the poses (n,) by `moves` (n, 6): shift and turn them."""
        turn = rotations(moves[:, 3:] / MODULE_TURN_TO_LENGTH_RADIUS_M)
        x, normals = (np.sum(turn * v[:, None], axis=2) for v in (poses.x, poses.normals))
        return ModulePoses(poses.points + moves[:, :3], x, normals, poses.triangles)

    def axes(self, normals: FloatArray) -> FloatArray:
        """Rotation axes (n, 3, 3) of the last three unknowns: those of the link."""
        return np.tile(np.eye(3), (len(normals), 1, 1))


ModuleGround: TypeAlias = ModulesOnSurface | ModulesInSpace
"""Ground of the modules."""


def _walked(surface: Surface, poses: ModulePoses, ways: FloatArray) -> MeshPoints:
    """Walk straight along the surface from poses, by `ways` (n, 2), metres."""
    # Imported only now: a scene without a mesh does not need it.
    from skincal.mesh.geodesics import MeshPoints, geodesics_of

    return geodesics_of(surface).walk(MeshPoints(poses.triangles, poses.points, poses.x), ways)


def module_pads(module: Module) -> FloatArray:
    """Positions (k, 2) of a module's channels in its own plane, metres, mirrored if the module is."""
    pads = module.kind.pads[~np.isnan(module.kind.pads[:, 0])]
    return pads * np.array([-1.0 if module.mirror else 1.0, 1.0])


class ModuleModel:
    """Modules of a layout, with their poses by the plan.

    Parameters
    ----------
    anchor : of the layout; without one only modules with an own anchor have a planned pose
    distances : known between its modules
    """

    def __init__(
        self, layout: Layout, anchor: Anchor | None, surface: Surface | None, distances: Sequence[KnownDistance] = ()
    ) -> None:
        self.layout = layout
        self.distances = tuple(distances)
        self.ground: ModuleGround = ModulesInSpace() if surface is None else ModulesOnSurface(surface)
        self.pads: list[FloatArray] = [module_pads(module) for module in layout.modules]
        """Of each module, `module_pads`; of a sheet about the middle of its taxels, where its pose is."""
        self.channels: list[list[int]] = [module.channels.tolist() for module in layout.modules]
        """Of each module, in the order of its pads."""
        self._middles = [np.zeros(2) for _ in layout.modules]
        if layout.kind is SkinKind.SHEET:
            self._middles = [pads.mean(axis=0) for pads in self.pads]
            self.pads = [pads - middle for pads, middle in zip(self.pads, self._middles, strict=True)]
        self.bases: dict[int, SheetBasis] = {}
        """Of sheets, by module, once they are needed (`sheet_fit.basis_of`)."""
        self.place_of: IntArray = np.full(layout.width, -1, dtype=np.int64)
        """(width,) index of a channel among its module's pads; -1 for no taxel."""
        for module in layout.modules:
            self.place_of[module.channels] = np.arange(len(module.channels))
        # A list, since numbers of arrays one by one take ten times as long.
        self._module_of: list[int] = layout.module_of.tolist()
        self._anchor = anchor
        self._surface = surface
        self._plans: dict[int, ModulePoses | None] = {}
        self._planned: dict[int, FloatArray] = {}

    def with_layout(self, layout: Layout) -> ModuleModel:
        """Make the model of another layout of these modules on the same part, without known distances."""
        model = ModuleModel(layout, self._anchor, self._surface)
        pairs = zip(self.layout.modules, layout.modules, strict=True)
        # Placing a module on a mesh takes milliseconds: an equal plan is kept.
        same = [index for index, (before, after) in enumerate(pairs) if _same_plan(before, after)]
        model._plans = {index: self._plans[index] for index in same if index in self._plans}
        model._planned = {index: self._planned[index] for index in same if index in self._planned}
        return model

    def plan(self, module: int) -> ModulePoses | None:
        """Compute the planned pose of a module; `None` without an anchor, or if the anchor does not fit the part."""
        if module not in self._plans:
            own = self.layout.modules[module]
            try:
                self._plans[module] = _planned(own, own.anchor or self._anchor, self.ground, self._middles[module])
            except InputError:
                # Reported when the layout is placed.
                self._plans[module] = None
        return self._plans[module]

    def planned(self, module: int) -> FloatArray | None:
        """Compute the planned positions of a module's pads, (k, 3) float, metres; `None` as for `plan`."""
        plan = self.plan(module)
        if plan is not None and module not in self._planned:
            pads = self.pads[module]
            self._planned[module] = self.ground.place_pads(plan.select(np.zeros(len(pads), dtype=np.int64)), pads).points
        return self._planned.get(module)

    def modules_of(self, channels: Iterable[int]) -> list[int]:
        """List the indices of the modules of some channels, ascending."""
        owners = {self._module_of[channel] for channel in channels if 0 <= channel < len(self._module_of)}
        return sorted(owners - {-1})

    def channels_of(self, modules: Iterable[int]) -> list[int]:
        """List the channels of modules, module by module."""
        return [channel for module in modules for channel in self.channels[module]]


def _same_plan(module: Module, other: Module) -> bool:
    same_place = module.place is other.place and module.kind is other.kind
    return same_place and (module.angle, module.mirror) == (other.angle, other.mirror)


def _planned(module: Module, anchor: Anchor | None, ground: ModuleGround, middle: FloatArray) -> ModulePoses | None:
    """Compute the planned pose of a module at the point `middle`, (2,) metres, of its plane; `None` without an anchor."""
    if anchor is None:
        return None
    c, s = np.cos(module.angle), np.sin(module.angle)
    way = module.place - anchor.at + np.array([c * middle[0] - s * middle[1], s * middle[0] + c * middle[1]])
    if isinstance(ground, ModulesOnSurface):
        from skincal.mesh.lay import place_anchor

        start = place_anchor(ground.surface, anchor, f"the anchor of module {module.id}")
        at = ModulePoses(start.points, start.x, ground.surface.normals[start.triangles], start.triangles)
        return ground.move(at, np.array([[*way, module.angle * MODULE_TURN_TO_LENGTH_RADIUS_M]]))
    normal = anchor.normal / np.linalg.norm(anchor.normal)
    x, y = tangent_axes(anchor.x, normal)
    own = np.cos(module.angle) * x + np.sin(module.angle) * y
    return ModulePoses((anchor.point + way[0] * x + way[1] * y)[None], own[None], normal[None], np.full(1, -1, dtype=np.int64))


def join_poses(poses: Sequence[ModulePoses]) -> ModulePoses:
    """Concatenate poses."""
    names = ("points", "x", "normals", "triangles")
    return ModulePoses(*(np.concatenate([getattr(pose, name) for pose in poses]) for name in names))
