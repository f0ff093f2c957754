"""Elements of a URDF as XML: parsing without entities, attributes, numbers and poses.

Sources: the URDF's XML reference (wiki.ros.org/urdf/XML); `quat_xyzw` of URDF 1.1 (github.com/ros/urdfdom); `<pose>` of
SDFormat (sdformat.org/spec).
"""

from __future__ import annotations

from pathlib import Path
from xml.etree import ElementTree
from xml.parsers import expat

import numpy as np

from skincal.geometry import FloatArray, rotation_of_quaternion
from skincal.model.errors import InputError, plural

URDF_MAX_LENGTH_M = 100.0
UNIT_QUATERNION_MAX_LENGTH_ERROR = 1e-2
"""A quaternion written with three digits misses the length 1 by a thousandth."""
IDENTITY_QUATERNION = "0 0 0 1"


def parse_xml(data: bytes, path: Path) -> ElementTree.Element:
    """Parse XML without namespaces: URDFs of other programs use prefixes, such as `drake:`, that no one declares.

    Raises InputError: it is not XML, or has a document type.
    """

    def refuse_doctype(*_: object) -> None:
        raise InputError(f"{path}: has a document type (<!DOCTYPE); remove it: a URDF needs none.")

    parser, builder = expat.ParserCreate(), ElementTree.TreeBuilder()
    parser.StartDoctypeDeclHandler = refuse_doctype
    parser.StartElementHandler, parser.EndElementHandler = builder.start, builder.end
    parser.CharacterDataHandler = builder.data
    try:
        parser.Parse(data, True)
    except (expat.ExpatError, ValueError, LookupError) as error:
        raise InputError(f"{path}: not an XML file ({error}); expected a URDF.") from None
    return builder.close()


def read_attribute(element: ElementTree.Element, name: str, path: Path) -> str:
    """Read an attribute that must be there. Raises InputError: it is missing or empty."""
    value = element.get(name, "")
    if not value:
        raise InputError(f"{path}: a <{element.tag}> has no {name}; expected one.")
    return value


def read_numbers(text: str, count: int, where: str) -> FloatArray:
    """Read `count` finite numbers. Raises InputError: there are more or fewer, or other words."""
    try:
        values = np.array([float(word) for word in text.split()[: count + 1]])
    except ValueError:
        values = np.empty(0)
    if len(values) != count or not np.isfinite(values).all():
        raise InputError(f"{where}: is {text[:60]!r}; expected {plural(count, 'finite number')}.")
    return values


def read_origin(element: ElementTree.Element, where: str) -> FloatArray:
    """Read the `<origin>` of an element as a (4, 4) pose, metres; the identity without one."""
    return element_pose(element.find("origin"), f"{where}: origin")


def element_pose(element: ElementTree.Element | None, where: str) -> FloatArray:
    """Read the attributes `xyz` and `rpy` as a (4, 4) pose: roll, pitch and yaw about the fixed axes x, y and z.

    `quat_xyzw` may replace `rpy`. Without an element it is the identity.

    Raises InputError: they are not three numbers each, or of no robot's size, or there are other attributes.
    """
    if element is None:
        return np.eye(4)
    refuse_attributes(element, ("xyz", "rpy", "quat_xyzw"), where)
    xyz = read_numbers(element.get("xyz", "0 0 0"), 3, f"{where} xyz")
    if "quat_xyzw" not in element.keys():  # noqa: SIM118 - an element of XML iterates over its children
        return pose_of(xyz, _rotation_of_rpy(read_numbers(element.get("rpy", "0 0 0"), 3, f"{where} rpy")), where)
    if "rpy" in element.keys():  # noqa: SIM118
        raise InputError(f"{where}: has rpy and quat_xyzw; leave one of them.")
    return pose_of(
        xyz, _rotation_of_quaternion(read_numbers(element.get("quat_xyzw", ""), 4, f"{where} quat_xyzw"), where), where
    )


def read_pose_text(element: ElementTree.Element, where: str) -> FloatArray:
    """Read SDFormat's `<pose>x y z roll pitch yaw</pose>` as a (4, 4) pose, metres, without `relative_to`.

    Raises InputError: it is no pose, or has an attribute that is not understood.
    """
    refuse_attributes(element, ("relative_to", "frame", "degrees", "rotation_format"), where)
    form, degrees = element.get("rotation_format", "euler_rpy"), element.get("degrees", "false")
    if form not in ("euler_rpy", "quat_xyzw"):
        raise InputError(f"{where}: rotation_format is {form!r}; expected euler_rpy or quat_xyzw.")
    if degrees not in ("true", "1", "false", "0"):
        raise InputError(f"{where}: degrees is {degrees!r}; expected true or false.")
    text = element.text or ""
    if form == "quat_xyzw":
        values = read_numbers(text if text.strip() else f"0 0 0 {IDENTITY_QUATERNION}", 7, where)
        return pose_of(values[:3], _rotation_of_quaternion(values[3:], where), where)
    values = read_numbers(text if text.strip() else "0 0 0 0 0 0", 6, where)
    angles = np.radians(values[3:]) if degrees in ("true", "1") else values[3:]
    return pose_of(values[:3], _rotation_of_rpy(angles), where)


def refuse_attributes(element: ElementTree.Element, known: tuple[str, ...], where: str) -> None:
    """Raise InputError for an attribute that is not known. Those with a prefix are of other programs."""
    for name in element.keys():  # noqa: SIM118 - an element of XML iterates over its children
        if name not in known and ":" not in name:
            raise InputError(
                f"{where}: has the attribute {name}={element.get(name, '')[:40]!r}, which is not understood; expected "
                f"{', '.join(known)}."
            )


def pose_of(xyz: FloatArray, rotation: FloatArray, where: str) -> FloatArray:
    """Join a position (3,), metres, and a rotation (3, 3) to a (4, 4) pose. Raises InputError: it is of no robot's size."""
    pose = np.eye(4)
    pose[:3, :3], pose[:3, 3] = rotation, xyz
    if np.abs(xyz).max() > URDF_MAX_LENGTH_M:
        raise InputError(f"{where} is {xyz.tolist()}; expected metres, at most {URDF_MAX_LENGTH_M:g}.")
    return pose


def _rotation_of_rpy(rpy: FloatArray) -> FloatArray:
    (sr, sp, sy), (cr, cp, cy) = np.sin(rpy), np.cos(rpy)
    return np.array(
        [
            [cy * cp, cy * sp * sr - sy * cr, cy * sp * cr + sy * sr],
            [sy * cp, sy * sp * sr + cy * cr, sy * sp * cr - cy * sr],
            [-sp, cp * sr, cp * cr],
        ]
    )


def _rotation_of_quaternion(xyzw: FloatArray, where: str) -> FloatArray:
    length = float(np.linalg.norm(xyzw))
    if abs(length - 1.0) > UNIT_QUATERNION_MAX_LENGTH_ERROR:
        raise InputError(
            f"{where}: the quaternion {xyzw.tolist()} has the length {length:.3g}; expected 1, in the order x y z w."
        )
    return rotation_of_quaternion(xyzw[[3, 0, 1, 2]])
