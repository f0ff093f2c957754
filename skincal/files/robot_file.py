"""A robot's own file (URDF, SDF) with the taxels in it: every other byte stays unchanged.

The taxels are put before the end tag of `<robot>`, or of the `<model>` that has the calibrated link. Before the file is
written, robot and result are read again and compared: masses and joints must be the same, and every new name must be there.

Sources: wiki.ros.org/urdf/XML; sdformat.org/spec (frames with `attached_to` since 1.7; names of a model's children differ).
"""

from __future__ import annotations

import difflib
import re
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from xml.etree import ElementTree as ET
from xml.parsers import expat

from skincal.model.errors import InputError, plural
from skincal.model.given import read_regular
from skincal.model.urdf import MAX_URDF_BYTES
from skincal.model.urdf_xml import parse_xml

_XACRO_EXPRESSION_RE = re.compile(r"\$[({][^)}]*[)}]")
_INCLUDE_SENTENCE = (
    ' Links and names of models that it includes with merge="true" are in other files, which are not compared: a name '
    "that is there, too, is refused by Gazebo (choose another prefix, --prefix)."
)
SDF_MIN_VERSION = (1, 7)
"""Older ones have no frames that are attached to a link."""


@dataclass(frozen=True, slots=True)
class _RobotContent:
    """Masses, joints and names of a robot's file."""

    masses: dict[str, str]
    """Text of the mass by the link's name (in SDF with the model's before it); links without one are left out."""
    moving: tuple[tuple[str, str], ...]
    """Name and type of each joint that is not fixed, in the order of the file."""
    names: tuple[str, ...]
    """Of all links, joints, frames and sensors."""
    relative_meshes: int
    """Meshes whose file is named from the robot's folder."""
    links: int
    """Links that have a mass in other programs, stated or not."""
    has_merged: bool
    """Whether a model takes over the links of another file (`<include merge="true">`)."""

    @property
    def mass(self) -> float | None:
        """Sum of the masses, kg; `None` if one is no number."""
        try:
            return sum(map(float, self.masses.values()))
        except ValueError:
            return None


def insert_into_robot(path: Path, tag: str, link: str, elements: Sequence[ET.Element]) -> bytes:
    """Return the robot's file with elements added to the robot, or to the model that has `link`.

    Parameters
    ----------
    tag : of the robot's document: `robot` (URDF) or `sdf`

    Raises
    ------
    InputError
        The file cannot be read, is no such document, lacks the link, or has one of the names already.
    """
    data, root = _read_robot(path, tag)
    holder = _holder(root, link, path)
    _require_new_names(holder, elements, path)
    number = next(index for index, each in enumerate(root.iter(holder.tag)) if each is holder)
    end = _end_tag_at(data, holder.tag, number)
    newline = "\r\n" if b"\r\n" in data else "\n"
    # Character references hold in every encoding that has ASCII.
    added = (_indented(elements) + "\n").replace("\n", newline).encode("ascii", "xmlcharrefreplace")
    before = data[:end].rstrip(b" \t")
    gap = b"" if before.endswith(b"\n") else newline.encode()
    return before + gap + added + data[len(before) : end] + data[end:]


def check_robot(path: Path, content: bytes, names: Sequence[str], what: str) -> str:
    """Check a robot's file with taxels against the robot alone; return the sentence on it.

    Parameters
    ----------
    path, content : the robot's own file; the one with taxels
    names : each must be new, and there once
    what : was added, such as "84 taxels are"

    Raises
    ------
    RuntimeError
        Masses or joints have changed, or a name is missing: a fault of the program.
    """
    before = _content(parse_xml(read_regular(path, MAX_URDF_BYTES), path))
    after = _content(parse_xml(content, path))
    added_names, lost_names = Counter(after.names) - Counter(before.names), Counter(before.names) - Counter(after.names)
    kept = {link: mass for link, mass in after.masses.items() if link in before.masses}
    wrong = [name for name in names if added_names[name] != 1] + list(lost_names)
    if wrong or after.moving != before.moving or kept != before.masses:
        raise RuntimeError(f"{path}: the file with taxels differs from the robot; names {wrong[:3]}")
    mass, more = before.mass, after.mass
    weighed = _weighed(before, mass)
    added = 0.0 if mass is None or more is None else more - mass
    heavier = f" (the taxels have {added * 1e6:.3g} mg)" if len(after.masses) > len(before.masses) else ""
    return (
        f"{what} added to {path.name}: {weighed} and {plural(len(before.moving), 'moving joint')} are unchanged{heavier}, "
        f"every name is found.{_INCLUDE_SENTENCE if before.has_merged else ''}"
    )


