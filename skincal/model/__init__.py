"""What there is: readings, the scene, its skin and layout, and the error whose message the user reads."""
