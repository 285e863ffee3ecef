"""How the pictures of a run are drawn."""
