"""MJCF models of the two rigs, made of primitives: an arm that pokes a part, and a part that an arm presses onto a fixed tip.

Both have the same parts by the same names: the force/torque sensor (site `ft`), the body `part` behind it with its `facet`, and
the spherical `tip` on a compliant wrist. The facet is a box whose upper face the engine touches (`Engine._place_facet`).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from xml.etree.ElementTree import Element, tostring

import numpy as np

from skincal.geometry import FloatArray
from skincal.physics.effects import FRICTION_COEFFICIENT_WITHOUT_SLIP, Effects

TIP_RADIUS_M = 0.002
PHYSICS_TIME_STEP_S = 0.001
FOAM_STIFFNESS_N_PER_M = 8000.0
"""N/m, of the layer under the tip. Assumed: foam of 0.75 MPa, 2.5 mm thick, has 3000 under the 10 mm^2 that the tip cuts into
it; the fabric spreads the force wider."""
FOAM_THICKNESS_M = 0.0025
"""m, from the taxels to the outer face: 2 to 3 mm of foam and fabric on an iCub."""
CONTACT_IMPEDANCE = 0.9
"""Constant impedance d of the contact: it makes the contact a linear spring (`Engine._set_layer_stiffness`)."""
FOAM_DAMPING_OVER_STIFFNESS_S = 0.004
"""s, damping of the layer over its stiffness."""
WRIST_STIFFNESS_N_PER_M = 3000.0
"""N/m, along the tip's direction: a rubber buffer or a passive compliance of a small arm. Assumed."""
WRIST_BENDING_STIFFNESS_NM_PER_RAD = 60.0
"""N m/rad across it. Assumed."""
JOINT_STIFFNESS_NM_PER_RAD = 2e4
"""N m/rad of an arm's joint without sag."""
VIBRATING_MOUNT_STIFFNESS_N_PER_M = 5e4
"""N/m of the sensor's mount where it vibrates: with the part a resonance of about 30 Hz."""
MASS_OF_LINK_WITHOUT_MASS_KG = 1e-3
"""kg given to a link whose mass is not known: the engine needs one."""
FACET_HALF = (0.02, 0.02, 0.005)


@dataclass(frozen=True, slots=True, eq=False)
class Joint:
    """A hinge of a chain, or a fixed step of it."""

    pose: FloatArray
    """(4, 4) float, metres: of the child in the parent at angle 0."""
    axis: FloatArray | None
    """(3,) float, unit, in the child's frame; `None`: fixed."""
    limits: tuple[float, float] = (-np.pi, np.pi)
    """rad."""
    mass: float = 0.0
    """kg of the child."""
    middle: FloatArray = field(default_factory=lambda: np.zeros(3))
    """(3,) float, metres: centre of mass of the child."""
    sensor_pose: FloatArray | None = None
    """(4, 4) float: pose of the force/torque sensor in the child, if it carries one. It measures the load of the child."""
    trembles: bool = False
    """The child is a mount that vibrates."""


@dataclass(frozen=True, slots=True, eq=False)
class RigPlan:
    """Description of a rig for `write_mjcf`."""

    part_chain: Sequence[Joint]
    """From the world to the part; one of them carries the sensor."""
    part_middle: FloatArray
    """(3,) float, metres, part's frame: centre of mass of the part."""
    tip_chain: Sequence[Joint]
    """From the world to the wrist, whose frame has z along the tip's direction."""
    tool_length: float
    """m, from the wrist to the centre of the tip."""
    part_is_actuated: bool
    """The part's chain moves, not the tip's."""
    soft_axes: Sequence[tuple[FloatArray, FloatArray]] = ()
    """Hinges between sensor and part that yield under load: axis (3,) and point (3,), part's frame."""
    tip_stiffness: float = WRIST_STIFFNESS_N_PER_M
    """N/m, of the tip along its direction."""
    tip_bending: float = WRIST_BENDING_STIFFNESS_NM_PER_RAD
    """N m/rad, across it."""


def write_mjcf(plan: RigPlan, effects: Effects) -> str:
    """Write the MJCF text of a rig."""
    root = Element("mujoco", model="skincal-robot")
    _add(root, "compiler", angle="radian", autolimits="true")
    _add(root, "option", timestep=f"{PHYSICS_TIME_STEP_S}", integrator="implicitfast", cone="elliptic", impratio="1000")
    world = _add(root, "worldbody")
    actuators = _add(root, "actuator")
    part = _add_chain(world, plan.part_chain, "p", actuators if plan.part_is_actuated else None, effects)
    _add_part(part, plan, effects)
    wrist = _add_chain(world, plan.tip_chain, "t", None if plan.part_is_actuated else actuators, effects)
    _add_tip(wrist, plan)
    _add_contact(root, effects)
    sensors = _add(root, "sensor")
    _add(sensors, "force", name="force", site="ft")
    _add(sensors, "torque", name="torque", site="ft")
    return tostring(root, encoding="unicode")


def _add(parent: Element, tag: str, **attributes: str) -> Element:
    element = Element(tag, attributes)
    parent.append(element)
    return element


