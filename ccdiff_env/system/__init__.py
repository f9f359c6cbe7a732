"""Files, terminals, progress and names of Python: what lies outside of the package."""