def _weighed(robot: _RobotContent, mass: float | None) -> str:
    """Name the masses that were compared: of the links that state one."""
    if not robot.masses:
        return "its links, which state no mass,"
    if mass is None:
        return "its masses"
    stated = f" of {len(robot.masses)} of its {robot.links} links" if len(robot.masses) < robot.links else ""
    return f"the mass of {mass:.6g} kg{stated}"


def mesh_sentences(out: Path, into: Path) -> list[str]:
    """Return a warning if meshes are not found from the folder of `out`."""
    here, there = out.resolve().parent, into.resolve().parent
    count = _content(parse_xml(read_regular(into, MAX_URDF_BYTES), into)).relative_meshes
    if here == there or not count:
        return []
    return [
        f"{into.name} names {plural(count, 'file')} of meshes from its own folder: programs find them only if {out.name} is "
        f"there, in {there}."
    ]


def require_other_file(out: Path, into: Path) -> None:
    """Raise InputError if the robot's own file would be replaced."""
    if out.exists() and into.exists() and out.samefile(into):
        raise InputError(
            f"{out}: is the robot's own file, which stays unchanged; choose another name for the file with taxels."
        )


def _read_robot(path: Path, tag: str) -> tuple[bytes, ET.Element]:
    what, other = ("URDF", "sdf") if tag == "robot" else ("SDF", "urdf or tactile-urdf")
    data = read_regular(path, MAX_URDF_BYTES, what=f"{what} file", advice=f"name the robot's {what} file")
    if b"\0" in data:
        raise InputError(f"{path}: is not UTF-8 text; save it as UTF-8.")
    root = parse_xml(data, path)
    if root.tag != tag:
        advice = f"; choose the format {other}" if root.tag in ("robot", "sdf") else ""
        raise InputError(f"{path}: begins with <{root.tag}>; expected <{tag}>, a robot's {what}{advice}.")
    if leftover := _xacro_leftover(root):
        raise InputError(
            f"{path}: is a xacro file (it has {leftover}); make a URDF of it first: xacro {path.name} > robot.urdf."
        )
    return data, root


def _xacro_leftover(root: ET.Element) -> str:
    """Find an element or an expression of xacro, which programs would read as a name; empty without."""
    attributes = [pair for element in root.iter() for pair in element.attrib.items()]
    prefixes = {name.partition(":")[2] for name, value in attributes if name.startswith("xmlns:") and "xacro" in value}
    for element in root.iter():
        prefix, colon, _ = element.tag.partition(":")
        if colon and prefix in (prefixes | {"xacro"}):
            return f"<{element.tag}>"
    texts = [value for _, value in attributes] + [element.text or "" for element in root.iter()]
    return next((text.strip()[:60] for text in texts if _XACRO_EXPRESSION_RE.search(text)), "")


