"""Inverse kinematics, and ways of the arm with their times."""
