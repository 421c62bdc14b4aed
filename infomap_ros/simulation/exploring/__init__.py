"""Explorations in one process and without ROS, and the truth that they are held against."""
