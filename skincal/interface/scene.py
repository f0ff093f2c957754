"""The part to calibrate, as a script uses it: its scene file, its mesh and its layout."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, TypedDict, Unpack

import numpy as np

from skincal.files.layout_sources import parse_grid, read_layout_file
from skincal.interface.taxels import Taxels, taxels_at
from skincal.model.errors import InputError
from skincal.model.scene import scene_file
from skincal.part.part import Part, load_part
from skincal.part.part_draft import PartDraft
from skincal.session.solving import methods_of

if TYPE_CHECKING:
    from skincal.geometry import IntArray


class PartEntries(TypedDict, total=False):
    """Keywords of `Scene.from_mesh` and `Scene.from_urdf`; each has the default that its description names."""

    layout: str | Path
    """Layout file, or a grid such as `"6x8@9mm"`; without a layout there is no modules method."""
    channels: int
    """Values of a skin frame; those of the layout."""
    anchor: Sequence[float]
    """(3,) metres, link frame: position of the layout's middle; the middle of the largest face away from the sensor."""
    polarity: str
    """`"up"` if values rise under pressure, which is the default, or `"down"`."""
    sign: int
    """-1 if the sensor reports the reaction force; what the URDF says, or 1."""
    unit: str
    """Of the mesh: `m`, `cm`, `mm` or `in`; the one that the file names, or `mm`."""
    joints: Sequence[str]
    """Columns of the joint stream, by joint name; none."""
    fixed: Mapping[str, float]
    """Angle of each joint that is not streamed, rad; none."""
    packages: Mapping[str, str | Path]
    """Folder of each ROS package that the URDF names; none."""
    copy: bool
    """Copy the robot's files to the folder of the scene, which is the default; otherwise the scene refers to them."""


@dataclass(frozen=True, eq=False)
class Scene:
    """A part with its scene file, mesh and layout. Make one with `load`, `from_mesh` or `from_urdf`."""

    part: Part
    """As the program's own functions use it."""

    @classmethod
    def load(cls, path: str | Path) -> Scene:
        """Load a scene file, or a scene that ships with skincal, such as `"icub-forearm"`.

        Raises
        ------
        InputError
            The file, its mesh or its layout cannot be used.
        """
        return cls(load_part(scene_file(Path(path))))

    @classmethod
    def from_mesh(cls, out: str | Path, mesh: str | Path, *, link: str = "part", **entries: Unpack[PartEntries]) -> Scene:
        """Write the scene file of a part that has a mesh, and load it. The sensor is at the origin of the link.

        Parameters
        ----------
        out
            Scene file to write (`*.toml`).
        mesh
            File of the part.
        link
            Name of the link: the frame of every position.
        **entries
            `layout`, `channels`, `anchor`, `polarity`, `sign` and `unit` of `PartEntries`.

        Raises
        ------
        InputError
            A file cannot be read or written, `out` exists, or an entry is unknown.
        """
        return _write(Path(out), PartDraft(mesh=Path(mesh), link=link, unit=""), entries)

    @classmethod
    def from_urdf(cls, out: str | Path, urdf: str | Path, *, link: str, sensor: str, **entries: Unpack[PartEntries]) -> Scene:
        """Write the scene file of a robot's link, and load it.

        Parameters
        ----------
        out
            Scene file to write (`*.toml`).
        urdf
            File of the robot; the part's mesh is that of the link.
        link
            Link of the part: the frame of every position.
        sensor
            Force/torque sensor of the URDF, or a joint or link at it.
        **entries
            See `PartEntries`.

        Raises
        ------
        InputError
            As for `from_mesh`; also if the URDF lacks the link, the sensor or a joint.
        """
        return _write(Path(out), PartDraft(urdf=Path(urdf), link=link, sensor=sensor, unit=""), entries)

    @property
    def path(self) -> Path:
        """The scene file."""
        return self.part.scene.path

    @property
    def link(self) -> str:
        """Name of the link: the frame of every position."""
        return self.part.scene.link

    @property
    def channels(self) -> int:
        """Number of values of a skin frame."""
        return self.part.scene.skin.channels

    @property
    def wrench_sign(self) -> int:
        """-1 if the sensor reports the reaction force, else 1."""
        return self.part.scene.wrench_sign

    @property
    def polarity(self) -> int:
        """-1 if the skin's values fall under pressure, else 1."""
        return self.part.scene.skin.polarity

    @property
    def taxel_channels(self) -> IntArray:
        """(n,) channels that can be taxels: those of the layout, or all."""
        return self.part.channels

    @property
    def methods(self) -> tuple[str, ...]:
        """Methods that the scene allows: `free`, `surface` with a mesh, `modules` with a layout."""
        return tuple(method.value for method in methods_of(self.part.scene, self.part.surface))

    @property
    def findings(self) -> tuple[str, ...]:
        """Sentences about the mesh and the layout on it."""
        return self.part.findings

    @property
    def plan(self) -> Taxels | None:
        """Planned positions of the taxels on the part; `None` if the scene does not place its layout."""
        return None if self.part.plan is None else taxels_at(self.part.plan, self.link)

    def __repr__(self) -> str:
        """Describe the part in a line."""
        surface = "no mesh" if self.part.surface is None else f"a mesh of {len(self.part.surface.triangles)} triangles"
        return f"Scene({self.part.scene.name}: {len(self.taxel_channels)} taxels, {surface}, link {self.link!r})"


def _write(out: Path, draft: PartDraft, entries: PartEntries) -> Scene:
    """Complete a draft with the entries, and write it as a scene."""
    from skincal.part.scene_draft import write_scene  # it loads readers of meshes

    if unknown := sorted(entries.keys() - PartEntries.__annotations__.keys()):
        raise InputError(f"{unknown[0]}: is no entry of a part; expected one of {', '.join(PartEntries.__annotations__)}.")
    anchor = entries.get("anchor")
    if anchor is not None and np.shape(anchor) != (3,):
        raise InputError(f"anchor: has the shape {np.shape(anchor)}; expected three numbers, metres.")
    draft = replace(
        draft,
        unit=entries.get("unit", ""),
        joints=tuple(entries.get("joints", ())),
        fixed=tuple((name, float(np.degrees(angle))) for name, angle in entries.get("fixed", {}).items()),
        packages=tuple((name, Path(folder)) for name, folder in entries.get("packages", {}).items()),
        copies_robot=entries.get("copy", True),
        sign=entries.get("sign"),
        channels=entries.get("channels"),
        polarity=entries.get("polarity", "up"),
        layout_text=_layout_text(entries.get("layout", "")),
    )
    write_scene(draft, out, None if anchor is None else np.array(anchor, dtype=float) * 1e3)
    return Scene.load(out)


def _layout_text(layout: str | Path) -> str:
    if not layout:
        return ""
    if "@" in str(layout) and not Path(layout).exists():
        return parse_grid(str(layout)).layout_text()
    return read_layout_file(Path(layout))
