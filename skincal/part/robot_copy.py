"""The files of a robot that a scene needs on another computer: its URDF, and the meshes that the URDF names."""

from __future__ import annotations

import contextlib
import os
import re
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from xml.sax.saxutils import quoteattr, unescape

from skincal.mesh.readers import read_mesh
from skincal.model.errors import InputError, plural
from skincal.model.given import MAX_MESH_BYTES, read_regular
from skincal.model.mesh_lookup import PACKAGE_SCHEMES, find_mesh, home_folders, split_scheme
from skincal.model.urdf import Robot

_FILENAME_RE = re.compile(rb"""(filename\s*=\s*)["']((?<=")[^"]*(?=")|(?<=')[^']*(?='))["']""")
OTHER_MESHES_FOLDER = Path("other")
"""Of meshes in a copy whose place is taken by another mesh."""
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
    renamed: Mapping[str, str]
    """Name of a mesh in the copy of the URDF, by its name in the URDF, where they differ."""


def size_words(count: int, size: int) -> str:
    """Write a number of files and their size in bytes, such as `40 files, 11.8 MB`."""
    return f"{plural(count, 'file')}, {size / 1e6:.1f} MB"


def list_robot_files(robot: Robot, packages: Mapping[str, Path]) -> RobotFiles:
    """List the URDF and its meshes. A mesh that is missing or has a name outside the robot's package is left out.

    A mesh of a package, or below the folder of the URDF, keeps its name. Another one, such as `../meshes/part.stl` or
    `file:///...`, gets one below the copy's folder.
    """
    sources, renamed = {Path(robot.path.name): robot.path}, dict[str, str]()
    for mesh in robot.meshes.values():
        with contextlib.suppress(InputError):
            file = find_mesh(robot, mesh, packages)
            inside, keeps_name = _place_in_copy(robot.path, mesh.filename, file)
            while sources.setdefault(inside, file).resolve() != file.resolve():
                inside, keeps_name = OTHER_MESHES_FOLDER / inside, False
            if not keeps_name:
                renamed[mesh.filename] = inside.as_posix()
    return RobotFiles(sources, sum(source.stat().st_size for source in sources.values()), renamed)


def _place_in_copy(urdf: Path, filename: str, file: Path) -> tuple[Path, bool]:
    """Choose the path of a mesh below the copy's folder, and whether the URDF's name for it leads there."""
    scheme, name = split_scheme(filename)
    if scheme in PACKAGE_SCHEMES:
        package, *inner = Path(name.replace("\\", "/")).parts
        return Path(package, os.path.normpath(Path(*inner))), True
    whole = Path(os.path.normpath(Path.cwd() / file))
    folder = Path(os.path.normpath(Path.cwd() / urdf)).parent
    if not scheme and whole.is_relative_to(folder) and not Path(name).is_absolute():
        return whole.relative_to(folder), True
    inside = [whole.relative_to(home) for home in home_folders(urdf) if whole.is_relative_to(home)]
    return min(inside, key=lambda path: len(path.parts), default=Path(whole.name)), False


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
    copies = {urdf: _with_names(read_regular(source, MAX_MESH_BYTES), files.renamed)}
    for inside, file in meshes:
        with contextlib.suppress(InputError):
            data = read_regular(file, MAX_MESH_BYTES, what="mesh file")
            read_mesh(file, data)
            copies[inside] = data
    return copies


def _with_names(urdf: bytes, renamed: Mapping[str, str]) -> bytes:
    """Replace names of meshes in the text of a URDF; all else stays as it was."""

    def rename(match: re.Match[bytes]) -> bytes:
        name = unescape(match[2].decode("utf-8", "replace"), {"&quot;": '"', "&apos;": "'"}).strip()
        if name not in renamed:
            return match[0]
        return match[1] + quoteattr(renamed[name]).encode("ascii", "xmlcharrefreplace")

    return _FILENAME_RE.sub(rename, urdf)


def is_with_robot(urdf: Path, folder: Path) -> bool:
    """Whether a scene's folder is moved together with the robot: one holds the other, or both are in one ROS package."""
    file, where = urdf.resolve(), folder.resolve()
    homes = (file.parent, *(parent for parent in file.parents if (parent / "package.xml").is_file()))
    return file.is_relative_to(where) or any(where.is_relative_to(home) for home in homes)
