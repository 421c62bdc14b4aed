"""Topics that the robots of a team share, as nodes receive and send them."""
