"""Make the scenes that ship with skincal: text, layouts and surfaces, the same at every run.

`python -m skincal.simulate.benches FOLDER` writes `FOLDER/scenes/...`. The shapes are this project's own; only facts
of the reference robot enter: the forearm's box in its wrist frame, the modules' ids, places and angles (icub-main
`right_forearm.ini`), the v1 chain (iKinFwd.cpp, iDynInv.cpp) and Table I of the paper.

Scenes that ship as they are poked: their mesh, plan and modules, a good rig, and meshes of their parts of any size.

The rig has the noise of its sensors and no other error (`RigErrors.noise`), and is poked by somebody careful, unguided: what is
left of the error is the solver's and the noise's. Taxels lie on the mesh of the scene; the same contacts are solved on finer
and coarser meshes of the same shape as well, whose error includes what a coarse mesh costs.
"""

from __future__ import annotations

import sys
from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from importlib import import_module
from pathlib import Path
from typing import Any

import numpy as np

from skincal.contacts.outcome import Contact
from skincal.geometry import FloatArray, IntArray
from skincal.guide.knowledge import PlannedPlaces, plan_from
from skincal.mesh.lay import lay
from skincal.mesh.load import load_surface
from skincal.mesh.search import nearest_points
from skincal.mesh.surface import Surface, make_surface
from skincal.model.scene import Scene, load_scene, resource
from skincal.modules.pose import ModuleModel
from skincal.simulate.contacts import simulate_contacts, unguided
from skincal.simulate.faults import RigErrors
from skincal.simulate.simulated_rig import NEIGHBOURS, Rig

# id: (x mm, y mm, angle deg) in the plane of the layout; first channel 12 id.
FOREARM_MODULES: dict[int, tuple[float, float, float]] = {
    17: (12, 37, -180), 28: (28, 28, -120), 29: (28, 9, -180), 24: (44, 0, -120), 25: (60, 9, -60),
    26: (60, 28, 0), 21: (76, 37, -60),
}  # fmt: skip

FOREARM_SCENE = """\
# The forearm of the paper (Del Prete et al., IROS 2011): 84 taxels in 7 modules, the v1 chain, Table I as arm poses.
name = "icub-right-forearm-v1"
link = "r_forearm_dh_frame"

[skin]
channels = 384
polarity = "down"
range = [0, 255]
modules = "modules.toml"

[skin.anchor]                          # the middle of the patch lies on the ridge of the forearm, x across it
at_mm = [44.0, 20.0]
point_mm = {point}
x = [1.0, 0.0, 0.0]
normal = {normal}

[surface]
mesh = "forearm.obj"
unit = "mm"

[arm]
joints = [3, 4]
dh = [[0.015, 0.0, 90.0, 0.0], [0.0, -0.1373, 90.0, -90.0]]
base_from_sensor = [[-1, 0, 0, 0], [0, 0, 1, -0.08428], [0, 1, 0, 0], [0, 0, 0, 1]]

[arm.poses]                            # Table I: j3, j4 in degrees; 1, 4 and 5 differ only in the shoulder, so in weight
1 = [94, 0]
2 = [15, -90]
3 = [35, -40]
4 = [94, 0]
5 = [94, 0]
6 = [45, 0]
7 = [94, -90]

[contacts]
# m. A sensor whose matrix is wrong by 2 % gives single pokes a pitch of 9 mm rms, and of 25 mm to one in a hundred; the
# default of 8 mm, for a good sensor, would reject four in ten. A second touch shows here as taxels far apart that answer.
pitch_max = 0.025

# Screw heads of the cover, around the skin: known points, from which the rig's own errors are told.
[[landmarks]]
name = "elbow, outer"
place = [0.0252, 0.0132, -0.0039]
normal = [0.990, -0.135, -0.037]

[[landmarks]]
name = "side, inner"
place = [-0.0296, 0.0590, 0.0000]
normal = [-0.991, -0.071, 0.110]

[[landmarks]]
name = "wrist, top"
place = [0.0027, 0.0881, 0.0319]
normal = [0.154, -0.032, 0.987]

[[landmarks]]
name = "side, outer"
place = [0.0299, 0.0602, -0.0021]
normal = [0.997, -0.072, 0.037]

[[landmarks]]
name = "elbow, inner"
place = [-0.0250, 0.0123, -0.0049]
normal = [-0.990, -0.135, -0.037]

[[landmarks]]
name = "elbow, top"
place = [0.0000, 0.0047, 0.0249]
normal = [0.051, -0.135, 0.989]
"""

