"""Read a robot with urchin: mass and moving joints, and poses of names in the root link."""

import json
import sys
from pathlib import Path

import urchin

task = json.loads(sys.argv[1])
robot = urchin.URDF.load(task["file"], lazy_load_meshes=True)
moving = [joint.name for joint in robot.joints if joint.joint_type != "fixed"]
poses = []
for angles in task["angles"]:
    placed = robot.link_fk(angles, use_names=True)
    poses.append({name: placed[name].tolist() for name in task["names"] if name in placed})
Path(sys.argv[2]).write_text(
    json.dumps({"mass": sum(link.inertial.mass for link in robot.links), "moving": moving, "poses": poses})
)
