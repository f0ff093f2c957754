"""A scene: the rig to calibrate, read from a TOML file.

It decides which methods, view layers and panels exist: missing parts are `None`. The file's lengths are metres and its angles
degrees unless the key ends in a unit; see `docs/scene.md`.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, fields, replace
from itertools import pairwise
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from skincal.geometry import Arm, DhLink, FloatArray
from skincal.model.errors import InputError
from skincal.model.length_units import METRES_PER_UNIT
from skincal.model.robot import DEFAULT_TURN_MAX_DEG, RobotSpec, read_poses, read_robot
from skincal.model.skin import Anchor, Layout, SkinKind, load_layout, read_anchor
from skincal.model.tables import MAX_LENGTH_M, Table, check_degrees, check_metres, parse_toml, read_text
from skincal.model.tool_rig import BASE_LINK, POINT_FORCE_N, PUSH_TURN_SD_RAD, ToolSpec, read_tool
from skincal.model.urdf_chain import UrdfChain
from skincal.model.wrench_frames import WrenchFrame, WrenchPlace, find_wrench_frame, read_wrench_place

if TYPE_CHECKING:
    from skincal.model.skin_axes import SkinAxes

_KEYS_IN_DEGREES = {"pose_turn": "pose_turn_deg"}
"""Settings that the file gives in degrees, by their key there."""
SETTING_MIN, SETTING_MAX = 1e-9, 1e6
"""Of thresholds and noise, in their units. No sensor of a robot resolves a nanometre or a nanonewton; raw units of a device of
20 bits end at a million."""
MAX_TIME_SETTING_S = 60.0
"""s. A hand does not hold still for a minute at each poke."""
FORCE_ORDER = ("release_force", "touch_force", "force_min", "force_max")
"""Force thresholds in ascending order."""
MAX_JOINT_STREAM_COLUMNS = 1000
"""Of a joint stream: a humanoid has about a hundred."""
DISTANCE_SD_RANGE_M = (1e-5, 0.1)
"""m. A soft skin cannot be measured to a hundredth of a millimetre."""


@dataclass(frozen=True, slots=True)
class SkinSpec:
    """The skin's stream and, where the maker gives one, its layout."""

    channels: int
    """Number of channels; each is a taxel, or none. A skin frame has one value for each, or three (`axes`)."""
    polarity: int
    """+1 where raw values rise under pressure, -1 where they fall."""
    layout: Layout | None
    anchor: Anchor | None
    """Planned position of the layout on the part; `None` if unknown."""
    range: tuple[float, float] | None
    """Lowest and highest raw value of the device; a taxel that stays there is stuck."""
    axes: SkinAxes | None = None
    """The values of taxels that measure a force vector; `None` for taxels of one value."""

    @property
    def frame_width(self) -> int:
        """Number of values of a skin frame."""
        return self.channels * (1 if self.axes is None else len(self.axes.places))


@dataclass(frozen=True, slots=True, eq=False)
class SurfaceSpec:
    """A mesh file and its pose."""

    path: Path
    scale: float
    """Metres per unit of the file."""
    link_from_mesh: FloatArray
    """(4, 4) float, metres. That of a URDF's mesh may also stretch or mirror: see `LinkMesh.scales`."""
    replaces_unit: bool = False
    """`scale` replaces the unit that the file names (COLLADA, glTF); a URDF's scale multiplies it."""


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
    """N. A poke ends below it. It is lower than `touch_force`, so that noise cannot end a poke."""
    still_s: float = 0.30
    """s. Length of the still window: 15 skin frames at 50 Hz."""
    still_change: float = 0.05
    """Largest relative spread (sd) of the force inside the still window."""
    slide_max: float = 0.0015
    """m. Largest slide of the force axis inside the still window, measured where the contact is."""
    pitch_max: float = 0.008
    """m. Largest |f . m|/|f|^2 (eq. 3): the 99th percentile of single contacts is 7.5 mm in simulation with sensor noise only.
    Raise it to 20 mm if the sensor's matrix is wrong: an error of 2 % with cross-talk at a lever of 0.2 m makes a pitch of sd
    6 mm, and good pokes end as "two contacts or a torque"."""
    taxels_max: int = 6
    """Largest number of taxels that answer one poke: the default of the authors' own module (`skinCalibration`)."""
    response_min: float = 10.0
    """Raw units. The threshold delta: the authors' own module uses 10 of 255."""
    response_noises: float = 5.0
    """A taxel must also answer this many standard deviations of its own noise above its baseline."""
    response_share: float = 0.0
    """A taxel must also answer at least this share of the strongest answer: above the ghosts of a matrix without diodes. 0: any
    share counts."""
    quiet_s: float = 0.20
    """s. Length of a quiet window for the tare: 10 skin frames at 50 Hz."""
    tare_change_max: float = 1.0
    """N. Largest difference of the tares before and after a poke. Beyond it the sensor drifted or something leaned on it."""
    gap_factor: float = 1.6
    """Largest gap between taxels that answer together, in spacings of the layout."""


