"""What commands on bags have in common."""
