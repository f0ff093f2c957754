"""Where each module is as a rigid body: its pose, its fit, and whether it lies as the layout plans it."""
