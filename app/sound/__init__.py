"""Sound cues and their player: silent, and never in the way, where there is no sound device."""
