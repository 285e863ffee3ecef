"""Energy shells of a system with one contact mass, compiled."""
