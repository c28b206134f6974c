"""Simulated scans of a body (step 1)."""
