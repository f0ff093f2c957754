"""A part that is being described: one frozen value, its history, and the scene file that it is read from and written to.

Only changed entries of a file are written, so that comments, order and all other tables are kept.
"""

from __future__ import annotations

import contextlib
import os
from collections.abc import Generator, Mapping, MutableMapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, TypeAlias, cast

import numpy as np

from skincal.files.atomic import write_atomically
from skincal.geometry import FloatArray
from skincal.model.errors import InputError
from skincal.model.given import MAX_MESH_BYTES, read_regular
from skincal.model.scene import Scene, load_scene, ships
from skincal.model.skin import Anchor
from skincal.model.tables import Table, parse_toml
from skincal.model.urdf import read_urdf
from skincal.part.robot_copy import ROBOT_FOLDER, is_with_robot, list_robot_files, read_robot_files
from skincal.part.tool_draft import NO_TOOL, Pose, Rig, ToolDraft, Vector, read_tool_draft, tool_entries

IDENTITY_POSE: Pose = tuple(tuple(float(row == column) for column in range(4)) for row in range(4))
MM_DIGITS, UNIT_DIGITS, METRE_DIGITS = 3, 6, 6
"""Decimals in a scene file: a micrometre, and 0.06 thousandths of a degree."""
RAW_SKIN_UNIT = "raw"
UNDO_STEPS_MAX = 500
SCENE_FILE_COMMENT_COLUMN = 39
PARENT_FOLDERS_IN_RELATIVE_PATH_MAX = 3
"""A file further away is named by its whole path."""
LAYOUT_FILE = "modules.toml"
NEW_SCENE = "# A part and its skin; docs/scene.md says what else a scene can hold.\n"


@dataclass(frozen=True, slots=True)
class AnchorDraft:
    """Position of a layout, or of one module, on the part."""

    at_mm: Vector
    """(2,) point of the layout's plane."""
    point_mm: Vector
    """(3,) the same point, link frame."""
    x: Vector
    """(3,) unit, direction of the layout's x axis."""
    normal: Vector
    """(3,) unit, outward."""

    @staticmethod
    def from_anchor(anchor: Anchor) -> AnchorDraft:
        """Round an anchor to the digits of a scene file."""
        return AnchorDraft(
            rounded(anchor.at * 1e3, MM_DIGITS),
            rounded(anchor.point * 1e3, MM_DIGITS),
            rounded(anchor.x, UNIT_DIGITS),
            rounded(anchor.normal, UNIT_DIGITS),
        )

    def anchor(self) -> Anchor:
        """Anchor of the layout in metres and unit vectors."""
        x, normal = np.array(self.x), np.array(self.normal)
        return Anchor(
            np.array(self.at_mm) * 1e-3,
            np.array(self.point_mm) * 1e-3,
            x / np.linalg.norm(x),
            normal / np.linalg.norm(normal),
        )


@dataclass(frozen=True, slots=True)
class LandmarkDraft:
    """A known point of the part."""

    name: str
    place: Vector
    """(3,) metres, link frame."""
    normal: Vector | None = None
    """(3,) unit, outward."""


@dataclass(frozen=True, slots=True)
class PartDraft:
    """Description of a new part as a person enters it; immutable."""

    source: Path | None = None
    """Scene file that was opened; `None` for a new part."""
    text: str = NEW_SCENE
    """Of that file."""
    name: str = ""
    link: str = "part"
    urdf: Path | None = None
    sensor: str = ""
    """Force/torque sensor, joint or link of the URDF."""
    joints: tuple[str, ...] = ()
    """Columns of the joint stream, by joint name."""
    fixed: tuple[tuple[str, float], ...] = ()
    """Joints that are not streamed, and their angles in degrees."""
    packages: tuple[tuple[str, Path], ...] = ()
    copies_robot: bool = True
    """Saving a new scene copies the robot's files, unless they are moved together with the scene's folder anyway."""
    mesh: Path | None = None
    """Of a part without a URDF, or in place of the file that the URDF names."""
    unit: str = "mm"
    """Of the mesh; empty for the scale of the URDF's own mesh, as older scenes with a URDF have it."""
    is_unit_guessed: bool = False
    """The unit is guessed from the size of the mesh, and the operator has not chosen it yet."""
    mesh_pose: Pose | None = None
    """Of the mesh in the link; `None` for the identity, and with a URDF for the pose of the URDF's own mesh."""
    sensor_pose: Pose | None = None
    """Of the sensor in the link, without a URDF; `None` while it is unknown."""
    has_dh_arm: bool = False
    """The scene has an `[arm]`, which this page does not change."""
    rig: Rig = Rig.BELOW
    tool: ToolDraft = NO_TOOL
    """Kept while `rig` has no use for it."""
    sign: int | None = None
    """-1 if the sensor reports the reaction force; `None` for what the URDF says."""
    channels: int | None = None
    polarity: str = "up"
    axes: int = 1
    """Values of a taxel: 1, or 3 for a force vector."""
    skin_unit: str = ""
    """Unit of a skin of three axes, `"N"`; empty for raw values."""
    layout_text: str = ""
    """Of the layout file; empty without a layout."""
    layout_name: str = ""
    """Name of that file in the scene; empty before the first writing."""
    anchor: AnchorDraft | None = None
    landmarks: tuple[LandmarkDraft, ...] = ()
    response_min: float | None = None
    """Threshold of a taxel's answer, in the unit of the skin; `None` for the default."""
    taxels_max: int | None = None
    """Most taxels that a poke may press; `None` for the default."""