@dataclass(frozen=True, slots=True)
class NoiseSettings:
    """The rig's noise per averaged poke, for predicted uncertainty; SI units. One set for the whole session."""

    force: float = 0.10
    """N, sd of each force component: a good rig's, see `docs/noise.md`."""
    moment: float = 0.010
    """N m, sd of each moment component of a good rig; the FT45 resolves 0.005 N m."""
    contact: float = 0.0015
    """m, sd of the contact about the taxel with the largest response, each direction in the skin: a hand aims to 2 mm, and
    farther off a neighbour answers more."""
    reach: float = 0.0025
    """m, distance over which the response falls to 1/e: a taxel that is this much farther from the tip than the strongest one
    answers 1/e of it. For a 4 mm tip on 2 to 3 mm of foam (`simulate.rig`)."""
    radius: float = 0.03
    """m, radius of the part under the skin: pokes next to a taxel lean with the skin, so the axes meet below it. A forearm's; 1
    for a flat part."""
    skin: float = 0.0015
    """m, sd of the height of the touched face above the taxels or the mesh: a leaning push acts farther along the skin. 2 to 3
    mm of foam or fabric on an iCub."""
    pose_turn: float = 0.0
    """rad, sd of the rotation error of each arm pose about each axis through the sensor, the same for all its pokes."""
    pose_shift: float = 0.0
    """m, sd of the position error of each arm pose along each axis, the same for all its pokes."""


@dataclass(frozen=True, slots=True)
class ArmSpec:
    """Kinematic chain between sensor and link, and named arm poses."""

    arm: Arm | UrdfChain
    poses: dict[str, FloatArray]
    """Name to (joints,) float, radians; may be empty if the joints are streamed."""
    turn_max: float = float(np.radians(DEFAULT_TURN_MAX_DEG))
    """rad. A poke is rejected if a streamed joint moves more."""


@dataclass(frozen=True, slots=True, eq=False)
class Landmark:
    """A known point of the part: a screw head, a corner, a jig."""

    name: str
    place: FloatArray
    """(3,) float, metres, link frame."""
    normal: FloatArray | None
    """(3,) float, unit, outward; `None` if not given."""


@dataclass(frozen=True, slots=True)
class KnownDistance:
    """Measured straight distance between two modules."""

    ends: tuple[int, int]
    """Ids of two modules, whose origins are the ends; or channels of taxels of two modules."""
    of_taxels: bool
    """`ends` are channels."""
    length: float
    sd: float
    """m, standard deviation of `length`, which is in metres, too."""


@dataclass(frozen=True, slots=True)
class Scene:
    """The rig to calibrate."""

    name: str
    link: str
    """Frame of every position, here and in every exported file."""
    skin: SkinSpec
    surface: SurfaceSpec | None
    arm: ArmSpec | None
    sensor_pose: FloatArray
    """(4, 4) float: pose of the sensor in the link frame without an arm; the identity by default."""
    wrench_sign: int
    """-1 if the sensor reports the reaction force."""
    contacts: ContactSettings
    noise: NoiseSettings
    path: Path
    """The scene file; relative paths in it are relative to its folder."""
    landmarks: tuple[Landmark, ...] = ()
    distances: tuple[KnownDistance, ...] = ()
    text: str = field(repr=False, default="")
    """The file's text, kept in every session."""
    robot: RobotSpec | None = None
    wrench_place: WrenchPlace = field(default_factory=WrenchPlace)
    """Frame of the wrench that the scene names in place of the messages."""
    tool: ToolSpec | None = None
    """The tool that carries the sensor, or that pokes without one; `None` if the sensor is below the part."""
    states_response_min: bool = True
    """Whether `response_min` is written in the scene; if it is not, the unit of the skin may set it."""

    @property
    def has_sensor(self) -> bool:
        """Whether the rig has a force/torque sensor, below the part or on the tool."""
        return self.tool is None or self.tool.has_sensor

    @property
    def finds_part_pose(self) -> bool:
        """Whether the part's pose in the base of a tool's poses is to be found from pokes."""
        return self.tool is not None and not self.tool.has_part_pose and self.link != BASE_LINK

    def wrench_frame(self, name: str) -> WrenchFrame:
        """Find the frame that messages name for a wrench; empty: they name none."""
        return find_wrench_frame(self.robot if self.tool is None else None, self.wrench_place, name)


