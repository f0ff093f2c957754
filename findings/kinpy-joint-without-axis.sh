#!/usr/bin/env bash
# kinpy 0.6.1: a joint of a URDF without <axis> turns about z; the format and other readers say x.
#
# <axis> is optional in a URDF. Its default is (1, 0, 0): the page "urdf/XML/joint" of the ROS wiki says so, and urdfdom does so.
# Expected: half a radian of such a joint turns the next link about x. Seen: kinpy turns it about z, and a prismatic joint slides
# along z. Nothing is printed. Forward and inverse kinematics of the chain are wrong.
# Remedy: write <axis xyz="1 0 0"/> into the file.
set -euo pipefail
folder=$(mktemp -d); trap 'rm -rf "$folder"' EXIT; cd "$folder"
python3 -m venv venv && venv/bin/pip install -q --disable-pip-version-check kinpy==0.6.1 pytransform3d==3.17.0 numpy==2.4.6
cat > try.py <<'P'
import sys
from importlib.metadata import version

import kinpy
import numpy as np
from pytransform3d.urdf import UrdfTransformManager

VALUE = 0.5  # rad, or m
ROBOT = """<robot name="arm"><link name="base"/><link name="tip"/>
<joint name="joint" type="{kind}"><parent link="base"/><child link="tip"/>{axis}
<limit lower="-3" upper="3" effort="1" velocity="1"/></joint></robot>"""


def by_kinpy(text: str) -> np.ndarray:
    return kinpy.build_chain_from_urdf(text).forward_kinematics({"joint": VALUE})["tip"].matrix()


def by_pytransform3d(text: str) -> np.ndarray:
    robot = UrdfTransformManager()
    robot.load_urdf(text)
    robot.set_joint("joint", VALUE)
    return robot.get_transform("tip", "base")


print("kinpy", version("kinpy"), "pytransform3d", version("pytransform3d"))
seen = True
for kind in ("revolute", "prismatic"):
    for reader, pose, behaviour in (("kinpy", by_kinpy, "z"), ("pytransform3d", by_pytransform3d, "x")):
        found = pose(ROBOT.format(kind=kind, axis=""))
        written = {name: pose(ROBOT.format(kind=kind, axis=f'<axis xyz="{xyz}"/>')) for name, xyz in (("x", "1 0 0"), ("z", "0 0 1"))}
        axes = [name for name, truth in written.items() if np.allclose(found, truth)]
        print(f"{kind} joint without <axis>, {reader}: axis {axes} (expected: x)")
        seen = seen and axes == [behaviour]
print("behaviour: kinpy takes z" if seen else "the behaviour has changed")
sys.exit(0 if seen else 1)
P
venv/bin/python try.py
