"""Carrying out base_path and arm_trajectory on the controllers of a robot."""
