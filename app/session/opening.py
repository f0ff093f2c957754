"""What to open, and the work of opening it: a scene with links or with a process that serves them, or a recorded session.

No Qt. What takes long runs beside the window; the imports stand inside the functions so that they do, too.
"""

from __future__ import annotations

import sys
from collections.abc import Sequence
from dataclasses import dataclass, replace
from datetime import datetime
from pathlib import Path
from typing import TYPE_CHECKING

from skincal.model.errors import InputError

if TYPE_CHECKING:
    from skincal.files.reference import TaxelPositions
    from skincal.session.part import Part
    from skincal.session.pipeline import Pipeline
    from skincal.streams.links import LinkSpec

DEFAULT_SCENE = "icub-forearm"
MESHES = (".stl", ".obj", ".ply", ".off")


@dataclass(frozen=True, slots=True)
class Addresses:
    """Where the devices are, as the user wrote it; empty where there is none."""

    wrench: str = ""
    skin: str = ""
    joints: str = ""

    def __bool__(self) -> bool:
        """Return whether any device is named."""
        return bool(self.wrench or self.skin or self.joints)


@dataclass(frozen=True, slots=True)
class OpenRequest:
    """What to open; `session` goes before everything else."""

    scene: Path | None = None
    session: Path | None = None
    mesh: Path | None = None
    """Of a part of which nothing else is known."""
    addresses: Addresses = Addresses()
    server: tuple[str, ...] = ()
    """A command that prints its links and serves them; used where no address is given."""
    folder: Path | None = None
    """Folder of the new session; `None` for a dated one, which the window offers to discard when it closes."""
    targets: str = ""
    """Where a robot is asked for pokes, `[HOST:]PORT`; empty: nowhere."""
    demo: bool = False
    """To look at: the simulated operator is brisk, a newcomer is told what matters, and the verdict comes by itself."""

    pose: str = ""
    """Name of the arm pose in which a new session begins; empty where nobody said."""

    look_on: bool = False
    """See the session as far as it is written, and change nothing in it: another process records it."""

    @property
    def copied(self) -> bool:
        """Whether a copy of the session is opened: one that ships is never written into."""
        from skincal.model.scene import ships

        return self.session is not None and not self.look_on and ships(self.session)


def find_scene(scene: Path | None) -> Path:
    """Return a scene's file: as given, by the name of one that ships, or the one that opens by default."""
    from skincal.model.scene import scene_file

    return scene_file(Path(DEFAULT_SCENE) if scene is None else scene)


def server_command(scene: Path | None) -> tuple[str, ...]:
    """Return the command of the process that serves a rig for a scene, by default the usual one, over TCP.

    Its operator pokes what the window asks for, over a port that the window names when it starts it.
    """
    name = DEFAULT_SCENE if scene is None else str(scene)
    # A frozen program takes the commands itself. -P: nothing that lies in the working folder is imported.
    program = () if getattr(sys, "frozen", False) else ("-P", "-m", "skincal.cli")
    return (sys.executable, *program, "simulate", "--serve", "--tcp", "--operator", "guided", "--scene", name, "--json")


def rig_again(folder: Path, run: int) -> tuple[str, ...]:
    """Return the command that serves the simulated rig of a recorded session again; empty where a real one was recorded.

    Parameters
    ----------
    run : another number than before, or the operator's hand and the sensor's noise would repeat themselves
    """
    from skincal.files.reference import RIG_KEY, TRUTH_NAME
    from skincal.journal.writer import SCENE_FILE, SCENE_FOLDER
    from skincal.model.given import MAX_JSON_BYTES, parse_json, read_regular

    try:
        rig = parse_json(read_regular(folder / TRUTH_NAME, MAX_JSON_BYTES))[RIG_KEY]
        seed, errors = rig["seed"], rig["errors"]
    except (InputError, ValueError, KeyError, TypeError):
        return ()
    if not isinstance(seed, int) or seed < 0 or errors not in ("none", "noise", "paper"):
        return ()
    command = server_command(folder / SCENE_FOLDER / SCENE_FILE)
    return (*command, "--seed", str(seed), "--errors", errors, "--run", str(run))


