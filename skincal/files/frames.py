"""Taxels as frames for robot descriptions and simulators: URDF, SDF, MuJoCo's MJCF, and arrays of poses as NPZ.

Every format gives a taxel the same frame: its origin is the position, its z axis the outward normal n, and its y axis lies in
the link's xy plane. That is R = Rz(yaw) Ry(pitch) with

    pitch = atan2(|(nx, ny)|, nz),   yaw = atan2(ny, nx),

so the roll is 0 in URDF's and SDF's order of fixed angles. The directions of x and y have no meaning: a taxel is round.
Where the normal is not known the frame stands as the link's. Lengths are metres, angles radians; taxels without a position
are left out.

Sources: wiki.ros.org/urdf/XML/joint, sdformat.org/spec (1.9: frame, pose), mujoco.readthedocs.io XMLreference (site, touch).
"""

from __future__ import annotations

import io
import re
from xml.etree import ElementTree as ET

import numpy as np

from skincal.files.calibration import Calibration, PlacedTaxels, placed_taxels
from skincal.geometry import FloatArray
from skincal.taxels.result import Method
from skincal.words.rig_words import correction_words

DEFAULT_TOUCH_SITE_RADIUS_M = 0.0025
"""m. Of a touch site where no layout says how far taxels lie apart: half of the iCub's 5 mm."""
_NOT_XML = re.compile("[^\t\n\r\x20-\ud7ff\ue000-\ufffd\U00010000-\U0010ffff]")


def urdf_text(calibration: Calibration, method: Method) -> str:
    """Return URDF: the calibrated link, and for each taxel a link `taxel_CHANNEL` by a fixed joint."""
    taxels, link = placed_taxels(calibration.estimates_by(method)), xml_name(calibration.scene.link)
    root = begin_document("robot", {"name": xml_name(calibration.scene.name)}, calibration, method)
    ET.SubElement(root, "link", name=link)
    for name, position, angles in named_poses(taxels):
        ET.SubElement(root, "link", name=name)
        joint = ET.SubElement(root, "joint", name=f"{name}_joint", type="fixed")
        ET.SubElement(joint, "parent", link=link)
        ET.SubElement(joint, "child", link=name)
        ET.SubElement(joint, "origin", xyz=number_words(position), rpy=number_words(angles))
    return document_text(root)


def sdf_text(calibration: Calibration, method: Method) -> str:
    """Return SDF 1.9: a model with the calibrated link, and for each taxel a frame `taxel_CHANNEL` attached to it."""
    taxels, link = placed_taxels(calibration.estimates_by(method)), xml_name(calibration.scene.link)
    root = begin_document("sdf", {"version": "1.9"}, calibration, method)
    model = ET.SubElement(root, "model", name=xml_name(calibration.scene.name))
    ET.SubElement(model, "link", name=link)
    for name, position, angles in named_poses(taxels):
        frame = ET.SubElement(model, "frame", name=name, attached_to=link)
        ET.SubElement(frame, "pose", relative_to=link).text = number_words(np.concatenate([position, angles]))
    return document_text(root)


def mjcf_text(calibration: Calibration, method: Method) -> str:
    """Return MJCF: a body with a spherical site for each taxel, and a touch sensor on it.

    A touch sensor adds up the normal forces of the contacts within its site. The sites' radius is half of the layout's
    spacing, so that neighbours do not feel the same contact.
    """
    taxels, radius = placed_taxels(calibration.estimates_by(method)), taxel_radius(calibration)
    root = begin_document("mujoco", {"model": xml_name(calibration.scene.name)}, calibration, method)
    body = ET.SubElement(ET.SubElement(root, "worldbody"), "body", name=xml_name(calibration.scene.link))
    sensors = ET.SubElement(root, "sensor")
    quaternions = quaternions_of(taxels.normals)
    for (name, position, _), quaternion in zip(named_poses(taxels), quaternions, strict=True):
        shape = {"type": "sphere", "size": f"{radius:.9g}", "pos": number_words(position), "quat": number_words(quaternion)}
        ET.SubElement(body, "site", {"name": name, **shape})
        ET.SubElement(sensors, "touch", name=name, site=name)
    return document_text(root)


