"""The files of a robot that a scene needs on another computer: its URDF, and the meshes that the URDF names."""

from __future__ import annotations

import contextlib
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

from skincal.mesh.readers import read_mesh
from skincal.model.errors import InputError, plural
from skincal.model.given import MAX_MESH_BYTES, read_regular
from skincal.model.urdf import Robot, find_mesh

ROBOT_FOLDER = "robot"
"""Below the folder of the scene."""
MAX_ROBOT_BYTES = 500 << 20
"""The meshes of a whole iCub have 12 MB."""


@dataclass(frozen=True, slots=True)
class RobotFiles:
    """Files to copy, with the names that the URDF has for them."""

    sources: Mapping[Path, Path]
    """File by its path below the copy's folder; the URDF is the first. The folders of packages are kept."""
    size: int
    """Bytes in all."""


def size_words(count: int, size: int) -> str:
    """Write a number of files and their size in bytes, such as `40 files, 11.8 MB`."""
    return f"{plural(count, 'file')}, {size / 1e6:.1f} MB"


def list_robot_files(robot: Robot, packages: Mapping[str, Path]) -> RobotFiles:
    """List the URDF and its meshes. A mesh that is missing or has a name outside the robot's folder is left out."""
    sources = {Path(robot.path.name): robot.path}
    for mesh in robot.meshes.values():
        with contextlib.suppress(InputError):
            file = find_mesh(robot, mesh, packages)
            name, separator, in_package = mesh.filename.partition("://")
            inside = Path(in_package.replace("\\", "/") if separator else name)
            sources.setdefault(inside, file)
    return RobotFiles(sources, sum(source.stat().st_size for source in sources.values()))


def read_robot_files(files: RobotFiles) -> dict[Path, bytes]:
    """Read the files, by their paths below the copy's folder. A file that is no mesh is left out: it may be a private one.

    Raises InputError: they are larger than `MAX_ROBOT_BYTES`.
    """
    if files.size > MAX_ROBOT_BYTES:
        words = size_words(len(files.sources), files.size)
        raise InputError(
            f"The robot has {words}; expected at most {MAX_ROBOT_BYTES >> 20} MB for a copy: "
            "save without it (--reference, or the box on the last step of the window)."
        )
    (urdf, source), *meshes = files.sources.items()
    copies = {urdf: read_regular(source, MAX_MESH_BYTES)}
    for inside, file in meshes:
        with contextlib.suppress(InputError):
            data = read_regular(file, MAX_MESH_BYTES, what="mesh file")
            read_mesh(file, data)
            copies[inside] = data
    return copies


def is_with_robot(urdf: Path, folder: Path) -> bool:
    """Whether a scene's folder is moved together with the robot: one holds the other, or both are in one ROS package."""
    file, where = urdf.resolve(), folder.resolve()
    homes = (file.parent, *(parent for parent in file.parents if (parent / "package.xml").is_file()))
    return file.is_relative_to(where) or any(where.is_relative_to(home) for home in homes)