def check_addresses(addresses: Addresses) -> None:
    """Raise `InputError` where some device is named, but not both that a poke needs, or by an address that is not known."""
    if addresses and not (addresses.wrench and addresses.skin):
        missing = "wrench" if not addresses.wrench else "skin"
        raise InputError(f"No {missing} device is named; expected the addresses of both the wrench and the skin, or of none.")
    if addresses:
        link_specs(addresses)


def link_specs(addresses: Addresses) -> tuple[LinkSpec, ...]:
    """Return the links for addresses; see `describe_links`."""
    from skincal.model.readings import Stream
    from skincal.streams.links import describe_links

    named = {Stream.WRENCH: addresses.wrench, Stream.SKIN: addresses.skin, Stream.JOINTS: addresses.joints}
    return describe_links({stream: address for stream, address in named.items() if address})


def addresses_of(links: Sequence[LinkSpec]) -> Addresses:
    """Return where each device is that links read."""
    named = {stream.value: link.address for link in links for stream in link.carries}
    return Addresses(**named)


def dated_folder(parent: Path, now: datetime) -> Path:
    """Return a folder for a new session, named by date and time, that does not exist yet."""
    name = now.strftime("%Y-%m-%d_%H-%M-%S")
    folder = parent / name
    number = 2
    while folder.exists():
        folder = parent / f"{name}_{number}"
        number += 1
    return folder


def begin_session(part: Part, links: Sequence[LinkSpec], folder: Path, truth: bytes) -> Pipeline:
    """Start a recording in a new folder.

    Parameters
    ----------
    truth : what a simulated rig says of its taxels, laid beside the recording; empty of a real rig

    Raises
    ------
    InputError
        The folder cannot be made, or there is something in it.
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
    # The first snapshot looks at every taxel and so takes long: here it does not hold the window.
    pipeline.snapshot()
    return pipeline


def load_mesh_part(mesh: Path, documents: Path) -> Part:
    """Load the scene of a part of which a mesh alone is known, among the documents; it says what is still missing.

    Raises
    ------
    InputError
        The mesh cannot be read, or the scene cannot be written.
    """
    from app.text.message import mesh_words
    from skincal.session.part import load_part, scene_of_mesh

    part = load_part(scene_of_mesh(mesh, documents / "scenes"))
    return replace(part, findings=(mesh_words(part), *part.findings))


def look_at(folder: Path) -> tuple[Part, Pipeline]:
    """Open a recorded session without touching it; `InputError` where the folder is no session."""
    from skincal.session.part import lay_part
    from skincal.session.replay import load

    pipeline = load(folder)
    pipeline.snapshot()
    part = lay_part(pipeline.scene, pipeline.session.surface, pipeline.findings)
    pipeline.laid = part.laid
    return part, pipeline


def resume_pipeline(folder: Path, links: Sequence[LinkSpec]) -> tuple[Part, Pipeline]:
    """Open a recorded session where it stopped.

    Parameters
    ----------
    links : where readings come from now; none for those of the recording

    Raises
    ------
    InputError
        The folder is no session.
    """
    from skincal.session.part import lay_part
    from skincal.session.replay import resume

    pipeline = resume(folder, links or None)
    pipeline.snapshot()
    part = lay_part(pipeline.scene, pipeline.session.surface, pipeline.findings)
    pipeline.laid = part.laid
    return part, pipeline


def find_truth_of(folder: Path, part: Part) -> TaxelPositions | None:
    """Return the truth that lies beside a recording; None where there is none."""
    from skincal.files.reference import find_truth

    return find_truth(folder, part.scene.link, part.channels.tolist())
