#!/usr/bin/env bash
# PyBullet 3.2.7: the moment of a joint's force/torque sensor is about the child link's centre of mass, not about the joint.
#
# enableJointForceTorqueSensor is how a simulated robot gets a force/torque sensor; getJointState returns its six values. Here a
# tool of 2 kg hangs by a fixed joint, with its centre of mass 0.3 m to the side, under 10 m/s2. Expected: 20 N and a moment of
# 6 N m at the joint, where the sensor is; MuJoCo's torque sensor at the same place reads it. Seen: 20 N and no moment.
# A turn of the tool's inertial frame (rpy) turns the six values, too, though the tool and its load are the same: they are in the
# axes of that frame. Nothing is printed. A line of force, moment over force, is off by the distance of the centre of mass.
# Remedy: force F and moment M become R F and R M + c x (R F), with place c and turn R of the child's inertial frame in the joint's
# frame.
set -euo pipefail
folder=$(mktemp -d); trap 'rm -rf "$folder"' EXIT; cd "$folder"
python3 -m venv venv && venv/bin/pip install -q --disable-pip-version-check pybullet==3.2.7 mujoco==4.0.0 numpy==2.4.6
cat > try.py <<'P'
import sys
from pathlib import Path

import mujoco
import numpy as np
import pybullet

INERTIA = '<inertia ixx="0.02" iyy="0.02" izz="0.02" ixy="0" ixz="0" iyz="0"/>'
ROBOT = """<robot name="r"><link name="hand"><inertial><mass value="1"/>{inertia}</inertial></link>
<joint name="sensor" type="fixed"><parent link="hand"/><child link="tool"/><origin xyz="0 0 1"/></joint>
<link name="tool"><inertial><origin xyz="0.3 0 0" rpy="{rpy}"/><mass value="2"/>{inertia}</inertial></link></robot>"""
SAME = """<mujoco><option gravity="0 0 -10"/><worldbody><body pos="0 0 1"><joint type="hinge" limited="true" range="0 0.001"/>
<inertial pos="0.3 0 0" mass="2" diaginertia="0.02 0.02 0.02"/><site name="s"/></body></worldbody>
<sensor><force site="s"/><torque site="s"/></sensor></mujoco>"""


def read(rpy):
    Path("robot.urdf").write_text(ROBOT.format(rpy=rpy, inertia=INERTIA))
    client = pybullet.connect(pybullet.DIRECT)
    pybullet.setGravity(0, 0, -10)
    robot = pybullet.loadURDF("robot.urdf", useFixedBase=True, flags=pybullet.URDF_USE_INERTIA_FROM_FILE)
    pybullet.enableJointForceTorqueSensor(robot, 0, True)
    for _ in range(100):
        pybullet.stepSimulation()
    found = np.array(pybullet.getJointState(robot, 0)[2])
    pybullet.disconnect(client)
    return found.round(4) + 0.0


model = mujoco.MjModel.from_xml_string(SAME)
data = mujoco.MjData(model)
mujoco.mj_forward(model, data)
plain, turned = read("0 0 0"), read("1.5707963 0 0")
print("PyBullet 3.2.7, MuJoCo", mujoco.__version__)
print("MuJoCo, force and torque:              ", data.sensordata.round(4) + 0.0)
print("PyBullet:                              ", plain)
print("PyBullet, inertial frame with rpy 90 deg:", turned)
assert np.allclose(data.sensordata, [0, 0, 20, 0, -6, 0], atol=1e-6), "MuJoCo's own answer has changed"
seen = np.allclose(plain, [0, 0, 20, 0, 0, 0], atol=1e-3) and np.allclose(turned, [0, 20, 0, 0, 0, 0], atol=1e-3)
print("behaviour: no moment, axes of the inertial frame" if seen else "the behaviour has changed")
sys.exit(0 if seen else 1)
P
venv/bin/python try.py 2> /dev/null | grep -v "build time"