@dataclass(frozen=True, slots=True)
class DraftHistory:
    """Drafts before and after the present one."""

    past: tuple[PartDraft, ...] = ()
    now: PartDraft = PartDraft()
    future: tuple[PartDraft, ...] = ()
    merged: str = ""
    """Kind of the last change; changes of one kind in a row, such as the steps of a drag, are undone together."""

    def changed(self, draft: PartDraft, merge: str = "") -> DraftHistory:
        """Add a change; `merge` names a kind of change whose repetitions are one."""
        if draft == self.now:
            return self
        if merge and merge == self.merged:
            return replace(self, now=draft, future=())
        return DraftHistory((*self.past, self.now)[-UNDO_STEPS_MAX:], draft, (), merge)

    def saved_as(self, saved: PartDraft) -> DraftHistory:
        """Make `saved`, read from the written file, the present draft; earlier and later ones are changes of that file."""

        def rebase(draft: PartDraft) -> PartDraft:
            name = saved.layout_name if draft.layout_text else ""
            return replace(draft, source=saved.source, text=saved.text, layout_name=name)

        return DraftHistory(tuple(map(rebase, self.past)), saved, tuple(map(rebase, self.future)))

    def undone(self) -> DraftHistory:
        if not self.past:
            return self
        return DraftHistory(self.past[:-1], self.past[-1], (self.now, *self.future))

    def redone(self) -> DraftHistory:
        if not self.future:
            return self
        return DraftHistory((*self.past, self.now), self.future[0], self.future[1:])


def rounded(values: FloatArray, digits: int) -> Vector:
    """Round numbers for a file, without negative zeros."""
    return tuple(float(value) + 0.0 for value in np.round(values, digits) + 0.0)


def pose_rows(pose: FloatArray) -> Pose:
    """Round a (4, 4) pose, metres, for a file."""
    rotation, place = np.round(pose[:3, :3], 9) + 0.0, np.round(pose[:3, 3], METRE_DIGITS) + 0.0
    rows = [(*map(float, rotation[row]), float(place[row])) for row in range(3)]
    return (*rows, (0.0, 0.0, 0.0, 1.0))


def pushes_of(draft: PartDraft, frames: Sequence[FloatArray]) -> list[FloatArray]:
    """Take the value that a push changes from each frame of the skin: z of taxels of three axes, as the device sends it."""
    if draft.axes == 1:
        return list(frames)
    from skincal.model.skin_axes import read_axes  # other skins do without

    given = parse_toml(draft.text, draft.source or Path(LAYOUT_FILE)).get("skin", {})
    table = {key: given[key] for key in ("order", "values") if key in given}
    axes = read_axes(Table({"axes": draft.axes, **table}, "[skin]"), 1)
    assert axes is not None
    return [axes.by_taxel(frame)[:, axes.places[2]] for frame in frames]


def open_draft(path: Path) -> PartDraft:
    """Read a scene file, to change it.

    Raises InputError: it is no scene.
    """
    scene = load_scene(path)
    return _draft_of(scene, parse_toml(scene.text, path), path)


