"""Registry of export formats: each entry has the words of the commands' help and of the export dialog, and names the writer.

It imports nothing heavy, since the commands' help must answer at once.
"""

from __future__ import annotations

from enum import Enum


class ExportFormat(Enum):
    """Formats of calibration files, in menu order; the value is the name in commands.

    An entry is: name, title, suffix of the file's name, purpose in one line, and `module:function` of the writer. The function
    takes a calibration and a method and returns the file's text or bytes. "all" marks a file that holds every method.
    """

    ICUB = (
        "icub",
        "iCub position file",
        ".txt",
        "What skinManager and skinGui load: every channel, unit normals, taxel2Repr.",
        "skincal.files.icub:icub_text",
    )
    JSON = (
        "json",
        "JSON, complete",
        ".json",
        "Covariances, gains, contacts and settings: everything needed to compute it again.",
        "skincal.files.export:json_text",
        "all",
    )
    CSV = (
        "csv",
        "CSV, all methods",
        ".csv",
        "One row a channel and method, metres and millimetres, with the taxel's gain.",
        "skincal.files.export:csv_text",
        "all",
    )
    PLY = ("ply", "PLY points", ".ply", "For mesh viewers: positions with normals.", "skincal.files.export:ply_text")
    URDF = (
        "urdf",
        "URDF frames",
        ".urdf",
        "For ROS: a link and a fixed joint a taxel, its z axis along the normal.",
        "skincal.files.frames:urdf_text",
    )
    TACTILE_URDF = (
        "tactile-urdf",
        "Tactile sensor for URDF",
        ".tactile.urdf",
        "For tactile_toolbox (RViz): a <sensor> with a taxel each, to paste into the robot's URDF.",
        "skincal.files.tactile_urdf:tactile_urdf_text",
    )
    SDF = (
        "sdf",
        "SDF frames",
        ".sdf",
        "For Gazebo: a frame a taxel on the link, its z axis along the normal.",
        "skincal.files.frames:sdf_text",
    )
    MJCF = (
        "mjcf",
        "MuJoCo touch sites",
        ".xml",
        "For MuJoCo: a site a taxel on the link's body, and a touch sensor on it.",
        "skincal.files.frames:mjcf_text",
    )
    NPZ = (
        "npz",
        "NumPy arrays",
        ".npz",
        "For own programs: channel, position, normal, quaternion and covariance, metres.",
        "skincal.files.frames:npz_bytes",
    )

    def __new__(cls, name: str, *_: str) -> ExportFormat:
        """Make an entry whose value is its name alone."""
        entry = object.__new__(cls)
        entry._value_ = name
        return entry

    def __init__(self, _name: str, title: str, suffix: str, description: str, writer: str, methods: str = "") -> None:
        self.title, self.suffix, self.description, self.writer = title, suffix, description, writer
        self.holds_all_methods = methods == "all"


def formats_help() -> str:
    """List all formats with a line each, for the help of a command, which keeps paragraphs apart."""
    return "\n\n".join(f"{each.value}: {each.description}" for each in ExportFormat)
