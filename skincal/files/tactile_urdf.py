"""Taxels as a tactile sensor of a robot's URDF, in the extension of tactile_toolbox; written, and read as known positions.

    <sensor name type="tactile">
        <parent link/><origin/><tactile channel><taxel idx xyz rpy><geometry/></taxel>...</tactile>
    </sensor>

The z axis of a taxel is its normal, or all axes are those of its readings (`frames.py`); `idx` is its place in the data of the
channel (`tactile_msgs/TactileState`). The sensor's origin is that of the link, since its composition with a taxel's pose
differs between versions of the reader. That reader needs no `type`; iDynTree reports an error for a sensor without.

Source: github.com/ubi-agni/tactile_toolbox, `urdf_tactile/README.md` and `urdf_tactile/src/parser.cpp`.
"""

from __future__ import annotations

from pathlib import Path
from typing import NamedTuple
from xml.etree import ElementTree as ET

from skincal.files.calibration import Calibration, placed_taxels
from skincal.files.frames import (
    add_comment,
    begin_document,
    document_comments,
    document_text,
    named_poses,
    number_words,
    skin_name,
    taxel_radius,
    xml_name,
)
from skincal.files.robot_file import insert_into_robot
from skincal.geometry import FloatArray
from skincal.model.errors import InputError
from skincal.model.given import read_regular
from skincal.model.urdf import MAX_URDF_BYTES
from skincal.model.urdf_xml import element_pose, parse_xml
from skincal.taxels.result import Method

DRAWN_TAXEL_HEIGHT_M = 0.001
"""m, of the drawn taxels."""


def tactile_urdf_text(calibration: Calibration, method: Method) -> str | bytes:
    """Return URDF with one `<sensor>`: the robot's file with it (option `into`), or a robot of the calibrated link alone."""
    link = xml_name(calibration.scene.link)
    sensor = _sensor(calibration, method)
    if calibration.options.into is not None:
        return insert_into_robot(calibration.options.into, "robot", link, [*document_comments(calibration, method), sensor])
    root = begin_document("robot", {"name": xml_name(calibration.scene.name)}, calibration, method)
    add_comment(root, f"for a whole robot: paste the <sensor> into its URDF, which has the link {link}")
    ET.SubElement(root, "link", name=link)
    root.append(sensor)
    return document_text(root)


def _sensor(calibration: Calibration, method: Method) -> ET.Element:
    taxels, name = placed_taxels(calibration.estimates_by(method)), skin_name(calibration)
    sensor = ET.Element("sensor", name=name, type="tactile")
    ET.SubElement(sensor, "parent", link=xml_name(calibration.scene.link))
    ET.SubElement(sensor, "origin", xyz="0 0 0", rpy="0 0 0")
    tactile = ET.SubElement(sensor, "tactile", channel=name)
    size = {"radius": f"{taxel_radius(calibration):.9g}", "length": f"{DRAWN_TAXEL_HEIGHT_M:g}"}
    for channel, (_, position, angles) in zip(taxels.channels.tolist(), named_poses(calibration, taxels, method), strict=True):
        taxel = ET.SubElement(tactile, "taxel", idx=str(channel), xyz=number_words(position), rpy=number_words(angles))
        ET.SubElement(ET.SubElement(taxel, "geometry"), "cylinder", size)
    return sensor


class TactileSensor(NamedTuple):
    """A tactile sensor of a URDF."""

    name: str
    link: str
    places: dict[int, FloatArray]
    """Channel (`idx`) to (3,) float, metres, in the link."""


def read_tactile_sensors(path: Path) -> list[TactileSensor]:
    """Read the tactile sensors of a URDF that list their taxels, at least one.

    Raises InputError: the file cannot be read, or it has no tactile sensor with a list of taxels.
    """
    root = parse_xml(read_regular(path, MAX_URDF_BYTES), path)
    found: list[TactileSensor] = []
    for sensor in root.iter("sensor"):
        parent, tactile = sensor.find("parent"), sensor.find("tactile")
        if tactile is None or tactile.find("taxel") is None:
            continue
        name = sensor.get("name", "")
        where = f"{path}: sensor {name}"
        if parent is None or not parent.get("link"):
            raise InputError(f"{where}: has no <parent link>; expected the link that its positions are in.")
        pose = element_pose(sensor.find("origin"), where)
        places = {_index(taxel, where): pose @ element_pose(_pose_alone(taxel), where) for taxel in tactile.findall("taxel")}
        found.append(TactileSensor(name, parent.get("link", ""), {channel: taxel[:3, 3] for channel, taxel in places.items()}))
    if not found:
        raise InputError(f"{path}: has no tactile sensor; expected a URDF with <sensor><tactile><taxel idx xyz rpy>.")
    return found


def _pose_alone(taxel: ET.Element) -> ET.Element:
    """Return a taxel without its `idx`: a pose knows no other attributes than its own."""
    return ET.Element(taxel.tag, {name: text for name, text in taxel.attrib.items() if name != "idx"})


def _index(taxel: ET.Element, where: str) -> int:
    text = taxel.get("idx", "")
    if not text.isascii() or not text.isdigit() or len(text) > 9:
        raise InputError(f"{where}: idx of a taxel is {text[:20]!r}; expected its channel, a whole number.")
    return int(text)
