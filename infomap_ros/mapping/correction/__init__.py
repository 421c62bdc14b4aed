"""Scans that are kept, and put where they belong when their poses are corrected."""
