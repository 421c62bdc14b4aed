"""Topics that the robots of a team share, as nodes hear and tell them."""
