#!/usr/bin/env bash
# trimesh 5.2.0: sparse accessors of glTF are ignored without a message, so that vertices keep their old places.
#
# glTF 2.0 is a format of robot meshes (URDF, Drake, Isaac). A sparse accessor, in the core of the format (3.6.2.3), changes some
# entries of an array; exporters write it for edited or morphed shapes. Here it moves a corner of a triangle from [1, 0, 0] to
# [5, 0, 0]. Expected: the largest x is 5. Seen: 1, and no warning.
set -euo pipefail
folder=$(mktemp -d); trap 'rm -rf "$folder"' EXIT; cd "$folder"
python3 -m venv venv
venv/bin/pip install --quiet --disable-pip-version-check trimesh==5.2.0 numpy==2.3.5
cat > write.py <<'X'
import base64, json, struct

body = struct.pack("<9f", 0, 0, 0, 1, 0, 0, 0, 1, 0)  # three corners
body += struct.pack("<3H2x", 0, 1, 2)  # the triangle
body += struct.pack("<H2x", 1)  # the sparse accessor changes corner 1 ...
body += struct.pack("<3f", 5, 0, 0)  # ... to this place
uri = "data:application/octet-stream;base64," + base64.b64encode(body).decode()
document = {
    "asset": {"version": "2.0"}, "scene": 0, "scenes": [{"nodes": [0]}], "nodes": [{"mesh": 0}],
    "meshes": [{"primitives": [{"attributes": {"POSITION": 0}, "indices": 1}]}],
    "buffers": [{"byteLength": len(body), "uri": uri}],
    "bufferViews": [
        {"buffer": 0, "byteOffset": 0, "byteLength": 36}, {"buffer": 0, "byteOffset": 36, "byteLength": 6},
        {"buffer": 0, "byteOffset": 44, "byteLength": 2}, {"buffer": 0, "byteOffset": 48, "byteLength": 12},
    ],
    "accessors": [
        {"bufferView": 0, "componentType": 5126, "count": 3, "type": "VEC3", "min": [0, 0, 0], "max": [5, 1, 0],
         "sparse": {"count": 1, "indices": {"bufferView": 2, "componentType": 5123}, "values": {"bufferView": 3}}},
        {"bufferView": 1, "componentType": 5123, "count": 3, "type": "SCALAR"},
    ],
}
with open("part.gltf", "w") as file:
    json.dump(document, file)
X
python3 write.py
venv/bin/python - > seen 2> messages <<'X'
import trimesh

mesh = trimesh.load("part.gltf", force="mesh")
print(trimesh.__version__, mesh.vertices[:, 0].max())
X
read -r version largest < seen
echo "trimesh $version"
echo "expected: largest x 5.0; seen: $largest; messages: $(cat messages)"
if [ "$largest" != "1.0" ] || [ -s messages ]; then echo "the behaviour has changed"; exit 1; fi
