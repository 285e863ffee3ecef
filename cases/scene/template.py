"""The text of a new scene: a chain with a stop that its last mass reaches."""

from math import sqrt

from cases.scene.json_schema import DIRECTIVE
from fpk.contact_law import LAWS

DAMPING, NOISE = (0.08, 0.04), (0.01, 0.02)
"""Values of c_i and of D_i, which alternate along the chain: those of Fig. 6, whose ratios differ,
so that the compatibility condition (8) does not hold."""
STIFFNESS = 10.0
"""B of the stops: the force at an overlap of 1."""
COLUMN = 40
"""Column of the comments."""
FURTHER = """
# [vary]                                 # further curves: one key, several values
# contact.stiffness = [1.0, 100.0]

# [[passage]]                            # when is this first passed, how likely by these times?
# limit = "H=1.0"
# times = [10.0, 100.0]
"""


def scene_text(name: str, masses: int, law: str) -> str:
    """Return a commented scene of ``masses`` unit masses whose last one has stops of the ``law``.

    The clearance is the rms displacement of the last mass without stops, were all of the chain at
    one temperature Σ D/Σ c: there √(masses · temperature), the springs being of unit stiffness.
    """
    damping, noise = ([values[i % 2] for i in range(masses)] for values in (DAMPING, NOISE))
    clearance = float(f"{sqrt(masses * sum(noise) / sum(damping)):.2g}")
    ones = [1.0] * masses
    exponent = [("exponent  = 2.0", "of the law power")] if LAWS[law].exponent is None else []
    commented = [
        ("[units]", "names only: every number is in these units as it stands"),
        ('length = "m"', ""),
        ('mass   = "kg"', ""),
        ('time   = "s"', ""),
        ("", ""),
        ("[system]", "masses in a row, mass 1 nearest to the wall"),
        (f"mass            = {ones}", "m_i"),
        (f"stiffness       = {ones}", "k_i joins mass i to mass i-1, k_1 to the wall"),
        (f"damping         = {damping}", "c_i, or a full matrix"),
        (f"noise_intensity = {noise}", "D_i with E[W W'] = 2 D delta, or a full matrix"),
        ("", ""),
        ("[[contact]]", "one table a stop; none: a linear chain"),
        (f"mass      = {masses}", "counted from 1"),
        ('side      = "both"', '"left", "right" or "both"'),
        (f'law       = "{law}"', f"one of {', '.join(sorted(LAWS))}"),
        *exponent,
        (f"stiffness = {STIFFNESS}", "force at an overlap of 1"),
        (f"clearance = {clearance}", "about the rms displacement without stops"),
        ("", ""),
        ("[observe]", ""),
        (f'densities = ["q{masses}", "H"]', 'q1.., p1.., H, H1.., or a pair "q1,p1"'),
        (f"exceedance = {{ q{masses} = [{2 * clearance:.2g}] }}", "levels a of P(X > a)"),
    ]
    lines = [f"{line:{COLUMN}} # {words}" if words else line for line, words in commented]
    head = [DIRECTIVE, f'title  = "{name}"', 'source = "where the values come from"', ""]
    return "\n".join([*head, *lines, FURTHER])
