"""Read points with MeshLab's library: positions, normals and quality."""

import json
import sys
from pathlib import Path

import pymeshlab

meshes = pymeshlab.MeshSet()
meshes.load_new_mesh(json.loads(sys.argv[1])["file"])
mesh = meshes.current_mesh()
result = {
    "positions": mesh.vertex_matrix().tolist(),
    "normals": mesh.vertex_normal_matrix().tolist(),
    "quality": mesh.vertex_scalar_array().tolist(),
}
Path(sys.argv[2]).write_text(json.dumps(result))
