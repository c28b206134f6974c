"""Files that are read and written: recordings, clouds, surfaces, settings and exports."""
