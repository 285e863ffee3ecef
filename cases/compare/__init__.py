"""Routes, the run of a scene, comparisons and claims."""
