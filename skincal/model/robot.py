"""The table `[robot]` of a scene: a URDF in place of `[arm]` or `[sensor]`."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from skincal.geometry import FloatArray
from skincal.model.errors import InputError
from skincal.model.length_units import METRES_PER_UNIT
from skincal.model.mesh_lookup import find_mesh
from skincal.model.tables import Table, check_degrees
from skincal.model.urdf import Robot, read_urdf
from skincal.model.urdf_chain import UrdfChain

DEFAULT_TURN_MAX_DEG = 0.5
"""Degrees. Largest turn of a joint during a poke."""


@dataclass(frozen=True, slots=True, eq=False)
class RobotSpec:
    """The robot that carries the part."""

    urdf: Robot
    sensor: str
    """Name of a force/torque sensor, a joint or a link; empty if a tool pokes the part: then the chain is empty."""
    chain: UrdfChain
    columns: tuple[str, ...]
    """Joint names of the joint stream's columns."""
    fixed: Mapping[str, float]
    """rad, angles of joints that are not streamed."""
    sign: int | None
    """1 if the sensor reports the force on the part, -1 for the reaction; `None` if the URDF does not say."""
    poses: Mapping[str, FloatArray]
    """Named arm poses: (moving joints,) float, radians."""
    turn_max: float
    """rad, largest turn of a joint during a poke."""
    mesh: tuple[Path, float, FloatArray, bool] | None
    """The part's mesh as in `SurfaceSpec`: file, metres per unit, (4, 4) pose in the part's link, whether the unit is typed."""
    mesh_link: str
    """Link whose visual mesh that is; empty without a mesh."""


NO_CHAIN = UrdfChain(joints=(), moving=(), steps=(), fixed={}, sensor=np.eye(4))
"""Of a part that a tool pokes: the sensor is on the tool, or there is none."""
_KEYS_OF_A_CHAIN = ("sensor", "joints", "fixed", "poses", "tolerance_deg")


def read_robot(table: Table, link: str, folder: Path, needs_mesh: bool, *, has_tool: bool = False) -> RobotSpec:
    """Read `[robot]`.

    Parameters
    ----------
    link : the part's link, frame of all positions
    folder : of the scene file
    needs_mesh : the mesh of the part's link is looked for; otherwise the scene has its own
    has_tool : a tool pokes the part, so the URDF gives link and mesh alone

    Raises InputError: the URDF is not usable, or a name is not in it.
    """
    where = table.where
    urdf = read_urdf(folder / table.path("urdf"))
    if has_tool:
        _refuse_chain(table)
    sensor = "" if has_tool else table.take("sensor", str)
    columns = tuple(table.words("joints", []))
    fixed = _degrees(table.table("fixed"), urdf)
    if has_tool:
        urdf.require_link(link, where)
    chain, sign = (NO_CHAIN, None) if has_tool else urdf.chain(link, sensor, columns, fixed, where)
    sensor_joint = "" if has_tool else urdf.sensor_named(sensor, where).joint
    poses, turn_max = read_poses(table, len(columns))
    poses = {name: angles[list(chain.joints)] for name, angles in poses.items()}
    packages_table, packages = table.table("packages"), dict[str, Path]()
    for name in [] if packages_table is None else packages_table.keys:
        assert packages_table is not None
        packages[name] = folder / packages_table.path(name)
    own = table.path("mesh", "")
    # Older scenes name no unit: the scale of the URDF's own mesh.
    unit = table.choice("unit", METRES_PER_UNIT) if "unit" in table.keys else None
    mesh = None
    found = urdf.mesh_for(link, sensor_joint)
    if own and (found is None or not needs_mesh):
        raise InputError(f"{where}: mesh is {own}, but the link has no visual mesh or [surface] names one; use [surface].")
    if unit is not None and not own:
        raise InputError(f"{where}: unit is that of mesh, and there is no mesh; leave unit out.")
    if needs_mesh and found is not None:
        file = folder / own if own else find_mesh(urdf, found[0], packages)
        scale_and_pose = found[0].scale_and_pose(found[1], where) if unit is None else (unit, found[1])
        mesh = file, *scale_and_pose, unit is not None
    table.refuse_unknown_keys()
    return RobotSpec(urdf, sensor, chain, columns, fixed, sign, poses, turn_max, mesh, found[0].link if mesh and found else "")


def _refuse_chain(table: Table) -> None:
    named = [key for key in _KEYS_OF_A_CHAIN if key in table.keys]
    if named:
        raise InputError(
            f"{table.where}: {named[0]} is of a sensor below the part, and the scene has [tool]; leave one of them out."
        )


def read_poses(table: Table, joints: int) -> tuple[dict[str, FloatArray], float]:
    """Read the named poses of an arm, (joints,) each, and the largest turn of a joint during a poke; radians."""
    poses_table, poses = table.table("poses"), dict[str, FloatArray]()
    for name in [] if poses_table is None else poses_table.keys:
        assert poses_table is not None
        angles: FloatArray = poses_table.array(name, (joints,))
        check_degrees(angles, f"{poses_table.where}: {name}")
        poses[name] = np.radians(angles)
    tolerance = table.take("tolerance_deg", float, DEFAULT_TURN_MAX_DEG)
    if not tolerance > 0:
        raise InputError(f"{table.where}: tolerance_deg is {tolerance}; expected a number above 0.")
    return poses, float(np.radians(tolerance))


def _degrees(table: Table | None, urdf: Robot) -> dict[str, float]:
    """Read the angles of joints that are not streamed, in radians."""
    angles: dict[str, float] = {}
    for name in [] if table is None else table.keys:
        assert table is not None
        angle = table.take(name, float)
        check_degrees(np.array([angle]), f"{table.where}: {name}")
        if name not in urdf.joints:
            raise InputError(f"{table.where}: {urdf.path.name} has no joint {name!r}; expected joints of the URDF.")
        angles[name] = float(np.radians(angle))
    return angles
