"""A part that is being described: its mesh, robot, sensor and layout, until it is a scene."""
