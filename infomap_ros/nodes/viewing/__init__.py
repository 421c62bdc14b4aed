"""What the node web_viewer reads from the graph and writes to it."""
