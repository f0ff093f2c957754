"""Messages of ROS 1 and ROS 2: their definitions and the readings in them. No ROS is installed, and nothing is opened here."""
