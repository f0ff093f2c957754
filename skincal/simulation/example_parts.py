"""Shipped scenes with mesh, plan, modules and a rig for studies and tests, and meshes of their shapes in any resolution.

The rig has sensor noise and no other error (`RigErrors.noise`). Taxels lie on the scene's mesh; on another mesh of the shape,
errors include its discretization.

The shapes are this project's own. From the reference robot come the forearm's bounding box and, in the scene file, the modules'
ids, positions and angles (icub-main `right_forearm.ini`), the v1 chain (iKinFwd.cpp, iDynInv.cpp) and Table I of the paper.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cache, cached_property

import numpy as np

from skincal.contacts.outcome import Contact
from skincal.geometry import FloatArray
from skincal.guide.believed_positions import PlannedPlaces, plan_from_layout
from skincal.mesh.lay import place_layout
from skincal.mesh.load import load_surface
from skincal.mesh.search import nearest_points
from skincal.mesh.surface import Surface, make_surface
from skincal.model.scene import Scene, load_scene, resource
from skincal.model.skin import Layout
from skincal.modules.pose import ModuleModel
from skincal.simulation.contacts import simulate_contacts, unguided
from skincal.simulation.rig_errors import RigErrors
from skincal.simulation.simulated_rig import Rig

MESH_TRIANGLES_FOR_LAYING_LAYOUT = 4_000
"""Size of the mesh for laying the layout: on 100,000 triangles it takes 3 s."""


def forearm_point(y: FloatArray, angle: FloatArray) -> FloatArray:
    """Return points of the forearm's shell, mm, wrist frame: an elliptic tube, wider at the elbow (large y).

    y is -2 to 115 mm; the angle goes from x to z, pi/2 is the ridge.
    """
    # `0.0 * angle` broadcasts the height.
    s = (y + 2.0) / 117.0
    wide = s * (2.0 - s)
    half, top, bottom = 23.0 + 9.0 * wide, 24.0 + 8.5 * wide, -30.0 - 13.5 * wide
    centre, height = (top + bottom) / 2, (top - bottom) / 2
    return np.stack([half * np.cos(angle), y + 0.0 * angle, centre + height * np.sin(angle)], axis=-1)


def torso_point(z: FloatArray, angle: FloatArray) -> FloatArray:
    """Return points of the torso's shell, mm: an elliptic tube, narrow at the waist and wide at the chest.

    z is 0 to 560 mm; the angle goes from x to y.
    """
    wide = np.sin(np.pi * z / 900.0) ** 2
    return np.stack([(152.0 + 38.0 * wide) * np.cos(angle), (108.0 + 22.0 * wide) * np.sin(angle), z + 0.0 * angle], axis=-1)


@dataclass(frozen=True, slots=True)
class TubeShape:
    """A smooth tube with open ends, and the grid of its shipped mesh."""

    point: Callable[[FloatArray, FloatArray], FloatArray]
    """Point (..., 3), mm, at a height, mm, and an angle, radians."""
    low: float
    """mm, height of the lower end; `high` of the upper one."""
    high: float
    steps: int
    """Quads along the tube in the shipped mesh; `turns` around it."""
    turns: int
    right_handed: bool
    """The angle is counterclockwise seen from the high end."""

    def mesh(self, triangles: int) -> Surface:
        """Make a mesh of about `triangles` outward triangles, with the shipped mesh's proportions."""
        finer = float(np.sqrt(triangles / (2 * self.steps * self.turns)))
        turns = max(3, round(self.turns * finer))
        steps = max(1, round(triangles / (2 * turns)))
        heights = np.linspace(self.low, self.high, steps + 1)
        angles = 2 * np.pi * np.arange(turns) / turns
        vertices = self.point(*np.meshgrid(heights, angles, indexing="ij")).reshape(-1, 3)
        row, column = np.meshgrid(np.arange(steps), np.arange(turns), indexing="ij")
        a = (row * turns + column).ravel()
        b = (row * turns + (column + 1) % turns).ravel()
        quads = np.stack([a, b, b + turns, a, b + turns, a + turns], axis=1).reshape(-1, 3)
        return make_surface(vertices * 1e-3, quads if self.right_handed else quads[:, ::-1].copy())


