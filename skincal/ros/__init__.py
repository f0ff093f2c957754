"""Messages of ROS 1 and ROS 2: their definitions and the readings in them. No ROS is needed. Only `dds` opens a network."""
