"""Taxels as frames for robot descriptions and simulators: URDF, SDF, MuJoCo's MJCF, and arrays of poses as NPZ.

Every format gives a taxel the same frame: its origin is the position, its z axis the outward normal n, and its y axis lies in
the link's xy plane. That is R = Rz(yaw) Ry(pitch) with

    pitch = atan2(|(nx, ny)|, nz),   yaw = atan2(ny, nx),

so the roll is 0 in URDF's and SDF's order of fixed angles. The directions of x and y have no meaning: a taxel is round.
Where the normal is not known the frame stands as the link's. A taxel of three axes whose turn is known has the axes of its
readings instead, all three; the comments list the state of each turn. Lengths are metres, angles radians; taxels without a
position are left out. Every name begins with the link's name, or with the prefix of `ExportOptions`: two skins of one robot
share none.

Sources: wiki.ros.org/urdf/XML/joint, sdformat.org/spec (1.9: frame, pose), mujoco.readthedocs.io XMLreference (site, touch,
frame, attach, fusestatic of URDF). `consumers.py` says what each program does with the files; `tests/consumers` tries it.
"""

from __future__ import annotations

import io
import re
from collections.abc import Iterator
from typing import Any, cast
from xml.etree import ElementTree as ET

import numpy as np
from numpy.typing import NDArray

from skincal.files.calibration import Calibration, PlacedTaxels, placed_taxels
from skincal.files.formats import Inertia
from skincal.files.robot_file import insert_into_robot
from skincal.geometry import FloatArray, angles_of_rotation, quaternion_of_rotation
from skincal.taxels.result import Method
from skincal.words.taxel_words import state_lines

DEFAULT_TOUCH_SITE_RADIUS_M = 0.0025
"""m. Of a touch site where no layout says how far taxels lie apart: half of the iCub's 5 mm."""
TINY_MASS_KG = 1e-6
"""kg, of a taxel's link: 84 of them are 84 mg. Of 0 kg libsdformat 12 refuses the robot."""
TINY_URDF_INERTIA = 1e-12
"""kg m^2: 1e-6 kg within 1 mm. MuJoCo refuses 1e-15."""
TINY_SDF_INERTIA = 1e-9
"""kg m^2, of the link in SDF, which would be 1 kg m^2 without a word."""
_NOT_XML = re.compile("[^\t\n\r\x20-\ud7ff\ue000-\ufffd\U00010000-\U0010ffff]")


def urdf_text(calibration: Calibration, method: Method) -> str | bytes:
    """Return URDF: a link `PREFIXtaxel_CHANNEL` on a fixed joint of the calibrated link for each taxel.

    With the option `into` it is the robot's file with these links, otherwise a robot of the calibrated link alone.
    """
    taxels, link = placed_taxels(calibration.estimates_by(method)), xml_name(calibration.scene.link)
    elements: list[ET.Element] = []
    for name, position, angles in named_poses(calibration, taxels, method):
        elements.append(_urdf_link(name, calibration.options.inertia))
        # Importers of NVIDIA's simulators merge a link on a fixed joint with its parent, unless the joint says so.
        joint = ET.Element("joint", name=f"{name}_joint", type="fixed", dont_collapse="true")
        ET.SubElement(joint, "parent", link=link)
        ET.SubElement(joint, "child", link=name)
        ET.SubElement(joint, "origin", xyz=number_words(position), rpy=number_words(angles))
        elements.append(joint)
    if calibration.options.into is not None:
        return insert_into_robot(calibration.options.into, "robot", link, [*document_comments(calibration, method), *elements])
    root = begin_document("robot", {"name": xml_name(calibration.scene.name)}, calibration, method)
    # Otherwise MuJoCo makes one body of all links on fixed joints, without a name or a frame of theirs.
    ET.SubElement(ET.SubElement(root, "mujoco"), "compiler", fusestatic="false")
    root.append(_urdf_link(link, calibration.options.inertia))
    root.extend(elements)
    return document_text(root)


def _urdf_link(name: str, inertia: Inertia) -> ET.Element:
    link = ET.Element("link", name=name)
    if inertia is Inertia.TINY:
        inertial = ET.SubElement(link, "inertial")
        ET.SubElement(inertial, "mass", value=f"{TINY_MASS_KG:g}")
        moments = {f"i{axes}": f"{TINY_URDF_INERTIA if axes[0] == axes[1] else 0:g}" for axes in INERTIA_AXES}
        ET.SubElement(inertial, "inertia", moments)
    return link


