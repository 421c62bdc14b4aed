"""Exploration: the loop that looks, decides and moves, and the report that it leaves."""
