#!/usr/bin/env bash
# MuJoCo: touch sensors on the sites of an attached body stay silent, though the body has no joint and is pressed.
#
# A skin (sites and touch sensors on a body without geoms) is attached to a robot's link by <attach body=...> or
# MjSpec.attach_body, the way that a part is usually added. The sites are at the right places, and no message appears.
# Expected: 5 N on the link within the site give 5 N. Seen: 0 N, for ever, because a touch sensor counts only contacts of geoms
# of the site's own body, and the massless static body is not fused with the link (MJCF's default is fusestatic="false").
# Remedy: put the sites into a <frame>, and attach that frame: 5 N.
set -euo pipefail
folder=$(mktemp -d); trap 'rm -rf "$folder"' EXIT; cd "$folder"
python3 -m venv venv && venv/bin/pip install -q --disable-pip-version-check mujoco==4.0.0 numpy==2.4.6
cat > try.py <<'P'
import sys
import mujoco

SKIN = """<mujoco><worldbody><body name="skin"><frame name="frame"><site name="pad" size=".003" pos="0 0 .05"/></frame></body>
</worldbody><sensor><touch name="pad" site="pad"/></sensor></mujoco>"""
ROBOT = """<mujoco><option gravity="0 0 0"/><worldbody><body name="link"><geom type="box" size=".05 .05 .05"/></body>
<body name="ball" pos="0 0 .054"><joint name="push" type="slide" axis="0 0 -1" damping="1"/><geom size=".004" mass=".05"/></body>
</worldbody></mujoco>"""


def force(attach: str) -> float:
    robot, skin = mujoco.MjSpec.from_string(ROBOT), mujoco.MjSpec.from_string(SKIN)
    if attach == "body":
        robot.body("link").add_frame().attach_body(skin.body("skin"), "a_", "")
    else:
        robot.body("link").attach_frame(skin.frame("frame"), "a_", "")
    model = robot.compile()
    data = mujoco.MjData(model)
    data.qfrc_applied[0] = 5.0
    mujoco.mj_step(model, data, 300)
    assert abs(data.site("a_pad").xpos[2] - 0.05) < 1e-9
    return float(data.sensordata[0])


print("MuJoCo", mujoco.__version__)
body, frame = force("body"), force("frame")
print(f"5 N on the site of an attached body:  {body:.2f} N (expected by users: 5, behaviour: 0)")
print(f"5 N on the site of an attached frame: {frame:.2f} N")
sys.exit(0 if body == 0.0 and abs(frame - 5.0) < 0.05 else 1)
P
venv/bin/python try.py
