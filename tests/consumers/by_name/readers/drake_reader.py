"""Read a robot with Drake, with a skin welded to it if there is one: mass, moving joints, bodies, and poses of names."""

import json
import sys
from pathlib import Path

from pydrake.multibody.parsing import Parser
from pydrake.multibody.plant import MultibodyPlant

task = json.loads(sys.argv[1])
plant = MultibodyPlant(0.0)
parser = Parser(plant)
(robot,) = parser.AddModels(task["file"])
for each in task.get("skins", []):
    (skin,) = parser.AddModels(each["file"])
    plant.WeldFrames(plant.GetFrameByName(each["link"], robot), plant.GetFrameByName(each["link"], skin))
base = plant.GetFrameByName(task["base"], robot)
plant.WeldFrames(plant.world_frame(), base)
plant.Finalize()
context = plant.CreateDefaultContext()
joints = [plant.get_joint(i) for i in plant.GetJointIndices(robot)]
moving = [joint.name() for joint in joints if joint.num_positions()]
poses = []
for angles in task["angles"]:
    values = plant.GetPositions(context)
    for joint in joints:
        if joint.num_positions():
            values[joint.position_start()] = angles[joint.name()]
    plant.SetPositions(context, values)
    found = {}
    for name in task["names"]:
        if plant.HasFrameNamed(name):
            found[name] = plant.GetFrameByName(name).CalcPose(context, base).GetAsMatrix4().tolist()
    poses.append(found)
mass, matrix = plant.CalcTotalMass(context), plant.CalcMassMatrix(context)
result = {"mass": mass, "moving": moving, "bodies": plant.num_bodies(), "mass_matrix": matrix.tolist(), "poses": poses}
Path(sys.argv[2]).write_text(json.dumps(result))
