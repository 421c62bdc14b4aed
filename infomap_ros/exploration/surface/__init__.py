"""Holes in the mapped surface, and views that close them."""
