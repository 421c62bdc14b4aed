"""Whole runs: nodes as processes, watched from outside; launch files and demos."""
