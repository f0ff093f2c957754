#!/usr/bin/env bash
# Pinocchio's reader of MJCF drops everything inside a <frame>: geoms with their mass, bodies and joints, without a message.
#
# <frame> only moves what it contains; MuJoCo reads both models below as the same robot, and writes <frame> itself when it saves
# a model that was put together from parts. Expected: the same joints and mass. Seen: joint, body and 1 kg inside are gone.
set -euo pipefail
folder=$(mktemp -d); trap 'rm -rf "$folder"' EXIT; cd "$folder"
python3 -m venv venv && venv/bin/pip install -q --disable-pip-version-check pin==4.1.0 mujoco==4.0.0 numpy==2.4.6
cat > try.py <<'P'
import sys
from importlib.metadata import version

import mujoco
import pinocchio

ARM = """<mujoco><worldbody><body name="base"><joint name="first" axis="0 0 1"/><geom size=".1" mass="1"/>{}</body>
</worldbody></mujoco>"""
HAND = '<body name="hand" pos="0 0 .5"><joint name="second" axis="0 1 0"/><geom size=".1" mass="1"/></body>'
found = {}
for name, text in (("plain", ARM.format(HAND)), ("in a <frame>", ARM.format(f"<frame>{HAND}</frame>"))):
    with open("robot.xml", "w") as file:
        file.write(text)
    theirs, ours = mujoco.MjModel.from_xml_path("robot.xml"), pinocchio.buildModelFromMJCF("robot.xml")
    # Of the moving joints: the second body's mass is behind the second joint.
    found[name] = (theirs.nv, float(theirs.body_mass.sum()), ours.nv, pinocchio.computeTotalMass(ours))
    print(f"{name:13s} MuJoCo: {theirs.nv} joints, {found[name][1]:g} kg; pinocchio: {ours.nv} joints, {found[name][3]:g} kg")
print("pinocchio", version("pin"), "MuJoCo", mujoco.__version__, "- expected by users: the same; behaviour: the hand is lost")
plain, framed = found["plain"], found["in a <frame>"]
sys.exit(0 if plain == (2, 2.0, 2, 2.0) and framed == (2, 2.0, 1, 1.0) else 1)
P
venv/bin/python try.py
