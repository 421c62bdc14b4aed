"""Robots by other people: what their descriptions say, what is guessed, and the file that holds both."""
