"""Who follows a session: the guide, checks of the rig, the error course, reviews and results."""
