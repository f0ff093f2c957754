"""A scene: what there is to calibrate, read from a TOML file.

It decides which solvers, layers, panels and imports exist: what a scene does not have is None here and costs nothing.
The file's lengths are metres and its angles degrees unless the key ends in a unit; see `docs/scene.md`.
"""

from __future__ import annotations

from dataclasses import dataclass, field, fields
from pathlib import Path
from typing import Any

import numpy as np

from skincal.arm import Arm, DhLink
from skincal.errors import InputError
from skincal.readings import FloatArray
from skincal.skin import Anchor, Layout, load_layout, read_anchor, read_toml

UNITS = {"m": 1.0, "cm": 1e-2, "mm": 1e-3, "in": 25.4e-3}


@dataclass(frozen=True, slots=True)
class SkinSpec:
    """The skin's stream and, where the maker gives one, its layout."""

    channels: int
    """Width of a skin frame."""
    polarity: int
    """+1 where raw values rise under pressure, -1 where they fall."""
    layout: Layout | None
    anchor: Anchor | None
    """Where the layout lies on the part, as planned; None where unknown."""
    range: tuple[float, float] | None
    """Lowest and highest raw value of the device; a taxel that rests there is stuck."""


@dataclass(frozen=True, slots=True, eq=False)
class SurfaceSpec:
    """A mesh file and its place."""

    path: Path
    scale: float
    """Metres per unit of the file."""
    link_from_mesh: FloatArray
    """(4, 4) float, metres."""


@dataclass(frozen=True, slots=True)
class ContactSettings:
    """Thresholds of poke detection and of the gates; SI units."""

    force_min: float = 4.0
    """N. Below it the axis is too uncertain: its direction error is sd(f)/|f|, 1.4 degrees at 4 N and 0.1 N."""
    force_max: float = 15.0
    """N. Above it foam bottoms out and an operator's hand slides."""
    touch_force: float = 1.0
    """N. A poke begins above it: ten times a good sensor's noise (0.1 N)."""
    release_force: float = 0.6
    """N. A poke ends below it; lower than `touch_force` so that noise cannot end it."""
    still_s: float = 0.30
    """s. Length of the still window: 15 skin frames at 50 Hz."""
    still_change: float = 0.05
    """Largest relative spread (sd) of the force inside the still window."""
    slide_max: float = 0.0015
    """m. Largest travel of the force axis inside the still window, measured where the contact is."""
    pitch_max: float = 0.008
    """m. Largest |f . m|/|f|^2 (eq. 3): the 99th percentile of single contacts is 7.5 mm in simulation."""
    taxels_max: int = 6
    """Most taxels that may answer one poke: the default of the authors' own module (`skinCalibration`)."""
    response_min: float = 10.0
    """Raw units. The threshold delta: the authors' own module uses 10 of 255."""
    response_noises: float = 5.0
    """A taxel answers when also this many standard deviations of its own noise above its baseline."""
    quiet_s: float = 0.20
    """s. Length of a quiet window for the tare: 10 skin frames at 50 Hz."""
    tare_change_max: float = 1.0
    """N. Largest difference of the tares before and after a poke; beyond it the sensor drifted or something leaned."""
    gap_factor: float = 1.6
    """Neighbours answer together when they are nearer than this many spacings of the layout."""


@dataclass(frozen=True, slots=True)
class NoiseSettings:
    """The rig's noise per averaged poke, for predicted uncertainty; SI units."""

    force: float = 0.10
    """N, sd of each force component: the standard case of the guidance study."""
    moment: float = 0.010
    """N m, sd of each moment component: same source; the FT45 resolves 0.005 N m."""
    contact: float = 0.002
    """m, sd of the contact about the taxel in each tangent direction: half the 4 mm tip."""


@dataclass(frozen=True, slots=True)
class ArmSpec:
    """The chain between sensor and link, and the poses that have a name."""

    arm: Arm
    poses: dict[str, FloatArray]
    """Name to (joints,) float, radians; may be empty where the joints are streamed."""
    tolerance: float = float(np.radians(0.5))
    """rad. Streamed joints that move more than this during a poke reject it."""


