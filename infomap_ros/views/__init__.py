"""Where to look next: what views are expected to tell, which are possible, which is best."""
