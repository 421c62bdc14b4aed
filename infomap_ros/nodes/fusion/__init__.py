"""Parts of the node map_fusion."""
