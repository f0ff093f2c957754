"""The file of a mesh that a URDF names: in a ROS package, relative to the URDF, or by a whole path inside the robot's package.

The URDF comes from a stranger: a name that leaves the robot's folders is refused before the file is looked at.
"""

from __future__ import annotations

import contextlib
import os
from collections.abc import Iterable, Iterator, Mapping
from pathlib import Path, PureWindowsPath
from urllib.parse import unquote

from skincal.model.errors import InputError
from skincal.model.given import read_regular
from skincal.model.urdf import LinkMesh, Robot
from skincal.model.urdf_xml import parse_xml

PACKAGE_SCHEMES = ("package", "model")
PACKAGE_FILE = "package.xml"
"""In the folder of a ROS package; names it."""
MAX_PACKAGE_FILE_BYTES = 1 << 20
XACRO_MARKS = ("$(", "${")
"""Begin an expression that xacro replaces."""
URDF_FOLDER_ENDING = "urdf"
"""Of the folder of a robot's URDFs, such as `urdf` or `base_urdf`: its meshes are next to that folder."""


def find_mesh(robot: Robot, mesh: LinkMesh, packages: Mapping[str, Path]) -> Path:
    """Find the file of a link's mesh: `package://NAME/...`, `file:///...`, or a name relative to the URDF.

    A package is looked for in `packages`, next to the URDF, in the folders above it, in ROS_PACKAGE_PATH and in
    AMENT_PREFIX_PATH. Other names may lead to any place inside the robot's folders (`home_folders`).

    Raises InputError: there is no such file, or its name leaves the folders.
    """
    where = f"{robot.path.name}: mesh of link {mesh.link}"
    if any(mark in mesh.filename for mark in XACRO_MARKS):
        raise InputError(
            f"{where}: {mesh.filename} has an expression of xacro in it; make the URDF again (xacro FILE.xacro > robot.urdf), "
            "or name the part's mesh (--mesh FILE, or [surface])."
        )
    scheme, name = split_scheme(mesh.filename)
    if scheme and scheme not in (*PACKAGE_SCHEMES, "file"):
        raise InputError(f"{where}: is {mesh.filename}; expected package://NAME/... or a file of the robot's folder.")
    if scheme in PACKAGE_SCHEMES:
        candidates = list(_in_package(robot.path, name, packages))
    else:
        candidates = list(_in_homes(robot.path, name, is_url=bool(scheme)))
    if not candidates and scheme == "file" and _host_of(name):
        raise InputError(
            f"{where}: {mesh.filename} names the computer {_host_of(name)!r}; write file:///PATH with three slashes, or a name "
            "relative to the URDF without file:."
        )
    if not candidates:
        raise InputError(
            f"{where}: is {mesh.filename}, outside the robot's package; copy it in and correct the name, or give the part's "
            "mesh (--mesh FILE)."
        )
    for candidate in candidates:
        with contextlib.suppress(OSError):  # a name that is too long, a folder without rights
            if candidate.is_file():
                return candidate
    advice = _where_to_look(robot.path, name, packages) if scheme in PACKAGE_SCHEMES else "copy it there"
    if respelled := _find_other_spelling(candidates):
        advice = f"{respelled} is there: correct the capital letters in the URDF"
    raise InputError(f"{where}: {mesh.filename} is not found; {advice}, or name the part's mesh (--mesh FILE, or [surface]).")


def _find_other_spelling(missing: Iterable[Path]) -> str:
    """Find the name of a file that differs from a missing one in capital letters alone; empty without one."""
    for path in missing:
        with contextlib.suppress(OSError):
            for file in path.parent.iterdir():
                if file.name.lower() == path.name.lower():
                    return file.name
    return ""


def split_scheme(filename: str) -> tuple[str, str]:
    """Split `package://NAME/FILE` into the scheme and the rest; the scheme is empty for a plain name.

    A path `file:///...` begins with a slash. `package:///NAME/...` names the same as with two slashes.
    """
    scheme, separator, rest = filename.partition("://")
    if separator and scheme.isalpha():
        scheme = scheme.lower()
        return scheme, rest.lstrip("/") if scheme in PACKAGE_SCHEMES else rest
    if filename[:5].lower() == "file:":  # file:/PATH is a URL, too; file:NAME is relative
        return "file" if filename[5:6] == "/" else "", filename[5:]
    return "", filename


def _host_of(name: str) -> str:
    """Name the other computer of a `file:` URL without its scheme; empty for this one."""
    host = name.replace("\\", "/").partition("/")[0]
    return "" if host == "localhost" else host


