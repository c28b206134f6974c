"""Computational geometry of triangle meshes and convex bodies; it knows nothing of rods and contacts."""