def _draft_of(scene: Scene, document: dict[str, Any], path: Path) -> PartDraft:
    skin, robot = document["skin"], document.get("robot", {})
    surface, folder = document.get("surface", {}), path.parent
    mesh = surface.get("mesh", robot.get("mesh"))
    mesh_pose = _rows(surface.get("pose"))
    if robot and surface and mesh_pose is None:
        mesh_pose = IDENTITY_POSE
    layout = scene.skin.layout
    rig, tool = read_tool_draft(
        None if "tool" not in document else {key: _frozen(value) for key, value in document["tool"].items()}
    )
    return PartDraft(
        source=path,
        text=scene.text,
        name=scene.name,
        link=scene.link,
        urdf=folder / robot["urdf"] if "urdf" in robot else None,
        sensor=robot.get("sensor", ""),
        joints=tuple(robot.get("joints", ())),
        fixed=tuple((name, float(angle)) for name, angle in robot.get("fixed", {}).items()),
        packages=tuple((name, folder / where) for name, where in robot.get("packages", {}).items()),
        mesh=None if mesh is None else folder / mesh,
        unit=surface.get("unit", robot.get("unit", "" if "mesh" in robot else "mm")),
        mesh_pose=mesh_pose,
        sensor_pose=_rows(document.get("sensor", {}).get("pose")),
        has_dh_arm="arm" in document,
        rig=rig,
        tool=tool,
        sign=document.get("wrench", {}).get("sign"),
        channels=scene.skin.channels,
        polarity=skin.get("polarity", "up"),
        axes=skin.get("axes", 1),
        skin_unit="N" if skin.get("unit") == "N" else "",
        layout_text="" if layout is None else layout.text,
        layout_name=skin.get("modules", ""),
        anchor=_read_anchor(skin["anchor"]) if "anchor" in skin else None,
        landmarks=tuple(map(_read_landmark, document.get("landmarks", ()))),
        response_min=document.get("contacts", {}).get("response_min"),
        taxels_max=document.get("contacts", {}).get("taxels_max"),
    )


def _vector(values: Any) -> Vector:
    return tuple(float(value) for value in values)


def _rows(values: Any) -> Pose | None:
    return None if values is None else tuple(_vector(row) for row in values)


def _read_anchor(table: Any) -> AnchorDraft:
    return AnchorDraft(*(_vector(table[key]) for key in ("at_mm", "point_mm", "x", "normal")))


# What a file says, as the path of each entry and its value.

Key: TypeAlias = tuple[str, ...]
_ENTRY_COMMENTS: dict[Key, str] = {
    ("name",): "names the part in exported files",
    ("link",): "the frame of every position",
    ("robot", "sensor"): "a force/torque sensor of the URDF, or a joint or link at it",
    ("robot", "joints"): "columns of the joint stream",
    ("robot", "fixed"): "joints that are not streamed, degrees",
    ("robot", "mesh"): "in place of the file that the URDF names",
    ("robot", "unit"): "of the mesh's numbers",
    ("surface", "unit"): "of the mesh's numbers",
    ("sensor",): "pose of the force/torque sensor in the link, metres",
    ("skin", "channels"): "number of taxels",
    ("skin", "axes"): "x, y and z of each taxel: a skin frame has three values for each",
    ("skin", "unit"): '"N" if these values are newtons, else "raw"',
    ("skin", "modules"): "the layout of the modules",
    ("skin", "anchor"): "position of the layout on the part",
    ("skin", "anchor", "at_mm"): "a point of the layout",
    ("skin", "anchor", "point_mm"): "and where it is, link frame",
    ("skin", "anchor", "x"): "direction of the layout's x axis",
    ("skin", "anchor", "normal"): "outward",
    ("contacts", "response_min"): "a taxel answers above it, in the unit of the skin",
    ("contacts", "taxels_max"): "a poke that presses more is rejected",
    ("wrench", "sign"): "-1 if the sensor reports the reaction force",
    ("tool", "sensor"): '"tool": the sensor is on the tool; "none": there is none',
    ("tool", "rotation"): "form of the poses",
    ("tool", "unit"): "of their lengths",
    ("tool", "tip_mm"): "in the frame whose pose is streamed",
    ("tool", "flange"): "pose of the sensor in that frame, metres",
}
_PATH_KEYS = (("robot", "urdf"), ("robot", "mesh"), ("surface", "mesh"))
_POLARITY_ENTRY_COMMENTS = {"up": "raw values rise under pressure", "down": "raw values fall under pressure"}


