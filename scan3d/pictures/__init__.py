"""What is seen of a scan: pictures, pages, windows, movies, and tables in notebooks."""
