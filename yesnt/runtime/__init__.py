"""Runs a plan: clusters, driver, session, checks before work."""
