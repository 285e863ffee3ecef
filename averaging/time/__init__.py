"""Energies, displacements and momenta after a start, by the averaged equations.

``start`` has where energies begin, ``energy`` the total energy in time, ``states`` displacements
and momenta from its density by finite elements.
"""
