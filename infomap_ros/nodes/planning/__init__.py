"""Parts of the nodes next_best_view and explorer."""
