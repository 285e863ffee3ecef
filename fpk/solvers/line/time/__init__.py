"""One energy in time: elements with diagonal bubbles, transients, rates and first passage."""
