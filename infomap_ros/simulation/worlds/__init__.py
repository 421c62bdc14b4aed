"""Worlds from a seed: ground, rocks, rooms, textures, and their true surface."""