FLAT_SCENE = """\
# A flat patch on a plate above a table-mounted sensor: no arm, no surface; 12-bit values that rise under pressure.
name = "flat-patch"
link = "patch"                         # origin in the middle of the patch, z out of it

[skin]
channels = 64
polarity = "up"
range = [0, 4095]
modules = "modules.toml"

[skin.anchor]
at_mm = [0.0, 0.0]
point_mm = [0.0, 0.0, 0.0]
x = [1.0, 0.0, 0.0]
normal = [0.0, 0.0, 1.0]

[sensor]                               # 45 mm below the patch, its axes parallel to the patch's
pose = [[1, 0, 0, 0], [0, 1, 0, 0], [0, 0, 1, -0.045], [0, 0, 0, 1]]

[contacts]
response_min = 160.0                   # 10 of 255, in 12 bits

[noise]
radius = 1.0                           # m; the plate is flat
"""

FLAT_PITCH_MM = 6.0
FLAT_SIDE = 4

TORSO_SCENE = """\
# Whole-body size, for load: 4,200 taxels in 350 modules on a surface of 100,000 triangles; the sensor is at the waist.
name = "whole-body"
link = "torso"                         # origin in the middle of the waist, z up, x to the left, y to the back

[skin]
channels = 4200
polarity = "down"
range = [0, 255]
modules = "modules.toml"

[surface]
mesh = "torso.ply"
unit = "mm"

[sensor]
pose = [[1, 0, 0, 0], [0, 1, 0, 0], [0, 0, 1, -0.06], [0, 0, 0, 1]]

[noise]
radius = 0.12                          # m; of the torso under the skin, at its roundest
"""

TORSO_ROWS, TORSO_COLUMNS = 14, 25
TORSO_PITCH_MM = 36.0
"""Distance of modules in the plane of the layout; on the torso they are 33 to 42 mm apart."""

Ring = Callable[[FloatArray, FloatArray], FloatArray]
"""(height, angle) to (..., 3) points, mm: one turn around the tube at each height."""


def forearm_point(y: FloatArray, angle: FloatArray) -> FloatArray:
    """Return points of the forearm's shell, mm, wrist frame: an elliptic tube that widens towards the elbow (y up).

    Parameters
    ----------
    y : (...) float, mm, -2 to 115
    angle : (...) float, radians from x to z; pi/2 is the ridge
    """
    s = (y + 2.0) / 117.0
    wide = s * (2.0 - s)
    half, top, bottom = 23.0 + 9.0 * wide, 24.0 + 8.5 * wide, -30.0 - 13.5 * wide
    centre, height = (top + bottom) / 2, (top - bottom) / 2
    return np.stack([half * np.cos(angle), y + 0.0 * angle, centre + height * np.sin(angle)], axis=-1)


def torso_point(z: FloatArray, angle: FloatArray) -> FloatArray:
    """Return points of the torso's shell, mm: an elliptic tube, narrow at the waist and wide at the chest.

    Parameters
    ----------
    z : (...) float, mm, 0 to 560
    angle : (...) float, radians from x to y
    """
    wide = np.sin(np.pi * z / 900.0) ** 2
    return np.stack([(152.0 + 38.0 * wide) * np.cos(angle), (108.0 + 22.0 * wide) * np.sin(angle), z + 0.0 * angle], axis=-1)


