#!/usr/bin/env bash
# DART's reader of MJCF (dartpy 6.20.0) gives each body a moment of inertia of 1 kg m2, and reads a hinge's degrees as radians.
#
# MJCF takes a body's inertia from <inertial>, or else from its geoms; <joint range> of a hinge is in degrees unless <compiler
# angle> says otherwise (XML reference of MuJoCo). Expected: what MuJoCo compiles from the same file. Seen: the moment of inertia
# is the unit matrix, both for a geom's body and for a written diaginertia, with the right mass where the body has a geom. A body
# with <inertial> and no geom has 1 kg, too. An upper limit of 40 degrees is 40 rad. Poses (euler in degrees) are right. No
# message. A small link (hand, fingertip) resists rotation thousands of times too much.
# Remedy: set mass, moment and limits of each body from MuJoCo's compiled model.
set -euo pipefail
folder=$(mktemp -d); trap 'rm -rf "$folder"' EXIT; cd "$folder"
python3 -m venv venv && venv/bin/pip install -q --disable-pip-version-check dartpy==6.20.0 mujoco==4.0.0 numpy==2.4.6
cat > try.py <<'P'
import sys
from pathlib import Path

import dartpy
import mujoco
import numpy as np

HAND = '<mujoco><worldbody><body name="hand"><joint name="wrist" axis="0 0 1" range="-30 40"/>{}</body></worldbody></mujoco>'
GEOM = '<geom type="box" size=".03 .04 .05" mass="0.6"/>'
WRITTEN = '<inertial pos="0 0 0" mass="0.3" diaginertia="1e-4 2e-4 2.5e-4"/>'
BODIES = {"from a geom": GEOM, "written, with a geom": WRITTEN + GEOM, "written alone": WRITTEN}
ONE = np.eye(3)
seen = True
print("dartpy", dartpy.__version__ if hasattr(dartpy, "__version__") else "6.20.0", "MuJoCo", mujoco.__version__)
for name, content in BODIES.items():
    path = Path("hand.xml").resolve()
    path.write_text(HAND.format(content))
    model = mujoco.MjModel.from_xml_path(str(path))
    skeleton = dartpy.utils.MjcfParser.readWorld(str(path)).getSkeleton(0)
    inertia = skeleton.getBodyNode("hand").getInertia()
    limit = skeleton.getPositionUpperLimits()[0]
    turned = np.zeros(9)
    mujoco.mju_quat2Mat(turned, model.body_iquat[1])
    theirs = turned.reshape(3, 3) @ np.diag(model.body_inertia[1]) @ turned.reshape(3, 3).T
    print(f"{name}: MuJoCo {model.body_mass[1]:.3f} kg, {np.diag(theirs).round(6)} kg m2, limit {model.jnt_range[0, 1]:.3f} rad")
    print(f"{name}: DART   {inertia.getMass():.3f} kg, {np.diag(inertia.getMoment())} kg m2, limit {limit:.3f} rad")
    mass = 1.0 if name == "written alone" else model.body_mass[1]
    seen = seen and np.allclose(inertia.getMoment(), ONE) and np.isclose(inertia.getMass(), mass) and np.isclose(limit, 40.0)
    assert np.diag(theirs).max() < 2e-3, "MuJoCo's own answer has changed"
    assert np.isclose(model.jnt_range[0, 1], np.deg2rad(40.0)), "MuJoCo's own answer has changed"
print("behaviour: 1 kg m2 and 40 rad" if seen else "the behaviour has changed")
sys.exit(0 if seen else 1)
P
venv/bin/python try.py
