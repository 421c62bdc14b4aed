"""Candidates for the next view: where a camera may be, and where it looks from there."""
