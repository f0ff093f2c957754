"""Requests to open a session, and the slow work of opening, done in the background with its imports. No Qt."""

from __future__ import annotations

import sys
from collections.abc import Sequence
from dataclasses import dataclass
from datetime import datetime
from pathlib import Path
from typing import TYPE_CHECKING

from skincal.model.errors import InputError

if TYPE_CHECKING:
    from skincal.model.scene import Scene
    from skincal.part.part import Part
    from skincal.session.pipeline import Pipeline
    from skincal.streams.links import LinkSpec

DEFAULT_SCENE = "icub-forearm"
MESH_FILE_ENDINGS = (".stl", ".obj", ".ply", ".off", ".dae", ".glb", ".gltf")
PART_FILES = (*MESH_FILE_ENDINGS, ".urdf")  # Endings of files with which a new part begins
DEMO_SCENES = {"below": "", "tool": "cobot-wrist", "none": "cobot-tip"}
"""Shipped scene of the demonstration with a robot, by the place of its sensor; empty for the default scene."""


@dataclass(frozen=True, slots=True)
class Addresses:
    """Addresses of the devices as typed; empty if there is none."""

    wrench: str = ""
    skin: str = ""
    joints: str = ""
    tip: str = ""
    tool: str = ""

    def __bool__(self) -> bool:
        return any(self.named)

    @property
    def named(self) -> tuple[str, ...]:
        """Addresses that are not empty."""
        return tuple(filter(None, (self.wrench, self.skin, self.joints, self.tip, self.tool)))


@dataclass(frozen=True, slots=True)
class OpenRequest:
    """What to open; `session` has priority."""

    scene: Path | None = None
    session: Path | None = None
    part: Path | None = None
    """Mesh or URDF of a part without a scene."""
    addresses: Addresses = Addresses()
    server: tuple[str, ...] = ()
    """Command of a device process, used without addresses."""
    folder: Path | None = None
    """Folder of the new session; `None` for a dated one, which the window offers to discard when it closes."""
    targets: str = ""
    """Port that sends poke targets to a robot, `[HOST:]PORT`; empty for none."""
    demo: bool = False
    """Demonstration: fast simulated operator, card for newcomers, and the verdict opens without a key."""
    robot: bool = False
    """The device process simulates a robot that pokes, which has no pace."""
    pose: str = ""
    """Arm pose at the start of a new session; empty if not chosen."""
    read_only: bool = False
    """Show what another process has recorded so far, and change nothing."""

    @property
    def copied(self) -> bool:
        """Whether a copy is opened: a shipped session is never changed."""
        return self.session is not None and not self.read_only and is_shipped(self.session)


def find_scene(scene: Path | None) -> Path:
    """Find a scene's file by its path or the name of a shipped scene; `None` for the default scene."""
    from skincal.model.scene import scene_file

    return scene_file(Path(DEFAULT_SCENE) if scene is None else scene)


def server_command(scene: Path | None, *, robot: bool = False) -> tuple[str, ...]:
    """Make the command that simulates a scene's devices over TCP; `None` for the default scene.

    The window appends the port that sends poke targets to its operator, or to a simulated `robot` in its place.
    """
    name = DEFAULT_SCENE if scene is None else str(scene)
    # A frozen program runs the commands itself. -P: no file of the working folder is imported.
    program = () if getattr(sys, "frozen", False) else ("-P", "-m", "skincal.cli")
    pokes = ("--physics", "mujoco") if robot else ("--operator", "guided")
    return (sys.executable, *program, "simulate", "--serve", "--tcp", *pokes, "--scene", name, "--json")


def same_rig_command(folder: Path, scene: Path, part: int) -> tuple[str, ...]:
    """Make the command that simulates the rig of a recorded session again, if its truth file names that.

    `part` is the number of parts that the session has: each part has other noise and other pokes.
    """
    from skincal.files.reference import simulated_rig_options

    return (*server_command(scene), *simulated_rig_options(folder), "--run", str(part))


def check_addresses(addresses: Addresses) -> None:
    """Raise `InputError` if only one of the two devices that a poke needs is named, or an address has an unknown form."""
    # A rig with a tool may have no sensor: the scene tells (`check_streams`).
    if addresses and not ((addresses.wrench or addresses.tool) and addresses.skin):
        if addresses.tool:
            raise InputError("No address for the skin. A poke needs the skin and the tool's poses: enter both, or none.")
        missing = "force/torque sensor" if not addresses.wrench else "skin"
        raise InputError(f"No address for the {missing}. A poke needs force/torque sensor and skin: enter both, or none.")
    if addresses:
        link_specs(addresses)


def check_streams(addresses: Addresses, scene: Scene) -> None:
    """Raise `InputError` if the devices do not fit where the scene's sensor sits: on the tool, or below the part."""
    from skincal.model.readings import Stream
    from skincal.session.tool_streams import check_tool_streams

    check_tool_streams(scene, {stream: getattr(addresses, stream.value) for stream in Stream})


def link_specs(addresses: Addresses) -> tuple[LinkSpec, ...]:
    """Make the links for addresses; see `describe_links`."""
    from skincal.model.readings import Stream
    from skincal.streams.links import describe_links

    named = {stream: getattr(addresses, stream.value) for stream in Stream}
    return describe_links({stream: address for stream, address in named.items() if address})


def addresses_of(links: Sequence[LinkSpec]) -> Addresses:
    """Give the address of each device that links read; none of a simulator that recorded a session."""
    named = {stream.value: link.address for link in links if not link.is_simulated for stream in link.carries}
    return Addresses(**named)


def dated_folder(parent: Path, now: datetime) -> Path:
    """Choose a folder for a new session, named by date and time, that does not exist."""
    name = now.strftime("%Y-%m-%d_%H-%M-%S")
    candidates = (parent / name, *(parent / f"{name}_{number}" for number in range(2, 1000)))
    return next(folder for folder in candidates if not folder.exists())


def begin_session(part: Part, links: Sequence[LinkSpec], folder: Path, truth: bytes) -> Pipeline:
    """Start a recording in a new folder.

    Parameters
    ----------
    truth : taxels of a simulated rig, saved next to the recording; empty for a real one

    Raises
    ------
    InputError
        The folder cannot be created or is not empty.
    """
    from skincal.files.atomic import write_atomically
    from skincal.files.reference import TRUTH_NAME
    from skincal.journal.writer import create_session
    from skincal.session.pipeline import Pipeline

    pipeline = Pipeline(part.scene, links, part.surface, create_session(folder, part.scene, links), part.laid)
    try:
        if truth:
            write_atomically(folder / TRUTH_NAME, truth)
    except InputError:
        pipeline.close()
        raise
    # The first snapshot visits every taxel: slow, and here it does not block the window.
    pipeline.snapshot()
    return pipeline


def is_shipped(path: Path) -> bool:
    """Whether a scene or a session is one of the program's own."""
    from skincal.model.scene import ships

    return ships(path)


def open_recorded(folder: Path, links: Sequence[LinkSpec] | None) -> tuple[Part, Pipeline]:
    """Open a recorded session to continue it, or read-only if `links` is `None`.

    Parameters
    ----------
    links : source of new readings; empty for the links of the recording

    Raises
    ------
    InputError
        The folder is no session.
    """
    from skincal.part.part import lay_part
    from skincal.session.replay import load, resume

    pipeline = load(folder) if links is None else resume(folder, links or None)
    pipeline.snapshot()
    part = lay_part(pipeline.scene, pipeline.session.surface, pipeline.findings)
    pipeline.laid = part.laid
    return part, pipeline