def tube(ring: Ring, low: float, high: float, steps: int, turns: int, *, right_handed: bool) -> tuple[FloatArray, IntArray]:
    """Return vertices (mm) and outward triangles of a tube that is open at both ends.

    Parameters
    ----------
    ring : the shape
    low, high : mm, ends of the tube
    steps, turns : quads along and around
    right_handed : angle grows counterclockwise seen from the high end
    """
    heights = np.linspace(low, high, steps + 1)
    angles = 2 * np.pi * np.arange(turns) / turns
    vertices = ring(*np.meshgrid(heights, angles, indexing="ij")).reshape(-1, 3)
    row, column = np.meshgrid(np.arange(steps), np.arange(turns), indexing="ij")
    a = (row * turns + column).ravel()
    b = (row * turns + (column + 1) % turns).ravel()
    lower = np.stack([a, b, b + turns], axis=1)
    upper = np.stack([a, b + turns, a + turns], axis=1)
    triangles = np.stack([lower, upper], axis=1).reshape(-1, 3)
    return vertices, triangles if right_handed else triangles[:, ::-1].copy()


def frame_on(ring: Ring, height: float, angle: float) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return a point of a tube (mm), the unit direction in which the angle grows, and the outward unit normal."""
    step = 1e-4
    point = ring(np.array(height), np.array(angle))
    along = ring(np.array(height + step), np.array(angle)) - ring(np.array(height - step), np.array(angle))
    around = ring(np.array(height), np.array(angle + step)) - ring(np.array(height), np.array(angle - step))
    normal = np.cross(around, along)
    outward = np.sign(normal @ (point - ring(np.array(height), np.array(angle + np.pi))))
    return point, around / np.linalg.norm(around), outward * normal / np.linalg.norm(normal)


def _list(values: FloatArray, digits: int) -> str:
    return "[" + ", ".join(f"{v + 0.0:.{digits}f}" for v in np.round(values, digits)) + "]"


def _write_obj(path: Path, vertices: FloatArray, triangles: IntArray, title: str) -> None:
    lines = [f"# {title}; mm"]
    lines += [f"v {x:.3f} {y:.3f} {z:.3f}" for x, y, z in vertices]
    lines += [f"f {a} {b} {c}" for a, b, c in triangles + 1]
    path.write_text("\n".join(lines) + "\n", encoding="utf-8", newline="\n")


def _write_ply(path: Path, vertices: FloatArray, triangles: IntArray) -> None:
    header = (
        "ply\nformat binary_little_endian 1.0\ncomment torso of skincal's whole-body scene, mm\n"
        f"element vertex {len(vertices)}\nproperty float x\nproperty float y\nproperty float z\n"
        f"element face {len(triangles)}\nproperty list uchar int vertex_indices\nend_header\n"
    )
    faces = np.empty(len(triangles), dtype=[("n", "u1"), ("v", "<i4", (3,))])
    faces["n"], faces["v"] = 3, triangles
    path.write_bytes(header.encode("ascii") + vertices.astype("<f4").tobytes() + faces.tobytes())


def write_forearm(folder: Path) -> None:
    """Write the paper's forearm."""
    folder.mkdir(parents=True, exist_ok=True)
    vertices, triangles = tube(forearm_point, -2.0, 115.0, 60, 72, right_handed=False)
    _write_obj(folder / "forearm.obj", vertices, triangles, "a smooth forearm, wrist frame, open at both ends")
    point, _, normal = frame_on(forearm_point, 40.0, np.pi / 2)
    text = FOREARM_SCENE.format(point=_list(point, 3), normal=_list(normal, 6))
    (folder / "scene.toml").write_text(text, encoding="utf-8", newline="\n")
    lines = ["# The seven modules of the paper; places and angles of icub-main's right_forearm.ini, V1 skin."]
    for number, (x, y, angle) in FOREARM_MODULES.items():
        lines += ["", "[[modules]]", f"id = {number}", 'kind = "triangle_12"', f"first_channel = {12 * number}"]
        lines += [f"place_mm = [{x}, {y}]", f"angle_deg = {angle}", "mirror = false"]
    (folder / "modules.toml").write_text("\n".join(lines) + "\n", encoding="utf-8", newline="\n")


