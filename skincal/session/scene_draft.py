"""A new scene, from a URDF or a mesh: the values that a person gives, and the scene file that follows from them."""

from __future__ import annotations

import json
import math
import os
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from skincal.geometry import FloatArray
from skincal.model.errors import InputError
from skincal.model.scene import Scene, load_scene
from skincal.model.skin import load_layout
from skincal.model.urdf import MOVING, Robot, UrdfChain, read_urdf

if TYPE_CHECKING:
    from skincal.mesh.surface import Surface

MAX_GRID_SIDE = 300
LAYOUT_FILE = "modules.toml"


@dataclass(frozen=True, slots=True)
class Grid:
    """Taxels in rows and columns, as one module."""

    rows: int
    columns: int
    pitch_mm: float

    def layout_text(self) -> str:
        """Write the grid as a layout file; its origin is the middle, channels run along x."""
        x, y = ((np.arange(count) - (count - 1) / 2.0) * self.pitch_mm for count in (self.columns, self.rows))
        pads = [[float(a), float(b)] for b in y for a in x]
        half = [(count / 2.0) * self.pitch_mm for count in (self.columns, self.rows)]
        outline = [[sx * half[0], sy * half[1]] for sx, sy in ((-1, -1), (1, -1), (1, 1), (-1, 1))]
        middle = (self.rows // 2) * self.columns + self.columns // 2
        return (
            f"# {self.rows} x {self.columns} taxels, {self.pitch_mm:g} mm apart; channel = {self.columns} x row + column\n"
            f"[kinds.grid]\npads_mm = {pads}\noutline_mm = {outline}\ncentre_pad = {middle}\n\n"
            '[[modules]]\nid = 1\nkind = "grid"\nfirst_channel = 0\nplace_mm = [0.0, 0.0]\n'
        )


def parse_grid(text: str) -> Grid:
    """Parse a grid such as `6x8@9mm`: rows, columns, pitch.

    Raises InputError: it is written in another way.
    """
    size, _, pitch = text.replace(" ", "").partition("@")
    try:
        rows, columns = (int(word) for word in size.split("x"))
        spacing = float(pitch.removesuffix("mm"))
    except ValueError:
        rows, columns, spacing = 0, 0, 0.0
    if not (1 <= rows <= MAX_GRID_SIDE and 1 <= columns <= MAX_GRID_SIDE and 0.1 <= spacing <= 1000.0):
        raise InputError(f"{text}: is no grid; expected ROWSxCOLUMNS@PITCHmm, such as 6x8@9mm.")
    return Grid(rows, columns, spacing)


@dataclass(frozen=True, slots=True, eq=False)
class SceneDraft:
    """What a person says of a part and its skin."""

    out: Path
    """The scene file to write."""
    urdf: Path | None = None
    link: str = "part"
    sensor: str = ""
    """Force/torque sensor, joint or link of the URDF."""
    joints: Sequence[str] = ()
    """Columns of the joint stream; empty for the joints of the chain, from sensor to part."""
    fixed_deg: Mapping[str, float] = field(default_factory=dict[str, float])
    """Degrees, of joints of the chain that are not streamed."""
    packages: Mapping[str, Path] = field(default_factory=dict[str, Path])
    mesh: Path | None = None
    """In place of the file that the URDF names."""
    sign: int | None = None
    """-1 if the sensor reports the reaction force; `None` for what the URDF says."""
    unit: str = "mm"
    channels: int | None = None
    """`None` for those of the layout."""
    polarity: str = "up"
    layout: Path | None = None
    grid: Grid | None = None
    anchor_mm: FloatArray | None = None
    """(3,) float, mm, link frame: position of the layout's middle; `None` for the farthest point along the link's z axis."""


def write_scene(draft: SceneDraft) -> Scene:
    """Write the scene file of a draft, and its layout file for a grid; return the scene as it reads.

    Raises InputError: a file cannot be read or written, a file is there already, or a name is not in the URDF.
    """
    if draft.urdf is None and draft.mesh is None:
        raise InputError(f"{draft.out}: name the robot's URDF (--urdf) or the part's mesh (--mesh).")
    if draft.urdf is not None and not draft.sensor:
        raise InputError(f"{draft.urdf}: name the force/torque sensor (--sensor); {_list_sensors(read_urdf(draft.urdf))}.")
    layout_file = draft.out.parent / LAYOUT_FILE
    for path in (draft.out, *([layout_file] if draft.grid else [])):
        if path.exists():
            raise InputError(f"{path}: is there already; name another file, or move it away.")
    try:
        draft.out.parent.mkdir(parents=True, exist_ok=True)
        if draft.grid is not None:
            layout_file.write_text(draft.grid.layout_text(), encoding="utf-8")
        draft.out.write_text(_scene_text(draft, ""), encoding="utf-8")
        anchor = _anchor_text(draft, load_scene(draft.out))
        draft.out.write_text(_scene_text(draft, anchor), encoding="utf-8")
        return load_scene(draft.out)
    except (InputError, OSError) as error:
        for path in (draft.out, *([layout_file] if draft.grid else [])):
            path.unlink(missing_ok=True)
        if isinstance(error, OSError):
            raise InputError(f"{error.filename}: cannot be written ({error.strerror}); choose another folder.") from None
        raise


def _scene_text(draft: SceneDraft, anchor: str) -> str:
    folder = draft.out.parent
    lines = [
        "# Written by `skincal scene new`; docs/scene.md says what else a scene can hold.",
        f"name = {_quoted(draft.out.resolve().parent.name or draft.link)}",
        f"link = {_quoted(draft.link)}{'':24}# the frame of every position",
    ]
    if draft.urdf is not None:
        lines += ["", *_robot_lines(draft, draft.urdf, folder)]
    if draft.mesh is not None and draft.urdf is None:
        lines += [
            "", "[surface]", f"mesh = {_named(draft.mesh, folder)}", f"unit = {_quoted(draft.unit)}", "",
            "# [sensor]                     # pose of the force/torque sensor in the link, metres; now they have one frame",
            "# pose = [[1, 0, 0, 0], [0, 1, 0, 0], [0, 0, 1, -0.05], [0, 0, 0, 1]]",
        ]  # fmt: skip
    lines += ["", "[skin]", f"channels = {_channels(draft)}", f"polarity = {_quoted(draft.polarity)}"]
    if draft.grid is not None or draft.layout is not None:
        lines.append(f"modules = {_quoted(LAYOUT_FILE) if draft.layout is None else _named(draft.layout, folder)}")
    return "\n".join(lines) + f"\n{anchor}"


def _robot_lines(draft: SceneDraft, urdf: Path, folder: Path) -> list[str]:
    robot = read_urdf(urdf)
    fixed = {name: math.radians(degrees) for name, degrees in draft.fixed_deg.items()}
    every = [each.name for each in robot.joints.values() if each.kind in MOVING and not each.mimics and each.name not in fixed]
    chain, _ = robot.chain(draft.link, draft.sensor, every, fixed, str(urdf))
    names = list(draft.joints) or joints_in_order(chain)
    _, sign = robot.chain(draft.link, draft.sensor, names, fixed, str(urdf))
    lines = ["[robot]", f"urdf = {_named(urdf, folder)}", f"sensor = {_quoted(draft.sensor)}"]
    if draft.mesh is not None:
        lines.append(f"mesh = {_named(draft.mesh, folder)}")
    if names:
        lines.append(f"joints = {json.dumps(names, ensure_ascii=False)}{'':8}# columns of the joint stream")
        lines += ["# [robot.poses]                # named arm poses, degrees, for an arm that does not stream its joints"]
        lines.append(f"# middle = {_middle_pose(robot, names)}")
    if fixed:
        lines.append("[robot.fixed]                  # joints that are not streamed, degrees")
        lines += [f"{_quoted(name)} = {degrees!r}" for name, degrees in draft.fixed_deg.items()]
    if draft.packages:
        lines.append("[robot.packages]")
        lines += [f"{_quoted(name)} = {_named(path, folder)}" for name, path in draft.packages.items()]
    if draft.sign is not None or sign is None:
        why = "given" if draft.sign is not None else "the URDF does not say; -1 if the sensor reports the reaction force"
        lines += ["", "[wrench]", f"sign = {draft.sign or 1}{'':23}# {why}"]
    return lines


def joints_in_order(chain: UrdfChain) -> list[str]:
    """List the moving joints from the sensor to the part."""
    moving = {joint.name for joint in chain.moving}
    return [joint.name for joint, _, _ in reversed(chain.steps) if joint.name in moving]


def _middle_pose(robot: Robot, names: Sequence[str]) -> list[float]:
    """Choose whole degrees in the middle of the limits, or 0."""
    limits = [robot.joints[name].limits if name in robot.joints else None for name in names]
    return [0.0 if pair is None else float(round(math.degrees(pair[0] + pair[1]) / 2.0)) for pair in limits]


def _channels(draft: SceneDraft) -> int:
    if draft.channels is not None:
        return draft.channels
    if draft.grid is not None:
        return draft.grid.rows * draft.grid.columns
    if draft.layout is not None:
        return int(load_layout(draft.layout, 100_000).channels.max()) + 1
    raise InputError(f"{draft.out}: say how many values a frame of the skin has (--channels), or name its layout.")


def _anchor_text(draft: SceneDraft, scene: Scene) -> str:
    """Write `[skin.anchor]`: the middle of the layout at the given point, or at the farthest one along the link's z axis."""
    from skincal.session.part import load_scene_surface

    surface, _ = load_scene_surface(scene)
    layout = scene.skin.layout
    if layout is None or (surface is None and draft.anchor_mm is None):
        return ""
    point, normal = _anchor_on(surface, draft.anchor_mm)
    x = np.cross([0.0, 1.0, 0.0], normal)
    if np.linalg.norm(x) < 0.1:
        x = np.cross([0.0, 0.0, 1.0], normal)
    x /= np.linalg.norm(x)
    at = np.nanmean(layout.places, axis=0) * 1e3
    why = "given" if draft.anchor_mm is not None else "the mesh point farthest out along the link's z axis: move it"
    values = {"at_mm": at.round(3), "point_mm": (point * 1e3).round(3), "x": x.round(6), "normal": normal.round(6)}
    rows = [f"{key} = {(value + 0.0).tolist()}" for key, value in values.items()]
    return f"\n[skin.anchor]                  # position of the layout: {why}\n" + "\n".join(rows) + "\n"


def _anchor_on(surface: Surface | None, point_mm: FloatArray | None) -> tuple[FloatArray, FloatArray]:
    """Find the point (3,), m, and the outward normal (3,) of the mesh there."""
    if surface is None:
        assert point_mm is not None
        return point_mm * 1e-3, np.array([0.0, 0.0, 1.0])
    middles = surface.vertices[surface.triangles].mean(axis=1)
    if point_mm is None:
        highest = int(surface.vertices[:, 2].argmax())
        around = np.flatnonzero((surface.triangles == highest).any(axis=1))
        triangle = int(around[surface.normals[around, 2].argmax()])
        return middles[triangle], surface.normals[triangle]
    point = point_mm * 1e-3
    return point, surface.normals[int(np.linalg.norm(middles - point, axis=1).argmin())]


def _list_sensors(robot: Robot) -> str:
    names = [sensor.name for sensor in robot.sensors]
    return f"it has {', '.join(names)}" if names else "it has none: name a joint or a link at the sensor"


def _quoted(text: str) -> str:
    return json.dumps(text, ensure_ascii=False)


def _named(path: Path, folder: Path) -> str:
    """Quote a file's name, relative to the scene's folder if that is on the same drive."""
    try:
        return _quoted(Path(os.path.relpath(path.resolve(), folder.resolve())).as_posix())
    except ValueError:
        return _quoted(path.resolve().as_posix())
