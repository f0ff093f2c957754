"""Where to poke next, from which side, and when it is enough."""
