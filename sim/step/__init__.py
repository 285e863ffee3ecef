"""One step of the full system: schemes, forces, random numbers, and the compiled loop."""
