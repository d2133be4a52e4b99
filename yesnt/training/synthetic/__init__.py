"""Training pictures that the project makes itself: shapes, painted materials, soft capture light, a camera's faults."""
