"""The formats of calibration files, with a line on each: what the commands' help and the export dialog list.

It imports nothing heavy, since the commands' help must answer at once.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from enum import Enum


class ExportFormat(Enum):
    """A calibration file's format; the value is its name in commands."""

    ICUB = "icub"
    JSON = "json"
    CSV = "csv"
    PLY = "ply"
    URDF = "urdf"
    SDF = "sdf"
    MJCF = "mjcf"
    NPZ = "npz"


@dataclass(frozen=True, slots=True)
class FormatInfo:
    """Title, suffix and description of a format."""

    title: str
    ending: str
    """Of the file's name, with its point."""
    about: str
    """Purpose, in one line."""
    every_method: bool = False
    """Whether it holds all methods, not one that is chosen."""


EXPORT_FORMATS: Mapping[ExportFormat, FormatInfo] = {
    ExportFormat.ICUB: FormatInfo(
        "iCub position file",
        ".txt",
        "What skinManager and skinGui load: every channel, unit normals, taxel2Repr.",
    ),
    ExportFormat.JSON: FormatInfo(
        "JSON, complete",
        ".json",
        "Covariances, gains, contacts and settings: everything needed to compute it again.",
        every_method=True,
    ),
    ExportFormat.CSV: FormatInfo(
        "CSV, all methods",
        ".csv",
        "One row a channel and method, metres and millimetres, with the taxel's gain.",
        every_method=True,
    ),
    ExportFormat.PLY: FormatInfo("PLY points", ".ply", "For mesh viewers: positions with normals."),
    ExportFormat.URDF: FormatInfo(
        "URDF frames", ".urdf", "For ROS: a link and a fixed joint a taxel, its z axis along the normal."
    ),
    ExportFormat.SDF: FormatInfo("SDF frames", ".sdf", "For Gazebo: a frame a taxel on the link, its z axis along the normal."),
    ExportFormat.MJCF: FormatInfo(
        "MuJoCo touch sites", ".xml", "For MuJoCo: a site a taxel on the link's body, and a touch sensor on it."
    ),
    ExportFormat.NPZ: FormatInfo(
        "NumPy arrays", ".npz", "For own programs: channel, position, normal, quaternion and covariance, metres."
    ),
}
"""Registry of formats, in menu order."""


def formats_help() -> str:
    """Return all formats with a line each, for the help of a command, which keeps paragraphs apart."""
    return "\n\n".join(f"{format_.value}: {words.about}" for format_, words in EXPORT_FORMATS.items())
