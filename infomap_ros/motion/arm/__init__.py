"""Inverse kinematics, and paths of the arm with their times."""