def _holder(root: ET.Element, link: str, path: Path) -> ET.Element:
    """Find the element that gets the taxels: the robot, or the one model with the link."""
    models = [root] if root.tag == "robot" else list(root.iter("model"))
    holders = [model for model in models if any(each.get("name") == link for each in model.findall("link"))]
    if not holders:
        known = [each.get("name", "") for model in models for each in model.findall("link")]
        near = difflib.get_close_matches(link, known, 3, 0.5) or known[:3]
        advice = f"the nearest are {', '.join(near)}" if near else "it has none at all"
        if any(model.find("include") is not None for model in models):
            advice += ". Links of an included model are in that model's file: add the taxels there"
        raise InputError(f"{path}: has no link {link!r}, on which the taxels are; {advice}. Choose the robot of this part.")
    if len(holders) > 1:
        named = ", ".join(each.get("name", "?") for each in holders[:3])
        raise InputError(
            f"{path}: {len(holders)} models have a link {link!r} ({named}); expected one. Write the model's own file."
        )
    count = sum(each.get("name") == link for each in holders[0].findall("link"))
    if count > 1:
        raise InputError(f"{path}: has the link {link!r} {count} times, so that no program loads it; leave out the others.")
    if root.tag == "sdf":
        version = root.get("version", "")
        found = re.fullmatch(r"(\d{1,3})\.(\d{1,3})", version)
        if found is None or (int(found[1]), int(found[2])) < SDF_MIN_VERSION:
            raise InputError(
                f"{path}: is SDF {version or 'without a version'}; frames on links need 1.7 or newer. Convert it first: "
                f"gz sdf -p {path.name} > robot.sdf (in Fortress: ign sdf -p)."
            )
    return holders[0]


def _require_new_names(holder: ET.Element, elements: Sequence[ET.Element], path: Path) -> None:
    taken = set(_names(holder))
    clashes = [name for each in elements if (name := each.get("name")) is not None and name in taken]
    if clashes:
        more = f" and {len(clashes) - 1} more of the names" if len(clashes) > 1 else ""
        raise InputError(
            f"{path}: has {clashes[0]}{more} of the taxels already. Choose the robot's file without this skin, or another "
            "prefix for the names (--prefix)."
        )


def _names(holder: ET.Element) -> list[str]:
    """List the names that must differ from new ones: of a robot or a model, and of frames that Gazebo adds to a robot."""
    children = [*holder, *(child for gazebo in holder.findall("gazebo") for child in gazebo)]
    included = [name for each in holder.findall("include") if (name := each.findtext("name")) is not None]
    return [name for each in children if (name := each.get("name")) is not None and each.tag != "material"] + included


def _end_tag_at(data: bytes, tag: str, number: int) -> int:
    """Find the byte at which the end tag of the `number`th element of a tag begins, in the order of start tags."""
    open_elements: list[int] = []
    found: list[int] = []
    started = 0
    parser = expat.ParserCreate()

    def start(name: str, _attributes: dict[str, str]) -> None:
        nonlocal started
        if name == tag:
            open_elements.append(started)
            started += 1

    def end(name: str) -> None:
        if name == tag and open_elements.pop() == number:
            found.append(parser.CurrentByteIndex)

    parser.StartElementHandler, parser.EndElementHandler = start, end
    parser.Parse(data, True)
    return found[0]


def _indented(elements: Sequence[ET.Element]) -> str:
    """Write elements as children of a document's root."""
    parent = ET.Element("parent")
    parent.extend(elements)
    ET.indent(parent)
    lines = ET.tostring(parent, encoding="unicode").splitlines()
    return "\n".join(lines[1:-1])


def _content(root: ET.Element) -> _RobotContent:
    masses: dict[str, str] = {}
    moving: list[tuple[str, str]] = []
    names: list[str] = []
    for holder in [root] if root.tag == "robot" else root.iter("model"):
        model = "" if root.tag == "robot" else f"{holder.get('name', '')}::"
        for link in holder.findall("link"):
            mass = link.find("inertial/mass")
            if mass is not None:
                masses[model + link.get("name", "")] = (mass.get("value") or mass.text or "").strip()
        moving += [
            (model + joint.get("name", ""), joint.get("type", ""))
            for joint in holder.findall("joint")
            if joint.get("type") != "fixed"
        ]
        names += _names(holder)
    # In SDF a link without a mass has 1 kg, in URDF none.
    links = len(masses) if root.tag == "robot" else sum(len(holder.findall("link")) for holder in root.iter("model"))
    merged = any(each.get("merge", "").lower() in ("true", "1") for each in root.iter("include"))
    meshes = [each.get("filename", "") for tag in ("mesh", "texture") for each in root.iter(tag)]
    meshes += [each.text or "" for each in root.iter("uri")]
    relative = [name for each in meshes if (name := each.strip()) and "://" not in name and not name.startswith("/")]
    return _RobotContent(masses, tuple(moving), tuple(names), len(relative), links, merged)
