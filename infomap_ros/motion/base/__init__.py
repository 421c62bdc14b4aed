"""Where the base can stand, and its paths over rough ground."""
