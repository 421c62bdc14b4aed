"""Which views come first: the rating of one, and strategies over many."""
