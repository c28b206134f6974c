"""Bodies from mesh files, and simulated scans of them (step 1)."""
