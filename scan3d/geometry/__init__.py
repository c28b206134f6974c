"""Triangle meshes, convex bodies and the distances between them: computational geometry that knows nothing of touch."""