def write_flat_patch(folder: Path) -> None:
    """Write the flat patch: four square boards of 16 taxels."""
    folder.mkdir(parents=True, exist_ok=True)
    (folder / "scene.toml").write_text(FLAT_SCENE, encoding="utf-8", newline="\n")
    ticks = (np.arange(FLAT_SIDE) - (FLAT_SIDE - 1) / 2) * FLAT_PITCH_MM
    half = FLAT_SIDE * FLAT_PITCH_MM / 2
    pads = ", ".join(f"[{x}, {y}]" for y in ticks for x in ticks)
    lines = ["# Four square boards, 24 mm wide, side by side: 64 taxels 6 mm apart.", "[kinds.square_16]"]
    corners = f"[{-half}, {-half}], [{half}, {-half}], [{half}, {half}], [{-half}, {half}]"
    lines += [f"pads_mm = [{pads}]", f"outline_mm = [{corners}]", "centre_pad = 5"]
    for number, (x, y) in enumerate([(-half, -half), (half, -half), (-half, half), (half, half)], start=1):
        lines += ["", "[[modules]]", f"id = {number}", 'kind = "square_16"', f"first_channel = {16 * (number - 1)}"]
        lines += [f"place_mm = [{x}, {y}]"]
    (folder / "modules.toml").write_text("\n".join(lines) + "\n", encoding="utf-8", newline="\n")


def _torso_angles(z: float) -> FloatArray:
    """Return the angles that divide the ring at height z into equal arcs, one a column, anticlockwise from x."""
    fine = np.linspace(0.0, 2 * np.pi, 20_001)
    points = torso_point(np.full_like(fine, z), fine)
    length: FloatArray = np.append(0.0, np.cumsum(np.linalg.norm(np.diff(points, axis=0), axis=1)))
    wanted = np.linspace(0.0, float(length[-1]), TORSO_COLUMNS, endpoint=False)
    return np.asarray(np.interp(wanted, length, fine), dtype=np.float64)


def write_whole_body(folder: Path) -> None:
    """Write the whole-body-sized scene: each module has its own anchor."""
    folder.mkdir(parents=True, exist_ok=True)
    (folder / "scene.toml").write_text(TORSO_SCENE, encoding="utf-8", newline="\n")
    _write_ply(folder / "torso.ply", *tube(torso_point, 0.0, 560.0, 200, 250, right_handed=True))
    lines = ["# 14 rows of 25 triangles around the torso, each with its own anchor."]
    for row in range(TORSO_ROWS):
        z = 30.0 + 38.0 * row
        for column, angle in enumerate(_torso_angles(z)):
            number = row * TORSO_COLUMNS + column
            place = f"[{TORSO_PITCH_MM * column}, {TORSO_PITCH_MM * row}]"
            point, x, normal = frame_on(torso_point, z, float(angle))
            lines += ["", "[[modules]]", f"id = {number}", 'kind = "triangle_12"', f"first_channel = {12 * number}"]
            lines += [f"place_mm = {place}", f"angle_deg = {180 * ((row + column) % 2)}"]
            on_part = f"point_mm = {_list(point, 3)}, x = {_list(x, 6)}, normal = {_list(normal, 6)}"
            lines += [f"anchor = {{at_mm = {place}, {on_part}}}"]
    (folder / "modules.toml").write_text("\n".join(lines) + "\n", encoding="utf-8", newline="\n")


def write_scenes(folder: Path) -> None:
    """Write every scene below `folder`."""
    write_forearm(folder / "icub-forearm")
    write_flat_patch(folder / "flat-patch")
    write_whole_body(folder / "whole-body")


if __name__ == "__main__":
    write_scenes(Path(sys.argv[1]) / "scenes")


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
