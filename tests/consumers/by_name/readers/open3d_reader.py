"""Read points with Open3D: positions, normals and further attributes."""

import json
import sys
from pathlib import Path

import open3d

cloud = open3d.t.io.read_point_cloud(json.loads(sys.argv[1])["file"])
Path(sys.argv[2]).write_text(json.dumps({name: cloud.point[name].numpy().tolist() for name in cloud.point}))
