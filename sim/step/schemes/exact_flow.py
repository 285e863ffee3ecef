"""Modified contact kick, then the exact flow of everything linear; fourth order in the contact.

Without contact the step is exact for any h. The force of Takahashi and Imada (J. Phys. Soc. Japan
53, 1984, 3765), ``g_i (1 − h² g_i'/(12 m_i))``, leaves an error of second order that a change of
variables removes, the processor; its derivation is in docs/theory.md, "The step of the simulation".
"""

from sim.step.flow import exact_flow
from sim.step.schemes import Scheme, register

EXACT_FLOW = register(
    Scheme(name="exact_flow", weak_order=4, linear_map=exact_flow, modified=1.0 / 12.0)
)
