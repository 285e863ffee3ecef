"""Scene files: read, checked and turned into systems."""
