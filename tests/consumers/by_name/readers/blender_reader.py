"""Read points with Blender: positions and further attributes."""

import json
import sys
from pathlib import Path

import bpy

bpy.ops.wm.read_factory_settings(use_empty=True)
bpy.ops.wm.ply_import(filepath=json.loads(sys.argv[1])["file"], forward_axis="Y", up_axis="Z", merge_verts=False)
mesh = bpy.context.object.data
values = {}
for attribute in mesh.attributes:
    values[attribute.name] = [getattr(each, "value", getattr(each, "vector", None)) for each in attribute.data]
    values[attribute.name] = [list(each) if hasattr(each, "__len__") else each for each in values[attribute.name]]
Path(sys.argv[2]).write_text(json.dumps(values))
