#!/usr/bin/env bash
# libsdformat 12.3.0 (Debian 12, Gazebo Fortress): a link without mass on a fixed joint vanishes from a URDF without a message.
#
# URDF's usual frame (camera_frame, tool0) is a link without <inertial> on a fixed joint. `ign sdf -p` converts the robot with
# exit code 0 and no message on it. Expected: a <frame>, as libsdformat 13.1 and newer make it. Seen: neither link nor frame.
# A robot of one such link alone becomes a <model> without a link, which the same program then refuses as invalid.
# Needs Debian's packages ignition-tools and libsdformat-dev (12.3.0), which are not on the Python package index.
set -euo pipefail
command -v ign > /dev/null || { echo "ign is missing: apt-get install ignition-tools libsdformat-dev (Debian 12)"; exit 2; }
folder=$(mktemp -d); trap 'rm -rf "$folder"' EXIT; cd "$folder"
cat > robot.urdf <<'X'
<robot name="arm">
  <link name="base"><inertial><mass value="1"/><inertia ixx="1" ixy="0" ixz="0" iyy="1" iyz="0" izz="1"/></inertial></link>
  <link name="hand"><inertial><mass value="1"/><inertia ixx="1" ixy="0" ixz="0" iyy="1" iyz="0" izz="1"/></inertial></link>
  <joint name="wrist" type="revolute"><parent link="base"/><child link="hand"/><axis xyz="0 0 1"/>
    <limit lower="-1" upper="1" effort="1" velocity="1"/></joint>
  <link name="fingertip_frame"/>
  <joint name="fingertip_joint" type="fixed"><parent link="hand"/><child link="fingertip_frame"/><origin xyz="0 0 .1"/></joint>
</robot>
X
echo "libsdformat $(dpkg-query -W -f '${Version}' libsdformat-dev)"
ign sdf -p robot.urdf > robot.sdf 2> messages || { echo "the conversion is refused now"; exit 1; }
echo "links and frames after the conversion: $(grep -oE "<(link|frame) name='[^']*'" robot.sdf | tr '\n' ' ')"
echo "messages: $(cat messages)"
echo "expected by users: a frame fingertip_frame, or a message on it; behaviour: neither"
grep -q "link name='hand'" robot.sdf
if grep -q fingertip robot.sdf || grep -qi fingertip messages; then echo "the behaviour has changed"; exit 1; fi