_TABLE_OF_KEY = {
    "sign": "wrench",
    "about": "wrench",
    "polarity": "skin",
    "channels": "skin",
    "modules": "skin",
    "mesh": "surface",
}
"""Tables of keys that are often written in another table of the scene."""


def load_scene(path: Path) -> Scene:
    """Read a scene's TOML file and the layout it names, but not the mesh.

    Raises InputError with the file, the key, the value found and what was expected.
    """
    text = read_text(path).replace("\r\n", "\n")  # older sessions hold it so
    root = Table(parse_toml(text, path), str(path))
    skin = root.table("skin")
    if skin is None:
        raise InputError(f"{path}: [skin] is missing; expected a table with at least channels.")
    surface, arm, sensor, robot = root.table("surface"), root.table("arm"), root.table("sensor"), root.table("robot")
    tool = root.table("tool")
    wrench, contacts, noise = root.table("wrench"), root.table("contacts"), root.table("noise")
    if sum(each is not None for each in (arm, sensor, robot)) > 1:
        raise InputError(f"{path}: [arm], [sensor] and [robot] exclude each other; keep the one that places the sensor.")
    if tool is not None and (arm is not None or sensor is not None):
        raise InputError(f"{path}: [tool] excludes [arm] and [sensor]; keep the one that places the sensor.")
    states_response_min = contacts is not None and "response_min" in contacts.keys
    spec, name, link = _read_skin(skin, path), root.take("name", str), root.take("link", str)
    made_tool = None if tool is None else read_tool(tool)
    if made_tool is not None and not made_tool.has_sensor:
        _refuse_sensor_keys(path, wrench, noise)
    made = None if robot is None else read_robot(robot, link, path.parent, surface is None, has_tool=tool is not None)
    # Frames of a wrench are those of a sensor that the URDF places.
    of_wrench = made if tool is None else None
    scene = Scene(
        name=name,
        link=link,
        skin=spec,
        surface=_robot_surface(made) if surface is None else _read_surface(surface, path),
        arm=_robot_arm(made) if arm is None else _read_arm(arm),
        sensor_pose=_fixed_sensor_pose(made) if sensor is None else sensor.pose("pose"),
        wrench_sign=_read_sign(wrench, _usual_sign(made, made_tool)),
        contacts=_read_contacts(contacts, spec.axes),
        noise=_read_noise(noise, made_tool),
        path=path,
        landmarks=_read_landmarks(root, path),
        distances=_read_distances(root, spec.layout),
        text=text,
        robot=made,
        wrench_place=read_wrench_place(wrench, of_wrench),
        tool=made_tool,
        states_response_min=states_response_min,
    )
    _check_tool(scene)
    _check_force_order("" if contacts is None else contacts.where, scene.contacts)
    for part in (root, skin, surface, arm, sensor, wrench, contacts, noise):
        if part is not None:
            part.refuse_unknown_keys(_TABLE_OF_KEY)
    return scene


def _read_skin(table: Table, path: Path) -> SkinSpec:
    channels = table.take("channels", int)
    if not 1 <= channels <= 100_000:
        raise InputError(f"{table.where}: channels is {channels}; expected 1 to 100000.")
    modules = table.path("modules", "")
    layout = load_layout(path.parent / modules, channels) if modules else None
    anchor = table.table("anchor")
    limits = table.array("range", (2,), None)
    if limits is not None and not limits[0] < limits[1]:
        raise InputError(f"{table.where}: range is {limits.tolist()}; expected the lowest raw value, then the highest.")
    polarity = table.choice("polarity", {"up": 1, "down": -1}, 1)
    return SkinSpec(
        channels=channels,
        polarity=polarity,
        layout=layout,
        anchor=None if anchor is None else read_anchor(anchor),
        range=None if limits is None else (float(limits[0]), float(limits[1])),
        axes=_read_skin_axes(table, polarity),
    )


