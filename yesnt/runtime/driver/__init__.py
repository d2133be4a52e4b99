"""Runs a graph of tasks on a cluster: order, retries, dead workers, shortages."""
