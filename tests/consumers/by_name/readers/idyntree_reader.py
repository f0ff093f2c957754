"""Read a robot with iDynTree: mass, moving joints, and poses of names in the root link."""

import json
import sys
from pathlib import Path

import idyntree.bindings as idyn
import numpy as np

task = json.loads(sys.argv[1])
loader = idyn.ModelLoader()
assert loader.loadModelFromFile(task["file"])
model = loader.model()
computations = idyn.KinDynComputations()
assert computations.loadRobotModel(model)
moving = [model.getJointName(i) for i in range(model.getNrOfJoints()) if model.getJoint(i).getNrOfDOFs()]
poses = []
for angles in task["angles"]:
    values = np.array([angles[name] for name in moving])
    still = np.zeros(len(values))
    assert computations.setRobotState(np.eye(4), values, np.zeros(6), still, np.array([0, 0, -9.81]))
    found = {}
    for name in task["names"]:
        if model.isFrameNameUsed(name):
            found[name] = computations.getRelativeTransform(task["base"], name).asHomogeneousTransform().toNumPy().tolist()
    poses.append(found)
Path(sys.argv[2]).write_text(json.dumps({"mass": model.getTotalMass(), "moving": moving, "poses": poses}))
