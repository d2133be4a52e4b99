"""Answers questions about a job without running it: status, verify, explain, cost forecast, doctor."""
