"""Back to the robot: positions to a running skinManager, and the guide's targets to a robot that pokes."""