def sdf_text(calibration: Calibration, method: Method) -> str | bytes:
    """Return SDF: a frame `PREFIXtaxel_CHANNEL`, attached to the calibrated link, for each taxel.

    With the option `into` it is the robot's file with these frames, otherwise a model with the calibrated link (SDF 1.9).
    """
    taxels, link = placed_taxels(calibration.estimates_by(method)), xml_name(calibration.scene.link)
    frames: list[ET.Element] = []
    for name, position, angles in named_poses(calibration, taxels, method):
        frame = ET.Element("frame", name=name, attached_to=link)
        ET.SubElement(frame, "pose", relative_to=link).text = number_words(np.concatenate([position, angles]))
        frames.append(frame)
    if calibration.options.into is not None:
        return insert_into_robot(calibration.options.into, "sdf", link, [*document_comments(calibration, method), *frames])
    root = begin_document("sdf", {"version": "1.9"}, calibration, method)
    add_comment(root, f"for a robot that has the link {link}: paste the <frame>s alone into its model")
    model = ET.SubElement(root, "model", name=skin_name(calibration))
    inertial = ET.SubElement(ET.SubElement(model, "link", name=link), "inertial")
    ET.SubElement(inertial, "mass").text = f"{TINY_MASS_KG:g}"
    moments = ET.SubElement(inertial, "inertia")
    for axes in INERTIA_AXES:
        ET.SubElement(moments, f"i{axes}").text = f"{TINY_SDF_INERTIA if axes[0] == axes[1] else 0:g}"
    model.extend(frames)
    return document_text(root)


INERTIA_AXES = ("xx", "xy", "xz", "yy", "yz", "zz")


def mjcf_text(calibration: Calibration, method: Method) -> str:
    """Return MJCF: a frame with a spherical site for each taxel, and a touch sensor on it.

    A touch sensor adds up the normal forces of the contacts within its site, of the geoms of the site's own body alone. So the
    sites have a `<frame>`, which can be attached to the robot's body. Those of an attached body stay silent. The sites' radius
    is half of the layout's spacing, so that neighbours do not feel the same contact.
    """
    taxels, radius = placed_taxels(calibration.estimates_by(method)), taxel_radius(calibration)
    link, skin = xml_name(calibration.scene.link), skin_name(calibration)
    root = begin_document("mujoco", {"model": xml_name(calibration.scene.name)}, calibration, method)
    for line in (
        f"attach the frame {skin} to the robot's body of {link}, so that its geoms press the sites; <include> misplaces them",
        f'XML: in <asset> <model name="{skin}" file="THIS FILE"/>',
        f'     in the body <attach model="{skin}" frame="{skin}" prefix=""/>',
        f'Python: body.attach_frame(MjSpec.from_file("THIS FILE").frame("{skin}"), "", "")',
        f"if {link} is not the body itself: in a <frame> at the pose of {link} in the body, or set pos and quat of the result",
    ):
        add_comment(root, line)
    body = ET.SubElement(ET.SubElement(root, "worldbody"), "body", name=link)
    frame, sensors = ET.SubElement(body, "frame", name=skin), ET.SubElement(root, "sensor")
    quaternions = frame_quaternions(calibration, taxels, method)
    for (name, position, _), quaternion in zip(named_poses(calibration, taxels, method), quaternions, strict=True):
        shape = {"type": "sphere", "size": f"{radius:.9g}", "pos": number_words(position), "quat": number_words(quaternion)}
        ET.SubElement(frame, "site", {"name": name, **shape})
        ET.SubElement(sensors, "touch", name=name, site=name)
    return document_text(root)