def package_of(filename: str) -> str:
    """Name the ROS package of a mesh; empty if the name is that of a file."""
    scheme, name = split_scheme(filename)
    return Path(name).parts[0] if scheme in PACKAGE_SCHEMES and Path(name).parts else ""


def home_folders(urdf: Path) -> list[Path]:
    """List the folders that belong to a robot: that of its URDF, its ROS package, and others by their names.

    A folder that ends in `urdf` is next to `meshes`. Robots on Python's index lie in a Python package.
    """
    homes: list[Path] = []
    for file in _names_of(urdf):
        package = next((folder for folder in file.parents if (folder / PACKAGE_FILE).is_file()), None)
        above = next((folder.parent for folder in file.parents if folder.name.lower().endswith(URDF_FOLDER_ENDING)), None)
        homes += [file.parent, *(each for each in (package, above, _python_package(file)) if each is not None)]
    return [home for home in dict.fromkeys(homes) if home != Path(home.anchor)]


def _names_of(urdf: Path) -> list[Path]:
    """List the whole path of a URDF in its given form, and without links: packages may be links to their sources."""
    named = Path(os.path.normpath(Path.cwd() / urdf))
    return list(dict.fromkeys((named, urdf.resolve())))


def _python_package(file: Path) -> Path | None:
    folder = next((folder for folder in file.parents if (folder / "__init__.py").is_file()), None)
    while folder is not None and (folder.parent / "__init__.py").is_file():
        folder = folder.parent
    return folder


def _in_homes(urdf: Path, name: str, *, is_url: bool) -> Iterator[Path]:
    """Yield the places that a plain name or the path of a `file:` URL may mean, inside the robot's folders."""
    names = [name.replace("\\", "/")]
    if is_url:
        if _host_of(names[0]):
            return
        path = names[0].partition("/")[2]
        path = path if path[1:2] == ":" else f"/{path}"  # file:///C:/robot.stl
        names = list(dict.fromkeys((path, unquote(path))))
    homes = home_folders(urdf)
    for file in _names_of(urdf):
        for each in names:
            if PureWindowsPath(each).drive and not Path(each).is_absolute():  # C:/robot.stl on another system
                continue
            place = Path(os.path.normpath(file.parent / each))
            # A name below the URDF's folder is inside, also where that is the root of a disk.
            if each and (place.is_relative_to(file.parent) or any(place.is_relative_to(home) for home in homes)):
                yield place if urdf.is_absolute() or not place.is_relative_to(Path.cwd()) else place.relative_to(Path.cwd())


def _in_package(urdf: Path, name: str, packages: Mapping[str, Path]) -> Iterator[Path]:
    """Yield the places that `NAME/FILE` of a package may mean; none if it leaves the package."""
    parts = Path(name.replace("\\", "/")).parts
    if not parts or ".." in parts[:1] or Path(*parts).is_absolute() or ":" in parts[0]:
        return
    inner = Path(os.path.normpath(Path(*parts[1:])))
    if inner.parts[:1] == ("..",) or inner.is_absolute():
        return
    for folder in _package_folders(parts[0], urdf, packages):
        yield folder / inner
    yield urdf.parent / inner


def _where_to_look(urdf: Path, name: str, packages: Mapping[str, Path]) -> str:
    """Advise on a missing file of a package: copy it into the found folder, or name the folder."""
    package = Path(name).parts[0]
    for folder in _package_folders(package, urdf, packages):
        with contextlib.suppress(OSError):
            if folder.is_dir():
                return f"it is not in {folder}: copy it there"
    return f"give the folder of the package (--package {package}=FOLDER, or [robot.packages])"


def _package_folders(package: str, urdf: Path, packages: Mapping[str, Path]) -> Iterator[Path]:
    if package in packages:
        yield packages[package]
    yield urdf.parent / package
    for folder in dict.fromkeys(parent for file in _names_of(urdf) for parent in file.parents):
        if folder.name == package or _package_name(folder) == package:
            yield folder
        elif (folder / package / PACKAGE_FILE).is_file():
            yield folder / package
    for folder in os.environ.get("ROS_PACKAGE_PATH", "").split(os.pathsep):
        if folder:
            yield from (Path(folder) / package, *([Path(folder)] if Path(folder).name == package else []))
    for folder in os.environ.get("AMENT_PREFIX_PATH", "").split(os.pathsep):
        if folder:
            yield Path(folder) / "share" / package


def _package_name(folder: Path) -> str:
    """Read the name of the ROS package in a folder; empty if it is none."""
    file = folder / PACKAGE_FILE
    with contextlib.suppress(InputError, OSError):
        if file.is_file():
            name = parse_xml(read_regular(file, MAX_PACKAGE_FILE_BYTES), file).findtext("name")
            return "" if name is None else name.strip()
    return ""
