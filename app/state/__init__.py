"""What a tick hands to the views, and what may be done now: frozen values and pure functions."""
