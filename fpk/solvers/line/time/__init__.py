"""One energy in time: elements in their own modes, transients, rates and first passage."""
