"""The turn of taxels that measure three axes: the rotation from the axes of a taxel to the frame of the part."""