@dataclass(frozen=True, slots=True)
class Scene:
    """What there is to calibrate."""

    name: str
    link: str
    """Frame in which every position is given, here and in every exported file."""
    skin: SkinSpec
    surface: SurfaceSpec | None
    arm: ArmSpec | None
    sensor_pose: FloatArray
    """(4, 4) float: pose of the sensor in the link frame where there is no arm; the identity unless given."""
    wrench_sign: int
    """-1 where the sensor reports the reaction."""
    contacts: ContactSettings
    noise: NoiseSettings
    path: Path
    """The scene file; relative paths in it start from its folder."""
    text: str = field(repr=False, default="")
    """The file's text, kept in every session."""


class _Table:
    """A TOML table that names what it misses and what it does not know."""

    def __init__(self, values: dict[str, Any], where: str) -> None:
        self.values = dict(values)
        self.where = where

    def take(self, key: str, kind: type, default: Any = ...) -> Any:
        if key not in self.values:
            if default is ...:
                raise InputError(f"{self.where}: {key} is missing; expected {_name(kind)}.")
            return default
        value = self.values.pop(key)
        if kind is float and isinstance(value, int) and not isinstance(value, bool):
            value = float(value)
        if not isinstance(value, kind) or (isinstance(value, bool) and kind is not bool):
            raise InputError(f"{self.where}: {key} is {value!r}; expected {_name(kind)}.")
        return value

    def array(self, key: str, shape: tuple[int | None, ...], default: Any = ...) -> Any:
        value = self.take(key, list, default)
        if value is default:
            return default
        wanted = " x ".join("n" if size is None else str(size) for size in shape)
        try:
            array = np.array(value, dtype=float)
        except (TypeError, ValueError):
            array = np.empty(0)
        fits = array.ndim == len(shape) and all(s in (None, n) for s, n in zip(shape, array.shape, strict=True))
        if not fits or not np.isfinite(array).all():
            raise InputError(f"{self.where}: {key} is {value!r}; expected {wanted} finite numbers.")
        return array

    def choice(self, key: str, known: dict[str, Any], default: Any = ...) -> Any:
        value = self.take(key, str, default)
        if value is default:
            return default
        if value not in known:
            raise InputError(f"{self.where}: {key} is {value!r}; expected one of {', '.join(known)}.")
        return known[value]

    def table(self, key: str) -> _Table | None:
        values = self.take(key, dict, None)
        return None if values is None else _Table(values, f"{self.where}: [{key}]")

    def done(self) -> None:
        if self.values:
            raise InputError(f"{self.where}: unknown name {sorted(self.values)[0]!r}; check its spelling.")


def _name(kind: type) -> str:
    return {str: "text", int: "a whole number", float: "a number", list: "a list", dict: "a table", bool: "true or false"}[kind]


def load_scene(path: Path) -> Scene:
    """Read a scene file and the layout it names; the mesh is left to `skincal.surface`, which costs more.

    Parameters
    ----------
    path : a `*.toml` file

    Raises
    ------
    InputError
        Names the file, the key, what was seen and what was expected.
    """
    root = _Table(read_toml(path), str(path))
    text = path.read_text(encoding="utf-8")
    skin = root.table("skin")
    if skin is None:
        raise InputError(f"{path}: [skin] is missing; expected a table with at least channels.")
    surface, arm, sensor = root.table("surface"), root.table("arm"), root.table("sensor")
    wrench, contacts, noise = root.table("wrench"), root.table("contacts"), root.table("noise")
    if arm is not None and sensor is not None:
        raise InputError(f"{path}: [arm] and [sensor] exclude each other; the arm already places the sensor.")
    scene = Scene(
        name=root.take("name", str),
        link=root.take("link", str),
        skin=_read_skin(skin, path),
        surface=None if surface is None else _read_surface(surface, path),
        arm=None if arm is None else _read_arm(arm),
        sensor_pose=np.eye(4) if sensor is None else _read_pose(sensor, "pose"),
        wrench_sign=1 if wrench is None else _read_sign(wrench),
        contacts=_read_settings(contacts, ContactSettings),
        noise=_read_settings(noise, NoiseSettings),
        path=path,
        text=text,
    )
    for part in (root, skin, surface, arm, sensor, wrench, contacts, noise):
        if part is not None:
            part.done()
    return scene


