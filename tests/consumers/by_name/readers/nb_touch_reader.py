"""Read a taxel geometry with nb-touch, and let its contact model find a push on one taxel."""

import json
import sys
from pathlib import Path

import numpy as np
from nb_touch.contact import ContactDetector, ContactSettings
from nb_touch.io import load_sensor_geometry

task = json.loads(sys.argv[1])
geometry = load_sensor_geometry(task["file"])
found = {"name": geometry.name, "positions": geometry.positions.tolist(), "pushes": []}
if geometry.orientations is not None:
    found["orientations"] = geometry.orientations.tolist()
    for taxel in task["pushed"]:
        forces = np.zeros((geometry.num_taxels, 3))
        forces[taxel] = task["reading"]
        (contact,) = ContactDetector(geometry, ContactSettings(min_taxels=1)).update(forces, in_taxel_frames=True)
        found["pushes"].append({"cop": contact.cop.tolist(), "force": contact.cop_force.tolist()})
Path(sys.argv[2]).write_text(json.dumps(found))
