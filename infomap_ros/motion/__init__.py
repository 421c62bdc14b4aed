"""Robot models, and where they and what they carry can go."""