def _read_skin(table: _Table, path: Path) -> SkinSpec:
    channels = table.take("channels", int)
    if not 1 <= channels <= 100_000:
        raise InputError(f"{table.where}: channels is {channels}; expected 1 to 100000.")
    modules = table.take("modules", str, None)
    layout = None if modules is None else load_layout(path.parent / modules, channels)
    anchor = table.take("anchor", dict, None)
    limits = table.array("range", (2,), None)
    return SkinSpec(
        channels=channels,
        polarity=table.choice("polarity", {"up": 1, "down": -1}, 1),
        layout=layout,
        anchor=None if anchor is None else read_anchor(anchor, table.where),
        range=None if limits is None else (float(limits[0]), float(limits[1])),
    )


def _read_surface(table: _Table, path: Path) -> SurfaceSpec:
    return SurfaceSpec(
        path=path.parent / table.take("mesh", str),
        scale=table.choice("unit", UNITS),
        link_from_mesh=_read_pose(table, "pose", np.eye(4)),
    )


def _read_pose(table: _Table, key: str, default: Any = ...) -> FloatArray:
    pose: FloatArray = table.array(key, (4, 4), default)
    rotation = pose[:3, :3]
    if np.abs(rotation @ rotation.T - np.eye(3)).max() > 1e-3 or np.linalg.det(rotation) < 0 or pose[3].tolist() != [0, 0, 0, 1]:
        raise InputError(f"{table.where}: {key} is not a rigid pose; expected a right-handed rotation, metres, last row 0 0 0 1.")
    return pose


def _read_arm(table: _Table) -> ArmSpec:
    joints = tuple(int(j) for j in table.array("joints", (None,)))
    rows = table.array("dh", (len(joints), 4))
    chain = tuple(DhLink(float(a), float(d), float(np.radians(al)), float(np.radians(of))) for a, d, al, of in rows)
    arm = Arm(joints, chain, _read_pose(table, "base_from_sensor"))
    poses = table.table("poses")
    named: dict[str, FloatArray] = {}
    if poses is not None:
        for name in list(poses.values):
            named[name] = np.radians(poses.array(name, (len(joints),)))
    tolerance = table.take("tolerance_deg", float, 0.5)
    return ArmSpec(arm, named, float(np.radians(tolerance)))


def _read_sign(table: _Table) -> int:
    sign = table.take("sign", int, 1)
    if sign not in (1, -1):
        raise InputError(f"{table.where}: sign is {sign}; expected 1, or -1 where the sensor reports the reaction.")
    return sign


def _read_settings(table: _Table | None, kind: type[Any]) -> Any:
    if table is None:
        return kind()
    given: dict[str, Any] = {}
    for item in fields(kind):
        default = item.default
        value = table.take(item.name, type(default), default)
        if not (np.isfinite(value) and value > 0):
            raise InputError(f"{table.where}: {item.name} is {value}; expected a number above 0.")
        given[item.name] = value
    return kind(**given)


def resource(name: str) -> Path:
    """Return the path of a file that ships with skincal, in a checkout or installed.

    Raises
    ------
    InputError
        There is no such resource.
    """
    here = Path(__file__).resolve().parent
    for folder in (here / "resources", here.parent / "resources"):
        if (folder / name).exists():
            return folder / name
    raise InputError(f"{name}: no such resource ships with skincal; see `skincal --help`.")
