"""Step 1: bodies from mesh files, and scans of them that are computed instead of measured."""
