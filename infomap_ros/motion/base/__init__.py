"""Where the base can stand, and its ways over rough ground."""