def npz_bytes(calibration: Calibration, method: Method) -> bytes:
    """Return a NumPy archive of n taxels in the order of their channels; `numpy.load` reads it without pickles.

    `channel` (n,) int; `position` (n, 3) float, metres; `normal` (n, 3) float, unit, outward, NaN where not known;
    `quaternion_wxyz` (n, 4) float, of the taxel's frame; `covariance` (n, 3, 3) float, m^2; `state` (n,) text, touched or
    inferred; `frame`, `method`, `units` and `version` (text). Of taxels of three axes also `turn_state` (n,) text, see
    `FrameState`, and `turn_covariance` (n, 3, 3) float, rad^2, link frame, NaN unless the turn is known.
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
        quaternion_wxyz=frame_quaternions(calibration, taxels, method),
        covariance=np.array(covariances, dtype=float).reshape(-1, 3, 3),
        state=np.array([state.value for state in taxels.states], dtype=str),
        frame=np.array(calibration.scene.link),
        method=np.array(method.value),
        units=np.array("m"),
        version=np.array(calibration.version),
        **_turn_arrays(calibration, taxels, method),
    )
    return out.getvalue()


def _turn_arrays(calibration: Calibration, taxels: PlacedTaxels, method: Method) -> dict[str, NDArray[Any]]:
    """Give the arrays of an archive that taxels of three axes have in addition."""
    if calibration.axes is None:
        return {}
    frames = [calibration.axes.frames(method)[channel] for channel in taxels.channels.tolist()]
    unknown = np.full((3, 3), np.nan)
    covariances = [unknown if frame.covariance is None else frame.covariance for frame in frames]
    return {
        "turn_state": np.array([frame.state.value for frame in frames], dtype=str),
        "turn_covariance": np.array(covariances, dtype=float).reshape(-1, 3, 3),
    }


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


def frame_angles(calibration: Calibration, taxels: PlacedTaxels, method: Method) -> FloatArray:
    """Return (n, 3) roll, pitch and yaw, radians, of each taxel's frame: of its turn if that is known, else of `angles_of`."""
    angles = angles_of(taxels.normals)
    for row, rotation in _known_turns(calibration, taxels, method):
        angles[row] = angles_of_rotation(rotation)
    return angles


def frame_quaternions(calibration: Calibration, taxels: PlacedTaxels, method: Method) -> FloatArray:
    """Return (n, 4) unit quaternions w x y z of the same frames."""
    quaternions = quaternions_of(taxels.normals)
    for row, rotation in _known_turns(calibration, taxels, method):
        quaternions[row] = quaternion_of_rotation(rotation)
    return quaternions


def _known_turns(calibration: Calibration, taxels: PlacedTaxels, method: Method) -> Iterator[tuple[int, FloatArray]]:
    """Give row and rotation of each taxel whose turn is known."""
    for row, channel in enumerate(taxels.channels.tolist()):
        frame = calibration.frame(channel, method)
        if frame is not None and frame.rotation is not None:
            yield row, frame.rotation


def name_prefix(calibration: Calibration) -> str:
    """Return the beginning of every name: the operator's prefix, or the link's name and an underscore."""
    chosen = calibration.options.prefix
    return f"{xml_name(calibration.scene.link)}_" if chosen is None else chosen


def skin_name(calibration: Calibration) -> str:
    """Return the name of the skin as a whole: of a sensor, a model or a frame."""
    return f"{name_prefix(calibration)}skin"


def named_poses(calibration: Calibration, taxels: PlacedTaxels, method: Method) -> list[tuple[str, FloatArray, FloatArray]]:
    """Return name, position and angles of each taxel."""
    prefix = name_prefix(calibration)
    names = [f"{prefix}taxel_{channel}" for channel in taxels.channels.tolist()]
    return list(zip(names, taxels.positions, frame_angles(calibration, taxels, method), strict=True))


def begin_document(tag: str, attributes: dict[str, str], calibration: Calibration, method: Method) -> ET.Element:
    """Return the document's root with comments on what it holds."""
    root = ET.Element(tag, attributes)
    root.extend(document_comments(calibration, method))
    return root


def document_comments(calibration: Calibration, method: Method) -> list[ET.Element]:
    """Return comments on the content of a file."""
    return [_comment(line) for line in comment_lines(calibration, method)]


def comment_lines(calibration: Calibration, method: Method, units: str = "metres and radians") -> list[str]:
    """List the comments on the content of a file in these units."""
    return [
        f"skincal {calibration.version}, {method.value} method, {units} in {calibration.scene.link}",
        *_axis_lines(calibration, method),
        *calibration.correction_comments(),
        *calibration.verdict_comments(method),
        *state_lines(calibration.estimates_by(method)),
    ]


def _axis_lines(calibration: Calibration, method: Method) -> list[str]:
    """Describe the axes of a taxel."""
    if calibration.axes is None or calibration.scene.skin.axes is None:
        return ["z axis of a taxel: its outward normal; the link's own where that is not known"]
    from skincal.words.axis_words import axes_lines  # other skins do without

    found = calibration.axes
    return axes_lines(calibration.scene.skin.axes, found.findings(method), found.frames(method).values())


def add_comment(root: ET.Element, line: str) -> None:
    """Append a comment."""
    root.append(_comment(line))


def _comment(line: str) -> ET.Element:
    # XML forbids double hyphens in a comment.
    return cast("ET.Element", ET.Comment(f" {xml_name(line).replace('--', '- -')} "))


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
