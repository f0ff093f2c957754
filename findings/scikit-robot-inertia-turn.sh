#!/usr/bin/env bash
# scikit-robot 0.4.7 ignores the turn of a URDF's inertial frame, so inertia and torques are those of another body.
#
# <inertial><origin rpy=...> turns the frame that <inertia> is given in ("urdf/XML/link" of the ROS wiki); descriptions of
# Universal Robots' arms have it. Here a rod lies along x by rpy="0 1.5708 0", with 1 kg m2 across and 0.1 kg m2 along.
# Expected: 1 N m for 1 rad/s2 about z, as for the same rod written without a turn. Seen: 0.1 N m, by inverse dynamics and in
# the robot's total inertia. The place of the frame (xyz) is used, the turn is not. No message.
# Remedy: turn the tensor (R I R^T), and write rpy="0 0 0" into the file.
set -euo pipefail
folder=$(mktemp -d); trap 'rm -rf "$folder"' EXIT; cd "$folder"
python3 -m venv venv
venv/bin/pip install -q --disable-pip-version-check --no-deps scikit-robot==0.4.7  # without viewers
venv/bin/pip install -q --disable-pip-version-check numpy==2.4.6 scipy==1.17.1 lxml==6.1.3 networkx==3.6.1 trimesh==5.2.0 \
    ordered-set==4.1.0 cached-property==2.0.1 packaging==26.4 filelock==4.3.1 pyyaml==6.0.4 pillow==13.0.0
cat > try.py <<'P'
import sys
from importlib.metadata import version

import numpy as np
from skrobot.dynamics import build_inverse_dynamics_fn
from skrobot.models.urdf import RobotModelFromURDF

ACROSS, ALONG = 1.0, 0.1  # kg m2
ROD = """<robot name="arm"><link name="base"/><link name="rod"><inertial><origin xyz="0 0 0" rpy="{rpy}"/><mass value="2"/>
<inertia ixx="{xx}" ixy="0" ixz="0" iyy="{yy}" iyz="0" izz="{zz}"/></inertial></link><joint name="joint" type="revolute">
<parent link="base"/><child link="rod"/><axis xyz="0 0 1"/><limit lower="-3" upper="3" effort="9" velocity="9"/></joint></robot>"""


def torque(rpy: str, xx: float, yy: float, zz: float) -> tuple[float, float]:
    """Torque for 1 rad/s2 without gravity, in N m, and the robot's total inertia about z, in kg m2."""
    with open("rod.urdf", "w") as file:
        file.write(ROD.format(rpy=rpy, xx=xx, yy=yy, zz=zz))
    robot = RobotModelFromURDF(urdf_file="rod.urdf")
    needed = build_inverse_dynamics_fn(robot)(np.zeros(1), np.zeros(1), np.ones(1), gravity=np.zeros(3))
    return float(needed[0]), float(robot.update_mass_properties()["total_inertia"][2, 2])


turned = torque("0 1.5707963267948966 0", ACROSS, ACROSS, ALONG)
plain = torque("0 0 0", ALONG, ACROSS, ACROSS)
print("scikit-robot", version("scikit-robot"))
print(f"rod along x, tensor in the link's axes: {plain[0]:.3f} N m, {plain[1]:.3f} kg m2")
print(f"the same rod by a turned frame:         {turned[0]:.3f} N m, {turned[1]:.3f} kg m2 (expected: {ACROSS:g}, {ACROSS:g})")
seen = np.allclose(plain, ACROSS, atol=1e-3) and np.allclose(turned, ALONG, atol=1e-3)
print("behaviour: the turn is ignored" if seen else "the behaviour has changed")
sys.exit(0 if seen else 1)
P
venv/bin/python try.py
