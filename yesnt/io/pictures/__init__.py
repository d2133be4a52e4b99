"""Reads pictures that other programs wrote: channels, windows, alpha and colour as the job means them."""
