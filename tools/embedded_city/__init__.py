"""Generator of the embedded data set: a procedural city, its traffic, and their tables."""
