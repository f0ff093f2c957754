"""A scene's files copied beside a session, so that it opens on another machine."""

from __future__ import annotations

import hashlib
import shutil
import tomllib
from pathlib import Path

from skincal.model.errors import InputError
from skincal.model.scene import Scene, load_scene

SCENE_FILE = "scene.toml"
SCENE_FOLDER = "scene"
"""The folder in a session's folder that holds its scene."""


def copy_scene(scene: Scene, folder: Path) -> Path:
    """Copy the scene file and the files it names into `folder`, and return the copy's path.

    The copy names its files by their bare names; all else in it stays as it was, word for word.

    Raises
    ------
    InputError
        A file cannot be read, or the copy does not read as the same scene.
    """
    text = scene.text or scene.path.read_text(encoding="utf-8")
    document = tomllib.loads(text)
    try:
        folder.mkdir(parents=True)
        for table, key in (("skin", "modules"), ("surface", "mesh")):
            named = document.get(table, {}).get(key)
            if named is not None:
                text = _copy_named(text, str(named), scene.path.parent, folder)
        target = folder / SCENE_FILE
        target.write_text(text, encoding="utf-8", newline="")
    except OSError as error:
        why = error.strerror
        raise InputError(f"{folder}: the scene cannot be copied ({why}); check {scene.path} and the space.") from None
    load_scene(target)
    return target


def _copy_named(text: str, named: str, source: Path, folder: Path) -> str:
    """Copy the file `named` in a scene and return the scene's text with its bare name."""
    bare = Path(named).name
    while (folder / bare).exists():
        bare = f"_{bare}"
    shutil.copyfile(source / named, folder / bare)
    if bare == named:
        return text
    for quote in ('"', "'"):
        text = text.replace(f"{quote}{named}{quote}", f"{quote}{bare}{quote}")
    return text


def scene_digest(folder: Path) -> str:
    """Return a checksum of a scene folder's own files, layout included; it changes when somebody edits one."""
    digest = hashlib.sha256()
    for path in sorted(folder.glob("*.toml")):
        text = path.read_bytes()
        digest.update(f"{path.name} {len(text)}\n".encode())
        digest.update(text)
    return digest.hexdigest()
