"""The part to calibrate, as a script uses it: its scene file, its mesh and its layout."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from skincal.files.layout_sources import parse_grid, read_layout_file
from skincal.interface.taxels import Taxels, taxels_at
from skincal.model.errors import InputError
from skincal.model.scene import scene_file
from skincal.part.mesh_units import unit_without_option
from skincal.part.part import Part, load_part
from skincal.part.part_draft import PartDraft
from skincal.part.scene_draft import write_scene
from skincal.session.solving import methods_of

if TYPE_CHECKING:
    from skincal.geometry import IntArray


@dataclass(frozen=True, eq=False)
class Scene:
    """A part with its scene file, mesh and layout. Make one with `load`, `from_mesh` or `from_urdf`."""

    part: Part
    """As the program's own functions use it."""

    @classmethod
    def load(cls, path: str | Path) -> Scene:
        """Load a scene file, or a scene that ships with skincal, such as `"icub-forearm"`.

        Raises InputError: the file, its mesh or its layout cannot be used.
        """
        return cls(load_part(scene_file(Path(path))))

    @classmethod
    def from_mesh(
        cls,
        out: str | Path,
        mesh: str | Path,
        *,
        unit: str = "",
        link: str = "part",
        layout: str | Path = "",
        channels: int | None = None,
        anchor: Sequence[float] | None = None,
        polarity: str = "up",
    ) -> Scene:
        """Write the scene file of a part that has a mesh, and load it. The sensor is at the origin of the link.

        Parameters
        ----------
        out : scene file to write (`*.toml`)
        mesh : file of the part
        unit : of the mesh: m, cm, mm or in; empty for mm, or the unit that the file itself names
        link : name of the link: the frame of every position
        layout : layout file, or a grid such as `"6x8@9mm"`; empty without a layout
        channels : values of a skin frame; `None` for those of the layout
        anchor : (3,) metres, link frame: position of the layout's middle; `None` for the highest place
        polarity : `"up"` if values rise under pressure, else `"down"`

        Raises
        ------
        InputError
            A file cannot be read or written, or `out` exists.
        """
        path = Path(mesh)
        draft = PartDraft(
            link=link,
            mesh=path,
            unit=unit or unit_without_option(path),
            channels=channels,
            polarity=polarity,
            layout_text=_layout_text(layout),
        )
        return _write(draft, Path(out), anchor)

    @classmethod
    def from_urdf(
        cls,
        out: str | Path,
        urdf: str | Path,
        *,
        link: str,
        sensor: str,
        joints: Sequence[str] = (),
        fixed: Mapping[str, float] | None = None,
        packages: Mapping[str, str | Path] | None = None,
        copy: bool = True,
        layout: str | Path = "",
        channels: int | None = None,
        anchor: Sequence[float] | None = None,
        polarity: str = "up",
    ) -> Scene:
        """Write the scene file of a robot's link, and load it.

        Parameters
        ----------
        sensor : force/torque sensor of the URDF, or a joint or link at it
        joints : columns of the joint stream, by joint name
        fixed : angle of each joint that is not streamed, rad
        packages : folder of each ROS package that the URDF names
        copy : copy the robot's files to the folder of `out`; otherwise the scene refers to them
        out, layout, channels, anchor, polarity : as for `from_mesh`

        Raises
        ------
        InputError
            As for `from_mesh`; also if the URDF lacks the link, the sensor or a joint.
        """
        draft = PartDraft(
            urdf=Path(urdf),
            link=link,
            sensor=sensor,
            joints=tuple(joints),
            fixed=tuple((name, float(np.degrees(angle))) for name, angle in (fixed or {}).items()),
            packages=tuple((name, Path(folder)) for name, folder in (packages or {}).items()),
            copies_robot=copy,
            unit="",
            channels=channels,
            polarity=polarity,
            layout_text=_layout_text(layout),
        )
        return _write(draft, Path(out), anchor)

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


def _layout_text(layout: str | Path) -> str:
    if not layout:
        return ""
    if "@" in str(layout) and not Path(layout).exists():
        return parse_grid(str(layout)).layout_text()
    return read_layout_file(Path(layout))


def _write(draft: PartDraft, out: Path, anchor: Sequence[float] | None) -> Scene:
    if anchor is not None and np.shape(anchor) != (3,):
        raise InputError(f"anchor: has the shape {np.shape(anchor)}; expected three numbers, metres.")
    write_scene(draft, out, None if anchor is None else np.array(anchor, dtype=float) * 1e3)
    return Scene.load(out)