def _entries(draft: PartDraft, folder: Path) -> dict[Key, Any]:
    """List the entries of the scene file for a draft that is saved in `folder`; entries without a value are left out.

    A file that the opened text names in another way, such as `./part.stl`, keeps that name.
    """
    entries = _values(draft, folder)
    if draft.source is not None and draft.source.parent.resolve() == folder.resolve():
        for key, value in _entries_of_text(draft).items():
            is_path = key in _PATH_KEYS or key[:2] == ("robot", "packages")
            if is_path and key in entries and (folder / value).resolve() == (folder / entries[key]).resolve():
                entries[key] = value
    if ("surface", "mesh") in entries and _entries_of_text(draft).get(("surface", "pose")) == IDENTITY_POSE:
        entries.setdefault(("surface", "pose"), IDENTITY_POSE)
    return entries


def _values(draft: PartDraft, folder: Path) -> dict[Key, Any]:
    entries: dict[Key, Any] = {("name",): draft.name, ("link",): draft.link}
    if draft.urdf is not None:
        entries |= _robot_entries(draft, draft.urdf, folder)
    if draft.mesh is not None and (draft.urdf is None or draft.mesh_pose is not None):
        entries[("surface", "mesh")] = _named(draft.mesh, folder)
        entries[("surface", "unit")] = draft.unit
        entries[("surface", "pose")] = None if draft.mesh_pose == IDENTITY_POSE else draft.mesh_pose
    if draft.urdf is None and draft.rig is Rig.BELOW:
        entries[("sensor", "pose")] = draft.sensor_pose
    entries |= tool_entries(draft.rig, draft.tool)
    entries[("skin", "channels")] = draft.channels
    entries[("skin", "polarity")] = draft.polarity
    entries[("skin", "axes")] = draft.axes if draft.axes != 1 else None
    entries[("skin", "unit")] = (draft.skin_unit or RAW_SKIN_UNIT) if draft.axes != 1 else None
    if draft.layout_text:
        entries[("skin", "modules")] = draft.layout_name or LAYOUT_FILE
    if draft.anchor is not None:
        for key in ("at_mm", "point_mm", "x", "normal"):
            entries[("skin", "anchor", key)] = getattr(draft.anchor, key)
    entries[("wrench", "sign")] = None if draft.rig is Rig.NONE else draft.sign
    entries[("contacts", "response_min")] = draft.response_min
    entries[("contacts", "taxels_max")] = draft.taxels_max
    return {key: value for key, value in entries.items() if value is not None}


def _robot_entries(draft: PartDraft, urdf: Path, folder: Path) -> dict[Key, Any]:
    entries: dict[Key, Any] = {("robot", "urdf"): _named(urdf, folder)}
    if draft.rig is Rig.BELOW:
        entries[("robot", "sensor")] = draft.sensor
    if draft.mesh is not None and draft.mesh_pose is None:
        entries[("robot", "mesh")] = _named(draft.mesh, folder)
        entries[("robot", "unit")] = draft.unit or None
    if draft.rig is Rig.BELOW:
        entries[("robot", "joints")] = draft.joints or None
        entries |= {("robot", "fixed", name): angle for name, angle in draft.fixed}
    return entries | {("robot", "packages", name): _named(path, folder) for name, path in draft.packages}


def scene_text(draft: PartDraft, folder: Path, comments: Mapping[Key, str] | None = None) -> str:
    """Write the scene file of a draft, for `folder`: the text that was opened, with the changes in it.

    `comments` replace the usual comments on new entries and tables.

    Raises InputError: the file is written in a way that can be read, but not changed.
    """
    import tomlkit
    from tomlkit.exceptions import TOMLKitError

    before, after = _entries_of_text(draft), _entries(draft, folder)
    has_landmark_change = draft.landmarks != _landmarks_of_text(draft)
    if before == after and not has_landmark_change:
        return draft.text
    try:
        document = cast("Any", tomlkit.parse(draft.text))
        for key in before.keys() - after.keys():
            _remove(document, key)
        for key, value in after.items():
            if before.get(key) != value:
                _set_entry(document, key, value, {**_ENTRY_COMMENTS, **(comments or {})})
        if has_landmark_change:
            _put_landmarks(document, draft.landmarks)
        text = str(tomlkit.dumps(document))
    except (TOMLKitError, KeyError, TypeError, AttributeError) as error:
        raise InputError(f"{draft.source}: the scene cannot be changed here ({error}); edit the file.") from None
    _require_same(draft, text, folder)
    return text