def _read_skin_axes(table: Table, polarity: int) -> SkinAxes | None:
    if not {"axes", "order", "values", "response", "unit"} & set(table.keys):
        return None
    from skincal.model.skin_axes import read_axes  # only for skins of three axes

    return read_axes(table, polarity)


def _read_surface(table: Table, path: Path) -> SurfaceSpec:
    return SurfaceSpec(
        path=path.parent / table.path("mesh"),
        scale=table.choice("unit", METRES_PER_UNIT),
        link_from_mesh=table.pose("pose", np.eye(4)),
        replaces_unit=True,
    )


def _read_arm(table: Table) -> ArmSpec:
    columns: FloatArray = table.array("joints", (None,))
    if not len(columns) or (columns < 0).any() or (columns != np.rint(columns)).any():
        raise InputError(f"{table.where}: joints is {columns.tolist()}; expected columns of the joint stream, counted from 0.")
    if (columns >= MAX_JOINT_STREAM_COLUMNS).any():
        raise InputError(f"{table.where}: joints is {columns.tolist()}; expected columns below {MAX_JOINT_STREAM_COLUMNS}.")
    joints = tuple(int(j) for j in columns)
    rows: FloatArray = table.array("dh", (len(joints), 4))
    check_metres(rows[:, :2], f"{table.where}: dh")
    check_degrees(rows[:, 2:], f"{table.where}: dh")
    chain = tuple(DhLink(float(a), float(d), float(np.radians(al)), float(np.radians(of))) for a, d, al, of in rows)
    return ArmSpec(Arm(joints, chain, table.pose("base_from_sensor")), *read_poses(table, len(joints)))


def _robot_arm(robot: RobotSpec | None) -> ArmSpec | None:
    return None if robot is None or not robot.chain.joints else ArmSpec(robot.chain, dict(robot.poses), robot.turn_max)


def _fixed_sensor_pose(robot: RobotSpec | None) -> FloatArray:
    return np.eye(4) if robot is None or robot.chain.joints else robot.chain.link_from_sensor(np.empty(0))


def _robot_surface(robot: RobotSpec | None) -> SurfaceSpec | None:
    if robot is None or robot.mesh is None:
        return None
    return SurfaceSpec(*robot.mesh)


def _read_landmarks(root: Table, path: Path) -> tuple[Landmark, ...]:
    landmarks: list[Landmark] = []
    for table in root.tables("landmarks"):
        name, place = table.take("name", str), table.array("place", (3,))
        check_metres(place, f"{table.where}: place")
        if not name or any(name == other.name for other in landmarks):
            raise InputError(f"{path}: a landmark is named {name!r}; expected a name that no other one has.")
        landmarks.append(Landmark(name, place, table.direction("normal") if "normal" in table.keys else None))
        table.refuse_unknown_keys()
    return tuple(landmarks)


def _read_distances(root: Table, layout: Layout | None) -> tuple[KnownDistance, ...]:
    distances: list[KnownDistance] = []
    for table in root.tables("distances"):
        given = [key for key in ("modules", "taxels") if key in table.keys]
        if len(given) != 1:
            raise InputError(f"{table.where}: expected either modules, two ids, or taxels, two channels.")
        ends: FloatArray = table.array(given[0], (2,))
        if (ends != np.rint(ends)).any():
            raise InputError(f"{table.where}: {given[0]} is {ends.tolist()}; expected two whole numbers.")
        length, sd = (table.take(key, float) * 1e-3 for key in ("mm", "sd_mm"))
        if not 0 < length <= MAX_LENGTH_M or not DISTANCE_SD_RANGE_M[0] <= sd <= DISTANCE_SD_RANGE_M[1]:
            least, most = (f"{limit * 1e3:g}" for limit in DISTANCE_SD_RANGE_M)
            raise InputError(
                f"{table.where}: mm is {length * 1e3:g} and sd_mm {sd * 1e3:g}; expected a distance above 0 and up to "
                f"{MAX_LENGTH_M * 1e3:g}, known to {least} to {most}."
            )
        table.refuse_unknown_keys()
        known = KnownDistance((int(ends[0]), int(ends[1])), given[0] == "taxels", length, sd)
        check_distance(known, layout, table.where)
        if known in distances:
            raise InputError(
                f"{table.where}: the same distance is written twice; leave one out, or it counts as two measurements."
            )
        distances.append(known)
    return tuple(distances)


