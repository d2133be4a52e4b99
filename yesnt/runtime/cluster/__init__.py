"""Opens a run's cluster, prepares its workers, and ends it."""
