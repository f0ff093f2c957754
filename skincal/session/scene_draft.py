"""A new scene by one command: the values that a person gives, and the scene file that follows from them.

The window's page for parts makes the same file step by step (`part_draft.py`).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np

from skincal.files.layout_sources import Grid, read_layout_file
from skincal.geometry import FloatArray
from skincal.mesh.lay import ANCHOR_TO_SURFACE_MAX_M
from skincal.mesh.surface import Surface
from skincal.model.errors import InputError
from skincal.model.scene import Scene, load_scene
from skincal.model.urdf import Robot, read_urdf
from skincal.session.draft_preview import PartPreview, PartPreviewer, completed_draft
from skincal.session.layout_placing import anchor_at
from skincal.session.part_draft import AnchorDraft, PartDraft, save_draft

FARTHEST_POINT = "position of the layout: the mesh point farthest out along the link's z axis; move it"
UNKNOWN_SIGN = "the URDF does not say; -1 if the sensor reports the reaction force"


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
    copies_robot: bool = True
    """Copy the robot's files into the folder of the scene, unless they are moved together anyway."""
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
    """Write the scene file of a draft, and its layout file; return the scene as it reads.

    Raises InputError: a file cannot be read or written, a file is there already, or a name is not in the URDF.
    """
    if draft.urdf is None and draft.mesh is None:
        raise InputError(f"{draft.out}: name the robot's URDF (--urdf) or the part's mesh (--mesh).")
    if draft.urdf is not None:
        robot = read_urdf(draft.urdf)
        if not draft.sensor:
            raise InputError(f"{draft.urdf}: name the force/torque sensor (--sensor); {_list_sensors(robot)}.")
        robot.require_link(draft.link, str(draft.urdf))
    preview = PartPreviewer().preview(_described(draft), {})
    part, comments = completed_draft(preview), dict[tuple[str, ...], str]()
    if preview.layout is not None and (preview.surface is not None or draft.anchor_mm is not None):
        part = replace(part, anchor=_anchor(preview, draft.anchor_mm))
        if draft.anchor_mm is None:
            comments["skin", "anchor"] = FARTHEST_POINT
    if draft.urdf is not None and part.sign is None and preview.sign is None:
        part = replace(part, sign=1)
        comments["wrench", "sign"] = UNKNOWN_SIGN
    save_draft(part, draft.out, comments)
    return load_scene(draft.out)


def _described(draft: SceneDraft) -> PartDraft:
    layout = "" if draft.grid is None else draft.grid.layout_text()
    if draft.layout is not None:
        layout = read_layout_file(draft.layout)
    if not layout and draft.channels is None:
        raise InputError(f"{draft.out}: say how many values a frame of the skin has (--channels), or name its layout.")
    return PartDraft(
        name=draft.out.resolve().parent.name or draft.link,
        link=draft.link,
        urdf=draft.urdf,
        sensor=draft.sensor,
        joints=tuple(draft.joints),
        fixed=tuple(draft.fixed_deg.items()),
        packages=tuple(draft.packages.items()),
        copies_robot=draft.copies_robot,
        mesh=draft.mesh,
        unit=draft.unit,
        sign=draft.sign,
        channels=draft.channels,
        polarity=draft.polarity,
        layout_text=layout,
    )


def _anchor(preview: PartPreview, point_mm: FloatArray | None) -> AnchorDraft:
    """Place the layout's middle at a point, (3,) mm, or at the farthest one along the link's z axis."""
    surface, layout = preview.surface, preview.layout
    assert layout is not None
    if point_mm is None:
        assert surface is not None
        point = _farthest_point(surface)
    else:
        point = point_mm * 1e-3
    anchor = anchor_at(surface, layout, point, None)
    gap = float(np.linalg.norm(anchor.point - point))
    if gap > ANCHOR_TO_SURFACE_MAX_M:
        most = ANCHOR_TO_SURFACE_MAX_M * 1e3
        raise InputError(
            f"--anchor-mm is {gap * 1e3:.1f} mm from the mesh; at most {most:.0f} mm was expected: check point, frame and "
            "the mesh's unit."
        )
    return AnchorDraft.from_anchor(anchor)


def _farthest_point(surface: Surface) -> FloatArray:
    """Find the middle of the triangle at the highest vertex that faces up most, (3,) metres."""
    highest = int(surface.vertices[:, 2].argmax())
    around = np.flatnonzero((surface.triangles == highest).any(axis=1))
    triangle = int(around[surface.normals[around, 2].argmax()])
    return surface.vertices[surface.triangles[triangle]].mean(axis=0)


def _list_sensors(robot: Robot) -> str:
    names = [sensor.name for sensor in robot.sensors]
    return f"it has {', '.join(names)}" if names else "it has none: name a joint or a link at the sensor"