def check_distance(known: KnownDistance, layout: Layout | None, where: str) -> None:
    """Refuse a distance whose ends are not in two modules of a layout; `where` begins the sentence."""
    if layout is None:
        raise InputError(f"{where}: a distance is between modules, and the scene has no layout; name one in [skin].")
    if layout.kind is SkinKind.SHEET:
        raise InputError(
            f'{where}: a distance is between rigid boards, and the layout is a soft sheet (kind = "sheet"); remove it.'
        )
    owners: dict[int, int] = {module.id: index for index, module in enumerate(layout.modules)}
    if known.of_taxels:
        owners = {channel: int(layout.module_of[channel]) for channel in layout.channels.tolist()}
    found = {owners.get(end, -1) for end in known.ends}
    if -1 in found or len(found) < 2:
        what = "channels of taxels of two modules" if known.of_taxels else "ids of two modules"
        raise InputError(f"{where}: the ends are {list(known.ends)}; expected {what} of the layout.")


def _usual_sign(robot: RobotSpec | None, tool: ToolSpec | None) -> int:
    """Sign of the wrench unless the scene names one: a sensor on the tool feels the reaction."""
    if tool is not None:
        return -1
    return 1 if robot is None or robot.sign is None else robot.sign


def _refuse_sensor_keys(path: Path, wrench: Table | None, noise: Table | None) -> None:
    """Refuse what a scene says of a force/torque sensor that its rig lacks."""
    named = ["[wrench]"] if wrench is not None else []
    named += [f"{key} of [noise]" for key in ("force", "moment") if noise is not None and key in noise.keys]
    if named:
        raise InputError(f'{path}: {named[0]} is of a force/torque sensor, and [tool] says sensor = "none"; leave it out.')


def _read_noise(table: Table | None, tool: ToolSpec | None) -> NoiseSettings:
    """Read the noise; without a sensor a poke is a unit force through the tip, whose errors stand for those of the sensor."""
    noise: NoiseSettings = _read_settings(table, NoiseSettings)
    if tool is None or tool.has_sensor:
        return noise
    return replace(noise, force=PUSH_TURN_SD_RAD * POINT_FORCE_N, moment=tool.tip_sd * POINT_FORCE_N)


def _check_tool(scene: Scene) -> None:
    """Refuse a link whose pose in the tool's base is neither given nor shown by anything in the part's own frame."""
    if scene.tool is None or scene.tool.has_part_pose:
        return
    layout = scene.skin.layout
    in_part = {
        "[surface]": scene.surface is not None,
        "[[landmarks]]": bool(scene.landmarks),
        "[skin.anchor]": scene.skin.anchor is not None,
        "an anchor of the layout": layout is not None and any(module.anchor is not None for module in layout.modules),
    }
    named = [name for name, has in in_part.items() if has]
    if named and scene.link == BASE_LINK:
        raise InputError(
            f'{scene.path}: link is "base", and {named[0]} lies in the part\'s frame; expected the name of that frame as link: '
            "pokes then show its pose in the base. Or leave the part's places out."
        )
    if not named and scene.link != BASE_LINK:
        raise InputError(
            f'{scene.path}: base_from_link is missing in [tool], so every position is in the base; expected link = "base", not '
            f"{scene.link!r}, the part's pose, or something that shows it: [[landmarks]], [surface] or [skin.anchor]."
        )


def _read_sign(table: Table | None, default: int) -> int:
    if table is None:
        return default
    sign = table.take("sign", int, default)
    if sign not in (1, -1):
        raise InputError(f"{table.where}: sign is {sign}; expected 1, or -1 where the sensor reports the reaction.")
    return sign


def _read_settings(table: Table | None, kind: type[Any]) -> Any:
    if table is None:
        return kind()
    given: dict[str, Any] = {}
    for item in fields(kind):
        default: Any = item.default
        wanted: type = int if isinstance(default, int) else float
        key = _KEYS_IN_DEGREES.get(item.name, item.name)
        value = table.take(key, wanted, default)
        _check_setting(table.where, key, value, default)
        given[item.name] = value if key == item.name else float(np.radians(value))
    return kind(**given)


