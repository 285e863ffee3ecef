"""Modified contact kick, then the exact flow of everything linear; fourth order in the contact.

With the generators ``L_A`` of the linear flow (springs, damping, noise) and ``L_B = −g_i ∂/∂p_i``
of the contact, the symmetric step e^{hB/2} e^{hA} e^{hB/2} is the flow of

    A + B + h² (a [A,[A,B]] + b [B,[A,B]]) + O(h⁴).

The modified force of Takahashi and Imada (J. Phys. Soc. Japan 53, 1984, 3765),
``g_i (1 − h² g_i'/(12 m_i))``, moves the weight of ``[B,[A,B]]`` (a force along p, since
contact acts on each mass alone) to that of ``[A,[A,B]]``, so that what is left is ``[C, A + B]``
with the processor ``C = [L_A, L_B]``. The noise commutes with B's coefficients, which hold no
momenta, so that C is of first order:

    C = (g_j/m_j) ∂/∂q_j − (g_i' p_i/m_i + c_ik g_k/m_k) ∂/∂p_i .

A change of variables by C removes it: the state ``x* = x − (h²/12) C x``, that is

    q_i* = q_i − h² g_i / (12 m_i)
    p_i* = p_i (1 + h² g_i' / (12 m_i)) + (h²/12) Σ_k c_ik g_k / m_k ,

has the averages of the continuous system to O(h⁴), where p_i is the momentum in the middle of
the kick, ``p_i − (h/2) g_i (1 − h² g_i'/(12 m_i))`` of the state stored just before it.
Without contact the step is exact for any h. Damping that depends on the state is split off on both
sides of the kick, with a processor of its own: see ``sim.parts.damping``.
"""

from sim.flow import exact_flow
from sim.scheme import Scheme, register

EXACT_FLOW = register(
    Scheme(name="exact_flow", weak_order=4, linear_map=exact_flow, modified=1.0 / 12.0)
)
