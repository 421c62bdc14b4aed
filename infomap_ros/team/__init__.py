"""What robots send each other of the map: the wire format of map updates, and their merge."""
