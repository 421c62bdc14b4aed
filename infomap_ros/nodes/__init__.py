"""ROS 2 nodes: convert a message, call one core object, convert its answer, publish.

The only room that imports rclpy and message packages.
"""
