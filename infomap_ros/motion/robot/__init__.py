"""The robot as its description gives it: joints, links, masses, solids."""
