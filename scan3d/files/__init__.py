"""Reading and writing of files: recordings, clouds, surfaces, settings and exports."""
