"""Read a robot with PyBullet: mass, moving joints, and poses of names in the root link."""

import json
import sys
from pathlib import Path

import numpy as np
import pybullet


def matrix(position, quaternion_xyzw):
    pose = np.eye(4)
    pose[:3, :3] = np.reshape(pybullet.getMatrixFromQuaternion(quaternion_xyzw), (3, 3))
    pose[:3, 3] = position
    return pose


task = json.loads(sys.argv[1])
pybullet.connect(pybullet.DIRECT)
body = pybullet.loadURDF(task["file"], useFixedBase=True)
joints = [pybullet.getJointInfo(body, i) for i in range(pybullet.getNumJoints(body))]
moving = [info[1].decode() for info in joints if info[2] != pybullet.JOINT_FIXED]
masses = [pybullet.getDynamicsInfo(body, i)[0] for i in range(-1, len(joints))]
# The root's pose is that of its centre of mass, which has its place in the link.
inertial = matrix(*pybullet.getDynamicsInfo(body, -1)[3:5])
root = matrix(*pybullet.getBasePositionAndOrientation(body)) @ np.linalg.inv(inertial)
poses = []
for angles in task["angles"]:
    for info in joints:
        if info[1].decode() in angles:
            pybullet.resetJointState(body, info[0], angles[info[1].decode()])
    found = {}
    for info in joints:
        if info[12].decode() in task["names"]:
            state = pybullet.getLinkState(body, info[0], computeForwardKinematics=True)
            found[info[12].decode()] = (np.linalg.inv(root) @ matrix(*state[4:6])).tolist()
    poses.append(found)
# A fixed root has no mass in PyBullet.
Path(sys.argv[2]).write_text(json.dumps({"mass": sum(masses), "moving": moving, "poses": poses}))
