"""Information-driven stereo mapping for mobile manipulators with ROS 2."""
