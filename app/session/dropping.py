"""What becomes of files and folders that are dropped onto the window: opened, or a sentence on what to do with them. No Qt."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from app.session.opening import OpenRequest, server_command
from skincal.model.errors import InputError

MESHES = (".stl", ".obj", ".ply", ".off")
EXPECTED = "drop the folder of a session, or a scene (*.toml)."


def request_of(paths: Sequence[Path]) -> OpenRequest:
    """Return what to open for what was dropped: a recorded session, or a scene with a simulated rig.

    Raises
    ------
    InputError
        It cannot be opened; the sentence says what to do with it.
    """
    if len(paths) != 1:
        raise InputError(f"{len(paths)} files were dropped that lie on this machine; expected one: {EXPECTED}")
    path = paths[0]
    try:
        return _request_of(path)
    except OSError as error:
        raise InputError(f"{path}: cannot be looked at ({error.strerror}); check its rights.") from None


def _request_of(path: Path) -> OpenRequest:
    if path.is_dir():
        return _request_of_folder(path)
    if not path.is_file():
        raise InputError(f"{path}: there is no such file; {EXPECTED}")
    kind = path.suffix.lower()
    if kind == ".toml":
        return OpenRequest(scene=path, server=server_command(path))
    if kind in MESHES:
        raise InputError(f'{path}: is a mesh. Name it in a scene (mesh = "{path.name}" below [surface]) and drop that.')
    if kind in (".csv", ".tsv", ".log"):
        raise InputError(f"{path}: is a table. {_import_words('csv')}; known places are shown by Session > Compare with.")
    raise InputError(f"{path}: is nothing that can be opened; {EXPECTED}")


def _request_of_folder(folder: Path) -> OpenRequest:
    from skincal.files.importers.yarp_folder import DATA
    from skincal.journal.writer import SCENE_FILE, SCENE_FOLDER

    if (folder / SCENE_FOLDER / SCENE_FILE).is_file():
        return OpenRequest(session=folder)
    # A port has a folder; no deeper, since it may be a whole disk that was dropped.
    if any(next(folder.glob(pattern), None) is not None for pattern in (DATA, f"*/{DATA}", f"*/*/{DATA}")):
        raise InputError(f"{folder}: is a recording of yarpdatadumper. {_import_words('yarp')}.")
    raise InputError(f"{folder}: is not the folder of a session; {EXPECTED}")


def _import_words(kind: str) -> str:
    return (
        f"Recordings of sensor and skin become a session by `skincal import {kind} --wrench WRENCH --skin SKIN "
        "--scene SCENE --out FOLDER`, which can be dropped then"
    )
