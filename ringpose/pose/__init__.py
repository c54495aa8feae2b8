"""Break points -> pose of the ring."""