def _read_contacts(table: Table | None, axes: SkinAxes | None) -> ContactSettings:
    """Read the thresholds of pokes; a skin in newtons has another default threshold of a taxel."""
    is_given = table is not None and "response_min" in table.keys
    settings: ContactSettings = _read_settings(table, ContactSettings)
    return settings if axes is None or is_given else replace(settings, response_min=axes.response_min)


def _check_setting(where: str, key: str, value: float, default: float) -> None:
    # 0 switches a noise off.
    may_be_0 = default == 0 or key == "skin"
    if not (value > 0 or (may_be_0 and value == 0)):
        expected = "0 or a number above" if may_be_0 else "a number above 0"
        raise InputError(f"{where}: {key} is {value}; expected {expected}.")
    most = setting_limit(key)
    if value not in (0, default) and not SETTING_MIN <= value <= most:
        raise InputError(f"{where}: {key} is {value:g}; expected a number from {SETTING_MIN:g} to {most:g}.")


def setting_limit(key: str) -> float:
    """Largest value of a threshold or a noise, in its unit."""
    return MAX_TIME_SETTING_S if key.endswith("_s") else SETTING_MAX


def _check_force_order(where: str, settings: ContactSettings) -> None:
    for low, high in pairwise(FORCE_ORDER):
        if not getattr(settings, low) < getattr(settings, high):
            raise InputError(
                f"{where}: {low} is {getattr(settings, low):g} and {high} is {getattr(settings, high):g} (N); "
                f"they were expected to rise: {' < '.join(FORCE_ORDER)}."
            )


def with_thresholds(settings: ContactSettings, values: Mapping[str, float]) -> ContactSettings:
    """Replace some thresholds, by their names, in SI units.

    Raises InputError: a name is unknown, a value is out of range, a count is no whole number, or the forces do not ascend.
    """
    where = "thresholds of a poke"
    known: dict[str, Any] = {item.name: item.default for item in fields(ContactSettings)}
    given: dict[str, float] = {}
    for name, value in values.items():
        if name not in known:
            raise InputError(f"{where}: {name!r} is none; expected one of {', '.join(known)}.")
        _check_setting(where, name, value, known[name])
        whole = isinstance(known[name], int)
        if whole and value != round(value):
            raise InputError(f"{where}: {name} is {value:g}; expected a whole number.")
        given[name] = round(value) if whole else float(value)
    changed = replace(settings, **given)
    _check_force_order(where, changed)
    return changed


def with_layout(scene: Scene, path: Path) -> Scene:
    """Replace the layout by that of another file.

    Raises InputError: it is no layout, its channels do not fit the skin, or it lacks an end of a known distance.
    """
    layout = load_layout(path, scene.skin.channels)
    for known in scene.distances:
        check_distance(known, layout, f"{path}: a distance of {scene.path.name}")
    return replace(scene, skin=replace(scene.skin, layout=layout))


def resource(name: str) -> Path:
    """Find a file that ships with skincal, in a checkout or installed."""
    for folder in _resource_folders():
        if (folder / name).exists():
            return folder / name
    raise InputError(f"{name}: no such file ships with skincal; install it again.")


def ships(path: Path) -> bool:
    """Whether a path lies in skincal's own resources, which are never written to."""
    return any(path.resolve().is_relative_to(folder) for folder in _resource_folders())


def _resource_folders() -> tuple[Path, Path]:
    package = Path(__file__).resolve().parents[1]
    # Installed, the resources are in the package; in a checkout next to it.
    return package / "resources", package.parent / "resources"


def scene_file(given: Path) -> Path:
    """Find a scene's file: the path itself, or the shipped scene of this name, such as `icub-forearm`."""
    if given.suffix == ".toml" or given.exists() or len(given.parts) != 1:
        return given
    shipped = sorted(file.parent.name for file in resource("scenes").glob("*/scene.toml"))
    if str(given) not in shipped:
        raise InputError(f"{given}: no scene of this name ships; name a scene file (*.toml), or one of {', '.join(shipped)}.")
    return resource(f"scenes/{given}/scene.toml")