def _entries_of_text(draft: PartDraft) -> dict[Key, Any]:
    """List what the opened text says, in the values of a draft; empty for a new part."""
    if draft.source is None:
        return {}
    document = parse_toml(draft.text, draft.source)
    found: dict[Key, Any] = {}
    for key in _all_keys(document):
        value: Any = document
        for name in key:
            value = value[name]
        if value != []:
            found[key] = _frozen(value)
    if "skin" in document:
        found.setdefault(("skin", "polarity"), "up")  # the default
        if found.get(("skin", "axes")) == 1:
            del found["skin", "axes"]  # the default
        if ("skin", "axes") in found:
            found.setdefault(("skin", "unit"), RAW_SKIN_UNIT)  # the default
    return found


def _all_keys(document: dict[str, Any]) -> list[Key]:
    """List the entries of a document that a draft knows."""
    known = [("name",), ("link",), ("skin", "channels"), ("skin", "polarity"), ("skin", "modules"), ("wrench", "sign")]
    known += [("contacts", "response_min"), ("contacts", "taxels_max"), ("skin", "axes"), ("skin", "unit")]
    known += [("surface", key) for key in ("mesh", "unit", "pose")] + [("sensor", "pose")]
    known += [("tool", key) for key in document.get("tool", {})]
    known += [("robot", key) for key in ("urdf", "sensor", "mesh", "unit", "joints")]
    known += [("skin", "anchor", key) for key in ("at_mm", "point_mm", "x", "normal")]
    for table in ("fixed", "packages"):
        known += [("robot", table, name) for name in document.get("robot", {}).get(table, {})]
    return [key for key in known if _has(document, key)]


def _has(document: Any, key: Key) -> bool:
    for name in key:
        if not isinstance(document, dict) or name not in document:
            return False
        document = cast("dict[str, Any]", document)[name]
    return True


def _frozen(value: Any) -> Any:
    """Convert lists to tuples and their whole numbers to floats, as a draft holds them."""
    if isinstance(value, list):
        return tuple(
            float(each) if isinstance(each, int) and not isinstance(each, bool) else _frozen(each)
            for each in cast("list[Any]", value)
        )
    return value


def _landmarks_of_text(draft: PartDraft) -> tuple[LandmarkDraft, ...]:
    if draft.source is None:
        return ()
    return tuple(map(_read_landmark, parse_toml(draft.text, draft.source).get("landmarks", ())))


def _remove(document: Any, key: Key) -> None:
    """Remove an entry, and the tables that are empty without it."""
    tables = [document]
    for name in key[:-1]:
        tables.append(tables[-1][name])
    del tables[-1][key[-1]]
    for table, name in zip(reversed(tables[:-1]), reversed(key[:-1]), strict=True):
        if len(table[name]) == 0:
            del table[name]


def _set_entry(document: Any, key: Key, value: Any, comments: Mapping[Key, str]) -> None:
    """Set an entry; new tables and entries get their comment."""
    import tomlkit

    table: MutableMapping[str, Any] = document
    for depth, name in enumerate(key[:-1], start=1):
        if name not in table:
            fresh = tomlkit.table()
            if (comment := comments.get(key[:depth])) is not None and depth + 1 >= len(key):
                fresh.comment(comment)
            if depth == 1:
                cast("Any", table).add(tomlkit.nl())
            table[name] = fresh
        table = table[name]
    is_new = key[-1] not in table
    item = cast("Any", tomlkit.item(_plain(value)))
    comment = _POLARITY_ENTRY_COMMENTS.get(str(value)) if key == ("skin", "polarity") else comments.get(key)
    if comment is not None and (is_new or key == ("skin", "polarity")):
        _set_comment(key[-1], item, comment)
    elif not is_new:
        item.trivia.comment_ws, item.trivia.comment = _trivia_of(table[key[-1]])
    table[key[-1]] = item


def _trivia_of(item: Any) -> tuple[str, str]:
    trivia = getattr(item, "trivia", None)
    return ("", "") if trivia is None else (trivia.comment_ws, trivia.comment)


