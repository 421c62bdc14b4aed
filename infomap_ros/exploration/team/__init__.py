"""A robot that explores with others."""
