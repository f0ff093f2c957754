"""Registry of export formats: each entry has the words of the commands' help and of the export dialog.

It imports nothing heavy, since the commands' help must answer at once. `consumers.py` says which program reads which format.
"""

from __future__ import annotations

import re
from dataclasses import dataclass, fields, replace
from enum import Enum
from pathlib import Path

from skincal.model.errors import InputError


@dataclass(frozen=True, slots=True)
class _Format:
    """An entry of `ExportFormat`."""

    name: str
    title: str
    suffix: str
    description: str
    options: tuple[str, ...] = ()
    holds_all_methods: bool = False
    needs_three_axes: bool = False


class ExportFormat(Enum):
    """Formats of calibration files, in menu order; the value is the name in commands.

    `WRITER_OF_FORMAT` of `export.py` has the writers.
    """

    ICUB = _Format(
        "icub",
        "iCub position file",
        ".txt",
        "What skinManager and skinGui load: every channel, unit normals, taxel2Repr.",
        options=("part",),
    )
    JSON = _Format(
        "json",
        "JSON, complete",
        ".json",
        "Covariances, gains, contacts and settings: everything needed to compute it again.",
        holds_all_methods=True,
    )
    CSV = _Format(
        "csv",
        "CSV, all methods",
        ".csv",
        "One row a channel and method, metres and millimetres, with the taxel's gain.",
        holds_all_methods=True,
    )
    PLY = _Format("ply", "PLY points", ".ply", "For mesh viewers: positions with normals.")
    URDF = _Format(
        "urdf",
        "URDF frames",
        ".urdf",
        "For ROS: a link and a fixed joint a taxel, its z axis along the normal.",
        options=("prefix", "into", "inertia"),
    )
    TACTILE_URDF = _Format(
        "tactile-urdf",
        "Tactile sensor for URDF",
        ".tactile.urdf",
        "For tactile_toolbox (RViz): a <sensor> with a taxel each, to paste into the robot's URDF.",
        options=("prefix", "into"),
    )
    SDF = _Format(
        "sdf",
        "SDF frames",
        ".sdf",
        "For Gazebo: a frame a taxel on the link, its z axis along the normal.",
        options=("prefix", "into"),
    )
    MJCF = _Format(
        "mjcf",
        "MuJoCo touch sites",
        ".xml",
        "For MuJoCo: a site a taxel on the link's body, and a touch sensor on it.",
        options=("prefix",),
    )
    NPZ = _Format(
        "npz",
        "NumPy arrays",
        ".npz",
        "For own programs: channel, position, normal, quaternion and covariance, metres.",
    )
    TAXEL_GEOMETRY = _Format(
        "taxel-geometry",
        "Taxel geometry",
        ".yaml",
        "For nb-touch: position and rotation of each taxel of three axes.",
        options=("prefix",),
        needs_three_axes=True,
    )

    title: str
    suffix: str
    """Of the file's name."""
    description: str
    """Purpose in one line."""
    options: tuple[str, ...]
    """Options of `ExportOptions` that the format knows."""
    holds_all_methods: bool
    """Whether the file has the estimates of every method."""
    needs_three_axes: bool
    """Whether it is for taxels of three axes alone."""

    def __new__(cls, entry: _Format) -> ExportFormat:
        """Make an entry whose value is its name alone."""
        made = object.__new__(cls)
        made._value_ = entry.name
        made.title, made.suffix, made.description = entry.title, entry.suffix, entry.description
        made.options, made.holds_all_methods = entry.options, entry.holds_all_methods
        made.needs_three_axes = entry.needs_three_axes
        return made


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
    is_asked: bool = True
    """The operator chose the format. Else hints for the programs of an iCub are left out for parts of other robots."""

    def for_format(self, format_: ExportFormat) -> ExportOptions:
        """Return the options without those that have no use in the format."""
        unused = {field.name: field.default for field in fields(self) if field.name not in format_.options}
        return replace(self, **unused)

    def require_use(self, format_: ExportFormat) -> None:
        """Raise InputError if an option has no use in the format, or the prefix cannot begin a name."""
        given = {
            "part": self.part is not None,
            "prefix": self.prefix is not None,
            "inertia": self.inertia is not Inertia.NONE,
            "into": self.into is not None,
        }
        for option in (name for name, is_given in given.items() if is_given and name not in format_.options):
            known = " or ".join(each.value for each in ExportFormat if option in each.options)
            advice = "; in MuJoCo attach the file to the robot, as its comment says" if format_ is ExportFormat.MJCF else ""
            raise InputError(
                f"--{option} {_PURPOSE_OF_OPTION[option]}; expected --format {known}, not {format_.value}{advice}."
            )
        if self.prefix is not None and not _PREFIX_RE.fullmatch(self.prefix):
            raise InputError(
                f"The prefix (--prefix) is {self.prefix!r}; expected letters, digits and _ . - /, not / at the beginning, such "
                "as left_arm_."
            )


NO_OPTIONS = ExportOptions()
_PREFIX_RE = re.compile(r"([\w.-][\w./-]*)?")
_PURPOSE_OF_OPTION = {
    "part": "names the skin part in an iCub file",
    "prefix": "begins the names of taxels",
    "inertia": "gives each taxel's link a mass",
    "into": "writes the whole robot with the taxels",
}
