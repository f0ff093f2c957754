"""Scenes that ship as they are poked: their mesh, plan and modules, a good rig, and meshes of their parts of any size.

The rig has the noise of its sensors and no other error (`RigErrors.noise`), and is poked by somebody careful, unguided: what is
left of the error is the solver's and the noise's. Taxels lie on the mesh of the scene; the same contacts are solved on finer
and coarser meshes of the same shape as well, whose error includes what a coarse mesh costs.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from importlib import import_module
from typing import Any

import numpy as np

from skincal.contacts.outcome import Contact
from skincal.geometry.arrays import FloatArray, IntArray
from skincal.guide.places import PlannedPlaces, plan_from
from skincal.mesh.lay import lay
from skincal.mesh.load import load_surface
from skincal.mesh.search import nearest_points
from skincal.mesh.surface import Surface, make_surface
from skincal.model.scene import Scene, load_scene, resource
from skincal.modules.pose import ModuleModel
from skincal.simulate.contacts import simulate_contacts, unguided
from skincal.simulate.faults import RigErrors
from skincal.simulate.resources import forearm_point, torso_point, tube
from skincal.simulate.simulated_rig import NEIGHBOURS, Rig

LAID_ON = 4_000
"""Triangles."""
_MM = 1e-3


@dataclass(frozen=True, slots=True)
class TubeShape:
    """A part as a smooth tube, and how its mesh is cut."""

    point: Callable[[FloatArray, FloatArray], FloatArray]
    low: float
    """mm, as the end below."""
    high: float
    steps: int
    """Quads along, in the mesh that ships; `turns` around."""
    turns: int
    right_handed: bool

    def mesh(self, triangles: int) -> Surface:
        """Return a mesh of about so many triangles, as many times finer along as around."""
        finer = float(np.sqrt(triangles / (2 * self.steps * self.turns)))
        turns = max(3, round(self.turns * finer))
        steps = max(1, round(triangles / (2 * turns)))
        vertices, wound = tube(self.point, self.low, self.high, steps, turns, right_handed=self.right_handed)
        return make_surface(vertices * _MM, wound)


SHAPES = {
    "icub-forearm": TubeShape(forearm_point, -2.0, 115.0, 60, 72, right_handed=False),
    "whole-body": TubeShape(torso_point, 0.0, 560.0, 200, 250, right_handed=True),
}


class _Rig(Rig):
    """A rig that finds the taxels near a tip by a search tree, in their order of distance."""

    def _near(self, points: FloatArray) -> IntArray:
        near: IntArray = self._tree.query(points, np.arange(1, min(NEIGHBOURS, len(self.places)) + 1))[1]
        return near

    def put_on(self, surface: Surface) -> None:
        """Put the taxels where `surface` is nearest to them."""
        self.surface = surface
        self.places, triangles = nearest_points(surface, self.places)
        self.normals = surface.normals[triangles]

    @cached_property
    def _tree(self) -> Any:
        spatial: Any = import_module("scipy.spatial")
        return spatial.cKDTree(self.places)


@dataclass(frozen=True, eq=False)
class Bench:
    """A scene that ships and is poked."""

    name: str = "icub-forearm"

    @cached_property
    def scene(self) -> Scene:
        """The scene that ships under this name."""
        return load_scene(resource(f"scenes/{self.name}/scene.toml"))

    @cached_property
    def surface(self) -> Surface:
        """The mesh that ships with it."""
        if self.scene.surface is None:
            raise ValueError(f"{self.name} has no surface")
        return load_surface(self.scene.surface)[0]

    @cached_property
    def rig(self) -> Rig:
        """A good rig; always the same one.

        The layout is laid on a coarser mesh and then put on the scene's: on 100,000 triangles laying alone takes 3 s.
        """
        rig = _Rig(self.scene, self.mesh(LAID_ON), RigErrors.noise(), np.random.default_rng(1))
        rig.put_on(self.surface)
        return rig

    @cached_property
    def plan(self) -> PlannedPlaces:
        """Where the layout, laid on the surface, puts the taxels."""
        layout = self.scene.skin.layout
        laid = None if layout is None else lay(layout, self.scene.skin.anchor, self.surface)
        plan = None if layout is None or laid is None else plan_from(layout, laid)
        if plan is None:
            raise ValueError(f"{self.name} has no layout that can be laid")
        return plan

    @property
    def spacing(self) -> float:
        """m, usual distance of neighbours."""
        return 0.0 if self.scene.skin.layout is None else self.scene.skin.layout.spacing

    @cached_property
    def model(self) -> ModuleModel:
        """Its modules on its mesh."""
        return self.modules_on(self.surface)

    def modules_on(self, surface: Surface) -> ModuleModel:
        """Return its modules on another mesh."""
        skin = self.scene.skin
        if skin.layout is None:
            raise ValueError(f"{self.name} has no layout")
        return ModuleModel(skin.layout, skin.anchor, surface)

    @property
    def channels(self) -> list[int]:
        """The taxels, ascending."""
        return self.rig.channels.tolist()

    def mesh(self, triangles: int | None) -> Surface:
        """Return the mesh that ships, for None, or one of the same shape with about so many triangles."""
        return self.surface if triangles is None else SHAPES[self.name].mesh(triangles)

    def contacts(self, per_taxel: int, seed: int) -> list[Contact]:
        """Poke each taxel `per_taxel` times, shared out among the arm poses."""
        rng = np.random.default_rng((seed, per_taxel))
        poses = list(self.rig.stances)
        contacts: list[Contact] = []
        first = 1
        for place, pose in enumerate(poses[:per_taxel]):
            rounds = len(range(place, per_taxel, len(poses)))
            pokes = unguided(self.rig, rounds, rng)
            contacts += simulate_contacts(self.rig, pokes, rng, pose, first)
            first += len(pokes)
        return contacts

    def errors(self, positions: dict[int, FloatArray]) -> FloatArray:
        """Return (n,) how far positions of taxels lie from the truth, metres."""
        if not positions:
            return np.empty(0)
        rows = [self.rig.row_of(channel) for channel in positions]
        return np.linalg.norm(np.array(list(positions.values())) - self.rig.places[rows], axis=1)
