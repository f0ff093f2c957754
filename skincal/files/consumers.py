"""Programs that read exported files: the format for each, the options of the export, and what to know.

`tests/consumers` reads an export with each of them; the tables of README and manual are compared with this list.
"""

from __future__ import annotations

from dataclasses import dataclass

from skincal.files.formats import ExportFormat


@dataclass(frozen=True, slots=True)
class Consumer:
    """A program, and the export that it reads best."""

    program: str
    format_: ExportFormat
    options: str
    """Further options of `skincal export`; empty for none."""
    hint: str
    """What the program makes of the file, in one or two sentences."""

    @property
    def choice(self) -> str:
        """Format and options, as a command has them after `--format`."""
        return f"{self.format_.value} {self.options}".strip()


EXPORT_CONSUMERS = (
    Consumer(
        "MuJoCo",
        ExportFormat.MJCF,
        "",
        "Attach the frame LINK_skin to the robot's body, as the file's comment says; sites of an attached body stay silent.",
    ),
    Consumer(
        "Drake",
        ExportFormat.SDF,
        "",
        "Weld its link to the robot's. Each taxel is a frame; in a URDF it would be a body with a joint.",
    ),
    Consumer("pinocchio", ExportFormat.URDF, "--into robot.urdf", "Each taxel is a frame. Sites of MJCF are dropped."),
    Consumer("iDynTree", ExportFormat.URDF, "--into robot.urdf", "Each taxel is an additional frame."),
    Consumer(
        "PyBullet",
        ExportFormat.URDF,
        "--into robot.urdf --inertia tiny",
        "Without --inertia a taxel weighs 1 kg. Robot and taxels may have 127 links; with more, take npz.",
    ),
    Consumer(
        "Gazebo",
        ExportFormat.SDF,
        "--into robot.sdf",
        "Each taxel is a frame. Of a URDF, Fortress drops links without mass on fixed joints without a message.",
    ),
    Consumer(
        "RViz",
        ExportFormat.TACTILE_URDF,
        "--into robot.urdf",
        "Displays of tactile_toolbox draw the sensor. For frames alone take urdf.",
    ),
    Consumer(
        "Open3D",
        ExportFormat.PLY,
        "",
        "open3d.t.io.read_point_cloud keeps channel, method, sd_mm and quality; open3d.io drops them.",
    ),
    Consumer("MeshLab", ExportFormat.PLY, "", "Keeps positions, normals and quality, the sd in mm."),
    Consumer("Blender", ExportFormat.PLY, "", "Keeps channel, method, sd_mm and quality as attributes of the points."),
    Consumer(
        "nb-touch",
        ExportFormat.TAXEL_GEOMETRY,
        "",
        "Three axes. Its frame sensor is the link. It needs readings with z out of the skin, as the file's comment says.",
    ),
)


def consumers_help() -> str:
    """List the format for each program with a line each, for the help of a command, which keeps paragraphs apart."""
    return "\n\n".join(f"{each.program}: {each.choice}. {each.hint}" for each in EXPORT_CONSUMERS)
