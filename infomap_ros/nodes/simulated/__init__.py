"""Parts of the node simulator, and how other nodes are set up for it."""
