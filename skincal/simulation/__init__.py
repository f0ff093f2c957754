"""Simulated rigs: skin, force/torque sensor, operator, and the bytes of their devices."""
