"""Every information metric in the same loop, the same worlds and the same strategy."""
