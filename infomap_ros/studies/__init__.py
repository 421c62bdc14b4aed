"""Experiments that show what the package can do, with the figures and tables that they make."""
