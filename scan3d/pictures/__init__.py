"""Pictures, pages, windows and movies of a scan, and tables of results in notebooks."""