def _set_comment(key: str, item: Any, comment: str) -> None:
    item.comment(comment)
    item.trivia.comment_ws = " " * max(2, SCENE_FILE_COMMENT_COLUMN - len(f"{key} = {item.as_string()}"))


def _plain(value: Any) -> Any:
    """Convert tuples to lists, and their whole numbers to integers, which are easier to read."""
    if isinstance(value, tuple):
        return [
            int(each) if isinstance(each, float) and each.is_integer() else _plain(each)
            for each in cast("tuple[Any, ...]", value)
        ]
    return value


def _put_landmarks(document: Any, landmarks: tuple[LandmarkDraft, ...]) -> None:
    """Change the landmarks; a table whose landmark is unchanged stays, with its comments."""
    import tomlkit

    array: Any = document.get("landmarks")
    if array is None:
        array = tomlkit.aot()
    before = [_read_landmark(table) for table in array]
    if len(before) == len(landmarks) and sum(old != new for old, new in zip(before, landmarks, strict=True)) == 1:
        index = next(index for index, (old, new) in enumerate(zip(before, landmarks, strict=True)) if old != new)
        _fill_landmark(array[index], landmarks[index])
        return
    stay = [mark in landmarks for mark in before]
    kept = [mark for mark in before if mark in landmarks]
    if tuple(kept) != landmarks[: len(kept)]:  # in another order: all are written again
        stay, kept = [False] * len(array), []
    for index in reversed(range(len(array))):
        if not stay[index]:
            del array[index]
    for mark in landmarks[len(kept) :]:
        if len(array) and "landmarks" in document:
            array[-1].add(tomlkit.nl())
        table = tomlkit.table()
        _fill_landmark(table, mark)
        array.append(table)
    if not landmarks:
        document.pop("landmarks", None)
    elif "landmarks" not in document:
        document.add(tomlkit.nl())
        document["landmarks"] = array


def _read_landmark(table: Any) -> LandmarkDraft:
    return LandmarkDraft(str(table["name"]), _vector(table["place"]), _vector(table["normal"]) if "normal" in table else None)


def _fill_landmark(table: Any, mark: LandmarkDraft) -> None:
    is_new = "place" not in table
    table["name"] = mark.name
    table["place"] = _plain(mark.place)
    if is_new:
        _set_comment("place", table["place"], "m, link frame")
    if mark.normal is not None:
        table["normal"] = _plain(mark.normal)
    else:
        table.pop("normal", None)


def _require_same(draft: PartDraft, text: str, folder: Path) -> None:
    """Refuse a text that would be read as something else than the draft."""
    wrote = replace(draft, text=text, source=draft.source or folder / "scene.toml")
    if _entries_of_text(wrote) != _entries(draft, folder) or _landmarks_of_text(wrote) != draft.landmarks:
        raise InputError(f"{folder}: the scene would not be read as it was meant; edit the file by hand.")


def save_draft(draft: PartDraft, path: Path, comments: Mapping[Key, str] | None = None) -> PartDraft:
    """Write the scene file, and its layout; copy mesh and robot into the folder. Return the draft of that file.

    Nothing is written if the file says the same already. `comments` replace the usual ones on new entries and tables.

    Raises
    ------
    InputError
        The file is another scene or ships with the program, it cannot be written, or it could not be loaded.
    """
    is_same = draft.source is not None and path.resolve() == draft.source.resolve()
    if ships(path):
        raise InputError(f"{path}: is part of skincal and is not changed; choose another folder.")
    if path.exists() and not is_same:
        raise InputError(f"{path}: is there already; choose another folder.")
    folder = path.parent
    draft, made = _with_copies(draft, folder, open_draft(path) if is_same else PartDraft())
    if draft.layout_text:
        name = draft.layout_name if is_same and draft.layout_name else LAYOUT_FILE
        made[folder / name] = draft.layout_text.encode()
        draft = replace(draft, layout_name=name)
    taken = [file for file, data in made.items() if not is_same and file.exists() and file.read_bytes() != data]
    if taken:
        raise InputError(f"{taken[0]}: another file of this name is there already; choose another folder.")
    made[path] = scene_text(draft, folder, comments).encode()
    with _fresh_folders({file.parent for file in made}):
        try:
            for file in made:
                file.parent.mkdir(parents=True, exist_ok=True)
        except OSError as error:
            raise InputError(f"{folder}: cannot be made ({error.strerror}); choose another folder.") from None
        _write_all(made, path, is_change=is_same)
        return open_draft(path)


