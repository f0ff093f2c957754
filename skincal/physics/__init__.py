"""A robot that pokes, in the physics engine MuJoCo (extra `physics`), and the interface of its arm."""