def numbers(values: FloatArray | Sequence[float]) -> str:
    """Write numbers for an attribute, exactly."""
    return " ".join(repr(float(value)) for value in values)


def pose_attributes(pose: FloatArray) -> dict[str, str]:
    """Write a pose (4, 4) as position and axes."""
    return {"pos": numbers(pose[:3, 3]), "xyaxes": numbers([*pose[:3, 0], *pose[:3, 1]])}


def _add_chain(parent: Element, chain: Sequence[Joint], prefix: str, actuators: Element | None, effects: Effects) -> Element:
    """Add the bodies of a chain; with `actuators` its hinges are driven. Return the last body."""
    stiffness = 1.0 / (1.0 / JOINT_STIFFNESS_NM_PER_RAD + effects.sag)
    for number, joint in enumerate(chain):
        name = f"{prefix}{number}"
        # Without sag the drives hold the arm's weight, too.
        parent = _add(parent, "body", name=name, gravcomp="0" if effects.sag else "1", **pose_attributes(joint.pose))
        if joint.axis is not None:
            _add(
                parent, "joint", name=name, type="hinge", axis=numbers(joint.axis), range=numbers(joint.limits),
                armature="0.3", damping="5",
            )  # fmt: skip
            if actuators is not None:
                damping = 2.0 * 0.7 * np.sqrt(stiffness * 0.8)
                _add(actuators, "position", joint=name, kp=f"{stiffness}", kv=f"{damping}")
        if joint.trembles and effects.vibration:
            for axis in "xyz":
                _add(
                    parent, "joint", name=f"mount_{axis}", type="slide", axis=numbers([float(axis == each) for each in "xyz"]),
                    stiffness=f"{VIBRATING_MOUNT_STIFFNESS_N_PER_M}", damping="25",
                )  # fmt: skip
        if joint.sensor_pose is not None:
            # The sensor reads the load between this body and the one before.
            parent = _add(parent, "body", name="sensor")
            _add(parent, "site", name="ft", **pose_attributes(joint.sensor_pose))
        if joint.mass:
            inertia = numbers([1e-3 * joint.mass] * 3)
            _add(parent, "inertial", mass=f"{joint.mass}", pos=numbers(joint.middle), diaginertia=inertia)
    return parent


def _add_part(parent: Element, plan: RigPlan, effects: Effects) -> None:
    # A mount that trembles is felt by the part's inertia.
    mass = effects.weight or (Effects().weight if effects.vibration else MASS_OF_LINK_WITHOUT_MASS_KG)
    part = _add(parent, "body", name="part")
    for number, (axis, point) in enumerate(plan.soft_axes if effects.sag else ()):
        _add(
            part, "joint", name=f"soft{number}", type="hinge", axis=numbers(axis), pos=numbers(point),
            stiffness=f"{1.0 / effects.sag}", damping="1", armature="0.005",
        )  # fmt: skip
    # A tube of the forearm's size.
    inertia = numbers(mass * np.array([2e-3, 1e-3, 2e-3]))
    _add(part, "inertial", mass=f"{mass}", pos=numbers(plan.part_middle), diaginertia=inertia)
    facet = _add(part, "body", name="facet")
    _add(
        facet, "geom", name="facet", type="box", size=numbers(FACET_HALF), pos=numbers([0, 0, -FACET_HALF[2]]), mass="0",
        contype="0", conaffinity="0",
    )  # fmt: skip


def _add_tip(parent: Element, plan: RigPlan) -> None:
    length = plan.tool_length
    wrist = _add(parent, "body", name="wrist", gravcomp="1")
    damping = {"slide": f"{2 * np.sqrt(plan.tip_stiffness * 0.1)}", "hinge": "0.3"}
    for kind, axis, stiffness in (
        ("slide", "0 0 1", plan.tip_stiffness),
        ("hinge", "1 0 0", plan.tip_bending),
        ("hinge", "0 1 0", plan.tip_bending),
    ):
        _add(
            wrist, "joint", name=f"wrist_{kind}_{axis.replace(' ', '')}", type=kind, axis=axis, stiffness=f"{stiffness}",
            damping=damping[kind],
        )  # fmt: skip
    _add(wrist, "inertial", mass="0.1", pos=numbers([0, 0, length / 2]), diaginertia="2e-4 2e-4 2e-5")
    tip = {"name": "tip", "pos": numbers([0, 0, length])}
    _add(wrist, "geom", type="sphere", size=f"{TIP_RADIUS_M}", mass="0", contype="0", conaffinity="0", **tip)
    _add(wrist, "site", **tip)


def _add_contact(root: Element, effects: Effects) -> None:
    friction = effects.friction or FRICTION_COEFFICIENT_WITHOUT_SLIP
    _add(
        _add(root, "contact"), "pair", geom1="facet", geom2="tip", condim="3",
        friction=numbers([friction, friction, 0.0, 0.0, 0.0]),
        solimp=numbers([CONTACT_IMPEDANCE, CONTACT_IMPEDANCE, 0.001, 0.5, 2]), solref="-1 -1",
    )  # fmt: skip