def npz_bytes(calibration: Calibration, method: Method) -> bytes:
    """Return a NumPy archive of n taxels in the order of their channels; `numpy.load` reads it without pickles.

    `channel` (n,) int; `position` (n, 3) float, metres; `normal` (n, 3) float, unit, outward, NaN where not known;
    `quaternion_wxyz` (n, 4) float, of the taxel's frame; `covariance` (n, 3, 3) float, m^2; `frame`, `method`, `units` and
    `version` (text).
    """
    estimates = [estimate for estimate in calibration.estimates_by(method) if estimate.position is not None]
    taxels, unknown = placed_taxels(estimates), np.full((3, 3), np.nan)
    covariances = [unknown if estimate.covariance is None else estimate.covariance for estimate in estimates]
    out = io.BytesIO()
    np.savez(
        out,
        allow_pickle=False,
        channel=taxels.channels,
        position=taxels.positions,
        normal=np.where(taxels.normals.any(axis=1, keepdims=True), taxels.normals, np.nan),
        quaternion_wxyz=quaternions_of(taxels.normals),
        covariance=np.array(covariances, dtype=float).reshape(-1, 3, 3),
        frame=np.array(calibration.scene.link),
        method=np.array(method.value),
        units=np.array("m"),
        version=np.array(calibration.version),
    )
    return out.getvalue()


def taxel_radius(calibration: Calibration) -> float:
    """Half of the layout's spacing, metres, or `DEFAULT_TOUCH_SITE_RADIUS_M` without a layout of several taxels."""
    layout = calibration.scene.skin.layout
    return DEFAULT_TOUCH_SITE_RADIUS_M if layout is None or not np.isfinite(layout.spacing) else layout.spacing / 2


def angles_of(normals: FloatArray) -> FloatArray:
    """Return (n, 3) roll, pitch and yaw, radians, of frames whose z axis is a normal; zeros for a normal of zeros."""
    across = np.hypot(normals[:, 0], normals[:, 1])
    # Of a normal of zeros and of one along z every angle here is atan2(0, 0) = 0 or right.
    return np.stack(
        [np.zeros(len(normals)), np.arctan2(across, normals[:, 2]), np.arctan2(normals[:, 1], normals[:, 0])], axis=1
    )


def quaternions_of(normals: FloatArray) -> FloatArray:
    """Return (n, 4) unit quaternions w x y z of the frames of `angles_of`."""
    half = angles_of(normals) / 2
    (cp, sp), (cy, sy) = ((np.cos(half[:, axis]), np.sin(half[:, axis])) for axis in (1, 2))
    # qz(yaw) qy(pitch)
    return np.stack([cy * cp, -sy * sp, cy * sp, sy * cp], axis=1)


def named_poses(taxels: PlacedTaxels) -> list[tuple[str, FloatArray, FloatArray]]:
    """Return name, position and angles of each taxel."""
    names = [f"taxel_{channel}" for channel in taxels.channels.tolist()]
    return list(zip(names, taxels.positions, angles_of(taxels.normals), strict=True))


def begin_document(tag: str, attributes: dict[str, str], calibration: Calibration, method: Method) -> ET.Element:
    """Return the document's root with comments on what it holds."""
    root = ET.Element(tag, attributes)
    lines = (
        f"skincal {calibration.version}, {method.value} method, metres and radians in {calibration.scene.link}",
        "z axis of a taxel: its outward normal; the link's own where that is not known",
        *(correction_words(used) for used in calibration.corrections),
        *calibration.verdict_comments(method),
    )
    for line in lines:
        add_comment(root, line)
    return root


def add_comment(root: ET.Element, line: str) -> None:
    """Append a comment; replace double hyphens, which XML forbids in it."""
    root.append(ET.Comment(f" {xml_name(line).replace('--', '- -')} "))


def xml_name(text: str) -> str:
    """Return text without the control characters that XML has no way to write."""
    return _NOT_XML.sub("_", text)


def number_words(values: FloatArray) -> str:
    """Write numbers, with a space between."""
    # Nine digits of a metre are finer than a nanometre. Adding 0.0 turns -0 into 0.
    return " ".join(f"{value + 0.0:.9g}" for value in values.tolist())


def document_text(root: ET.Element) -> str:
    """Write a document with its declaration, indented."""
    ET.indent(root)
    return f'<?xml version="1.0"?>\n{ET.tostring(root, encoding="unicode")}\n'
