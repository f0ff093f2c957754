#!/usr/bin/env bash
# Pinocchio's reader of MJCF takes the limits of a slide joint for degrees: 40 mm of travel become 0.7 mm.
#
# A gripper's finger has a slide joint, <joint type="slide" range="0 0.04"/>. MJCF's angles are in degrees unless <compiler angle>
# says otherwise; lengths are in metres (XML reference, "joint/range": degrees or radians for hinge and ball joints alone).
# Expected: an upper limit of 0.04 m, as in MuJoCo. Seen: 0.000698, which is 0.04 degrees in radians. No message. So a solver of
# inverse kinematics or a planner keeps the finger still. Poses and masses of the same model are right.
# Remedy: angle="radian" in <compiler>, as MuJoCo's own saved files have it.
set -euo pipefail
folder=$(mktemp -d); trap 'rm -rf "$folder"' EXIT; cd "$folder"
python3 -m venv venv && venv/bin/pip install -q --disable-pip-version-check pin==4.1.0 mujoco==4.0.0 numpy==2.4.6
cat > try.py <<'P'
import sys
from importlib.metadata import version

import mujoco
import numpy as np
import pinocchio

FINGER = """<mujoco>{compiler}<worldbody><body name="palm"><joint name="wrist" axis="0 0 1" range="{hinge}"/>
<geom size=".02"/><body name="finger" pos="0 0 .05"><joint name="finger" type="slide" axis="0 1 0" range="0 0.04"/>
<geom size=".01"/></body></body></worldbody></mujoco>"""


def limits(compiler: str, hinge: str) -> tuple[np.ndarray, np.ndarray]:
    """Upper limits of hinge and slide, by MuJoCo and by pinocchio."""
    with open("gripper.xml", "w") as file:
        file.write(FINGER.format(compiler=compiler, hinge=hinge))
    theirs, ours = mujoco.MjModel.from_xml_path("gripper.xml"), pinocchio.buildModelFromMJCF("gripper.xml")
    return theirs.jnt_range[:, 1], ours.upperPositionLimit


print("pinocchio", version("pin"), "MuJoCo", mujoco.__version__)
degrees, radians = limits("", "-90 90"), limits('<compiler angle="radian"/>', "-1.5707963 1.5707963")
for name, (simulated, found) in (("degrees", degrees), ("radians", radians)):
    print(f"angles in {name}: MuJoCo {simulated[0]:.4f} rad, {simulated[1]:.6f} m; pinocchio {found[0]:.4f} rad, {found[1]:.6f} m")
print("expected by users: 0.04 m both times; behaviour: 0.04 degrees, where angles are in degrees")
seen = np.allclose(radians[1], radians[0], atol=1e-6) and np.allclose(degrees[1], [np.pi / 2, np.deg2rad(0.04)], atol=1e-9)
sys.exit(0 if seen and np.allclose(degrees[0], [np.pi / 2, 0.04]) else 1)
P
venv/bin/python try.py
