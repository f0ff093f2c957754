"""A rig that is not there: forearm, skin, force/torque sensor and operator, down to the bytes of their devices.

Nothing above this package asks whether readings come from here.
"""