def save_tool(path: Path, changed: Mapping[str, Any]) -> None:
    """Write changed fields of a `ToolDraft` into a scene file, and nothing else. Raises InputError as `save_draft`."""
    draft = open_draft(path)
    save_draft(replace(draft, tool=replace(draft.tool, **changed)), path)


@contextlib.contextmanager
def _fresh_folders(folders: set[Path]) -> Generator[None]:
    """Remove those folders, and the ones above them, that were not there before, if what follows is refused."""
    above = {parent for folder in folders for parent in (folder, *folder.parents)}
    fresh = sorted((folder for folder in above if not folder.exists()), key=lambda folder: len(folder.parts), reverse=True)
    try:
        yield
    except InputError:
        for folder in fresh:
            with contextlib.suppress(OSError):
                folder.rmdir()
        raise


def _with_copies(draft: PartDraft, folder: Path, before: PartDraft) -> tuple[PartDraft, dict[Path, bytes]]:
    """Copy what the draft names for the first time: its mesh, and its robot. Return the draft that names the copies."""
    made: dict[Path, bytes] = {}
    urdf, mesh = draft.urdf, draft.mesh
    copies_robot = urdf is not None and urdf != before.urdf and copies_to(draft, folder)
    if copies_robot and urdf is not None:
        home = folder / ROBOT_FOLDER
        files = list_robot_files(read_urdf(urdf), dict(draft.packages))
        made = {home / inside: data for inside, data in read_robot_files(files).items()}
        draft = replace(draft, urdf=home / urdf.name, packages=())
    if (
        mesh is not None
        and mesh != before.mesh
        and (urdf is None or copies_robot)
        and mesh.resolve().parent != folder.resolve()
    ):
        target = folder / mesh.name
        made[target] = read_regular(mesh, MAX_MESH_BYTES)
        draft = replace(draft, mesh=target)
    return draft, made


def copies_to(draft: PartDraft, folder: Path) -> bool:
    """Whether a scene that is saved in `folder` gets a copy of the robot."""
    return draft.urdf is not None and draft.copies_robot and not is_with_robot(draft.urdf, folder)


def _write_all(files: dict[Path, bytes], scene: Path, *, is_change: bool) -> None:
    """Write changed files; if the scene cannot be loaded then, restore the old ones.

    A change may be that of a session's own scene.
    """
    old = {file: file.read_bytes() if file.exists() else None for file in files}
    for file, before in old.items():
        if before is not None and b"\r\n" in before:  # of Windows
            files[file] = files[file].replace(b"\r\n", b"\n").replace(b"\n", b"\r\n")
    changed = [file for file, data in files.items() if old[file] != data]
    try:
        for file in changed:
            backup = write_atomically(file, files[file], changes_session_scene=is_change)
            if backup is not None:
                backup.unlink()
        load_scene(scene)
    except InputError:
        for file in changed:
            before = old[file]
            file.unlink(missing_ok=True) if before is None else file.write_bytes(before)
        raise


def _named(path: Path, folder: Path) -> str:
    """Name a file relative to the scene's folder if it is near, else by its whole path."""
    whole = path.resolve()
    try:
        relative = Path(os.path.relpath(whole, folder.resolve()))
    except ValueError:  # another drive of Windows
        return whole.as_posix()
    return (whole if relative.parts.count("..") > PARENT_FOLDERS_IN_RELATIVE_PATH_MAX else relative).as_posix()


def free_scene_path(scenes: Path, name: str) -> Path:
    """Find a scene file in a new folder of `scenes`, named after the part."""
    plain = "".join(letter if letter.isalnum() or letter in "-_ ." else "-" for letter in name).strip(" .") or "part"
    folders = (scenes / (plain if number == 1 else f"{plain}-{number}") for number in range(1, 10_000))
    return next(folder for folder in folders if not folder.exists()) / "scene.toml"


def layout_file_of(draft: PartDraft) -> Path:
    """Give the path that sentences about the layout name."""
    folder = Path() if draft.source is None else draft.source.parent
    return folder / (draft.layout_name or LAYOUT_FILE)
