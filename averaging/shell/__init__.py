"""Energy shells: reduced potential, integrals along rays and along the chain, averages."""
