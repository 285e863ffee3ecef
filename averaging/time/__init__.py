"""Energies, displacements and momenta after a start, by the averaged equations.

``start`` has where energies begin, ``states`` displacements and momenta from the density of the
total energy by finite elements.
"""
