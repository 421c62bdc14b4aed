"""How a robot stands, drives, moves its arm and touches things."""
