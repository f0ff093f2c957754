"""What is wrong with the rig: its correction, the fit of it, what pokes at landmarks will gain, and the sensor-frame check."""
