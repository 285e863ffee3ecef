"""Where the density of a coordinate is known not to be smooth."""

from fpk.linear import natural_modes
from fpk.observable import Coordinate
from fpk.system import System


def kinks_of(system: System, coordinate: Coordinate) -> list[float]:
    """Return the values, ascending, at which the density of a coordinate may have a kink.

    Of q_i the positions of the stops of mass i; of H the least energy at which each stop is
    touched, ½ δ²/C_ii and the contact energy of nearer stops there, C the compliance; of H_m the
    energy at which mode m alone touches it, ½ (ω_m δ/T_im)². Of a momentum there are none.
    """
    at = {stop: stop.sign * stop.clearance for stop in system.stops}
    if coordinate.kind == "q":
        return sorted({x for stop, x in at.items() if stop.index == coordinate.row})
    if coordinate.kind == "p":
        return []
    if coordinate.index is None:
        energies = [
            0.5 * x * x / float(system.compliance[stop.index, stop.index])
            + float(system.contact_energy(stop.index, x))
            for stop, x in at.items()
        ]
    else:
        shapes, omega = natural_modes(system)
        shape, frequency = shapes[:, coordinate.row], omega[coordinate.row]
        energies = [
            0.5 * (frequency * x / float(shape[stop.index])) ** 2
            for stop, x in at.items()
            if shape[stop.index] != 0.0
        ]
    return sorted(set(energies))