SHAPE_OF_PART = {
    "icub-forearm": TubeShape(forearm_point, -2.0, 115.0, 60, 72, right_handed=False),
    "whole-body": TubeShape(torso_point, 0.0, 560.0, 200, 250, right_handed=True),
}


class _Rig(Rig):
    """A rig whose taxels can be moved to another surface."""

    def move_taxels_to(self, surface: Surface) -> None:
        """Move the taxels to the nearest points of `surface`."""
        self.surface = surface
        self.places, triangles = nearest_points(surface, self.places)
        self.normals = surface.normals[triangles]


@dataclass(frozen=True, eq=False)
class ExamplePart:
    """A shipped scene with its mesh, plan and rig."""

    name: str = "icub-forearm"

    @cached_property
    def scene(self) -> Scene:
        return load_scene(resource(f"scenes/{self.name}/scene.toml"))

    @cached_property
    def surface(self) -> Surface:
        assert self.scene.surface is not None, "an example part has a mesh"
        return load_surface(self.scene.surface)[0]

    @property
    def layout(self) -> Layout:
        assert self.scene.skin.layout is not None, "an example part has a layout"
        return self.scene.skin.layout

    @cached_property
    def rig(self) -> Rig:
        """A rig with sensor noise only, always the same."""
        rig = _Rig(self.scene, self.mesh(MESH_TRIANGLES_FOR_LAYING_LAYOUT), RigErrors.noise(), np.random.default_rng(1))
        rig.move_taxels_to(self.surface)
        return rig

    @cached_property
    def plan(self) -> PlannedPlaces:
        """Planned positions: the layout laid on the surface."""
        laid = place_layout(self.layout, self.scene.skin.anchor, self.surface)
        plan = None if laid is None else plan_from_layout(self.layout, laid)
        assert plan is not None, "shipped layouts can be laid"
        return plan

    @property
    def spacing(self) -> float:
        """m, typical distance of neighbouring taxels."""
        return self.layout.spacing

    @cached_property
    def model(self) -> ModuleModel:
        return self.modules_on(self.surface)

    def modules_on(self, surface: Surface) -> ModuleModel:
        return ModuleModel(self.layout, self.scene.skin.anchor, surface)

    @property
    def channels(self) -> list[int]:
        return self.rig.channels.tolist()

    def mesh(self, triangles: int | None) -> Surface:
        """Return the shipped mesh, or one of the same shape with about `triangles` triangles."""
        return self.surface if triangles is None else SHAPE_OF_PART[self.name].mesh(triangles)

    def contacts(self, per_taxel: int, seed: int) -> list[Contact]:
        """Poke each taxel `per_taxel` times, in the arm poses in turn."""
        rng = np.random.default_rng((seed, per_taxel))
        poses = list(self.rig.arm_poses)
        contacts: list[Contact] = []
        first = 1
        for place, pose in enumerate(poses[:per_taxel]):
            rounds = len(range(place, per_taxel, len(poses)))
            pokes = unguided(self.rig, rounds, rng)
            contacts += simulate_contacts(self.rig, pokes, rng, pose, first)
            first += len(pokes)
        return contacts

    def errors(self, positions: dict[int, FloatArray]) -> FloatArray:
        """Return the errors (n,) of taxel positions, metres."""
        if not positions:
            return np.empty(0)
        rows = [self.rig.row_of(channel) for channel in positions]
        return np.linalg.norm(np.array(list(positions.values())) - self.rig.places[rows], axis=1)


@cache
def forearm() -> ExamplePart:
    """Load the shipped forearm, once in a process: it takes 0.2 s."""
    return ExamplePart()
