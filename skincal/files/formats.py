"""Registry of export formats: each entry has the words of the commands' help and of the export dialog, and names the writer.

It imports nothing heavy, since the commands' help must answer at once. `consumers.py` says which program reads which format.
"""

from __future__ import annotations

import re
from dataclasses import dataclass, fields, replace
from enum import Enum
from pathlib import Path

from skincal.model.errors import InputError


class ExportFormat(Enum):
    """Formats of calibration files, in menu order; the value is the name in commands.

    An entry is: name, title, suffix of the file's name, purpose in one line, and `module:function` of the writer. The function
    takes a calibration and a method and returns the file's text or bytes. The last entry lists what else holds: "all" if the
    file has every method, and the options of `ExportOptions` that the format knows.
    """

    ICUB = (
        "icub",
        "iCub position file",
        ".txt",
        "What skinManager and skinGui load: every channel, unit normals, taxel2Repr.",
        "skincal.files.icub:icub_text",
        "part",
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
        "prefix into inertia",
    )
    TACTILE_URDF = (
        "tactile-urdf",
        "Tactile sensor for URDF",
        ".tactile.urdf",
        "For tactile_toolbox (RViz): a <sensor> with a taxel each, to paste into the robot's URDF.",
        "skincal.files.tactile_urdf:tactile_urdf_text",
        "prefix into",
    )
    SDF = (
        "sdf",
        "SDF frames",
        ".sdf",
        "For Gazebo: a frame a taxel on the link, its z axis along the normal.",
        "skincal.files.frames:sdf_text",
        "prefix into",
    )
    MJCF = (
        "mjcf",
        "MuJoCo touch sites",
        ".xml",
        "For MuJoCo: a site a taxel on the link's body, and a touch sensor on it.",
        "skincal.files.frames:mjcf_text",
        "prefix",
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

    def __init__(self, _name: str, title: str, suffix: str, description: str, writer: str, features: str = "") -> None:
        self.title, self.suffix, self.description, self.writer = title, suffix, description, writer
        self.features = frozenset(features.split())

    @property
    def holds_all_methods(self) -> bool:
        """Whether the file has the estimates of every method."""
        return "all" in self.features


def formats_help() -> str:
    """List all formats with a line each, for the help of a command, which keeps paragraphs apart."""
    return "\n\n".join(f"{each.value}: {each.description}" for each in ExportFormat)


class Inertia(Enum):
    """Mass of a taxel's link in URDF."""

    NONE = "none"
    """No `<inertial>`: a frame without mass, as ROS means it."""
    TINY = "tiny"
    """1e-6 kg and 1e-12 kg m^2: for programs that give 1 kg to a link without `<inertial>`."""


@dataclass(frozen=True, slots=True)
class ExportOptions:
    """Options of an export that only some formats know; the default changes nothing."""

    part: str | None = None
    """Skin part named in the iCub file; see `skincal.files.icub.skin_part`."""
    prefix: str | None = None
    """Begins every name in the file; `None` for the link's name and an underscore."""
    inertia: Inertia = Inertia.NONE
    into: Path | None = None
    """Robot's own file, whose copy gets the taxels; `None` for a file of the taxels alone."""

    def for_format(self, format_: ExportFormat) -> ExportOptions:
        """Return the options without those that have no use in the format."""
        unused = {field.name: field.default for field in fields(self) if field.name not in format_.features}
        return replace(self, **unused)

    def require_use(self, format_: ExportFormat) -> None:
        """Raise InputError if an option has no use in the format, or the prefix cannot begin a name."""
        given = {
            "part": self.part is not None,
            "prefix": self.prefix is not None,
            "inertia": self.inertia is not Inertia.NONE,
            "into": self.into is not None,
        }
        for option in (name for name, is_given in given.items() if is_given and name not in format_.features):
            known = " or ".join(each.value for each in ExportFormat if option in each.features)
            advice = "; in MuJoCo attach the file to the robot, as its comment says" if format_ is ExportFormat.MJCF else ""
            raise InputError(
                f"--{option} {_PURPOSE_OF_OPTION[option]}; expected --format {known}, not {format_.value}{advice}."
            )
        if self.prefix is not None and not _PREFIX_RE.fullmatch(self.prefix):
            raise InputError(
                f"--prefix is {self.prefix!r}; expected letters, digits and _ . - /, not / at the beginning, such as left_arm_."
            )


NO_OPTIONS = ExportOptions()
_PREFIX_RE = re.compile(r"([\w.-][\w./-]*)?")
_PURPOSE_OF_OPTION = {
    "part": "names the skin part in an iCub file",
    "prefix": "begins the names of taxels",
    "inertia": "gives each taxel's link a mass",
    "into": "writes the whole robot with the taxels",
}
