"""Readers of a trace that see when each trajectory first passes its limit, between steps too."""

import numpy as np

from fpk.arrays import Array, Integers
from fpk.compiling import cached_njit
from sim.arrays import LANES as W
from sim.motion.between import BULGE, cubic_of, first_passage

NATS = 40.0
"""−ln of a probability that counts as none: 4e-18."""


@cached_njit()
def pass_displacement(
    trace: Array, samples: int, done: int, time: Array, dt: float, row: int, inverse_mass: float,
    limit: float,
) -> None:  # fmt: skip
    """Write when |q| in ``row`` first passes ``limit`` to ``time`` (blocks, 1, LANES), if inf.

    Between samples q is the cubic through q and v at both ends. Momenta are as many rows behind.
    """
    momentum = row + (trace.shape[2] // 2)
    for b in range(trace.shape[0]):
        own = time[b, 0]
        for k in range(samples):
            q0, q1 = trace[b, k, row], trace[b, k + 1, row]
            p0, p1 = trace[b, k, momentum], trace[b, k + 1, momentum]
            slope = BULGE * dt * inverse_mass
            near = 0
            for w in range(W):
                reach = max(abs(q0[w]), abs(q1[w])) + slope * (abs(p0[w]) + abs(p1[w]))
                near += np.int64((reach >= limit) & (own[w] == np.inf))
            if near == 0:
                continue
            for w in range(W):
                reach = max(abs(q0[w]), abs(q1[w])) + slope * (abs(p0[w]) + abs(p1[w]))
                if reach >= limit and own[w] == np.inf:
                    cubic = cubic_of(q0[w], inverse_mass * p0[w], q1[w], inverse_mass * p1[w], dt)
                    share = first_passage(cubic, limit)
                    if share <= 1.0:
                        own[w] = (done + k + share) * dt


@cached_njit()
def pass_energies(
    trace: Array, samples: int, done: int, time: Array, chance: Array, dt: float, first: int,
    rows: Integers, limits: Array, forms: Array,
) -> None:  # fmt: skip
    """Write when one of the energies in ``rows`` first passes its limit to ``time``, where inf.

    Energies pass by diffusion. Between samples (h apart) each is a Brownian bridge with the local
    variance V = ½ h (p'Fp + p'Fp), F of ``forms`` (limits, n, n), momenta from row ``first`` on: it
    passes L with the probability exp(−2 (L − H0)(L − H1)/V), and then at the share
    (L − H0)/(2 L − H0 − H1) of the step (H1 < L), the mean of which is that of the bridge.
    ``chance`` (blocks, limits, LANES) holds an exponential number for each: that limit is passed
    when the sum of −ln(1 − probability) is more. One number for all steps: the same motion at
    another step passes at nearly the same time.
    """
    n = forms.shape[1]
    variance, before = np.empty(W), np.empty(W)
    for b in range(trace.shape[0]):
        own = time[b, 0]
        for m in range(rows.size):
            left = chance[b, m]
            for k in range(samples + 1):
                variance[:] = 0.0
                for i in range(n):
                    for j in range(n):
                        factor = 0.5 * dt * forms[m, i, j]
                        if factor != 0.0:
                            pi, pj = trace[b, k, first + i], trace[b, k, first + j]
                            for w in range(W):
                                variance[w] += factor * pi[w] * pj[w]
                if k > 0:
                    H0, H1, limit = trace[b, k - 1, rows[m]], trace[b, k, rows[m]], limits[m]
                    near = 0
                    for w in range(W):
                        nats = 2.0 * (limit - H0[w]) * (limit - H1[w])
                        bridge = nats < NATS * (variance[w] + before[w])
                        near += np.int64(bridge | (H1[w] >= limit))
                    if near > 0:
                        for w in range(W):
                            below, after = limit - H0[w], limit - H1[w]
                            V = variance[w] + before[w]
                            end = (done + k) * dt
                            # Of several limits in one step the first one counts.
                            if not own[w] > end - dt:
                                continue
                            if after > 0.0:
                                nats = 2.0 * below * after
                                if not nats < NATS * V:
                                    continue
                                left[w] += np.log1p(-np.exp(-nats / V))
                                if left[w] > 0.0:
                                    continue
                            elif not after <= 0.0:
                                continue
                            share = below / (below + abs(after))
                            own[w] = min(own[w], end - dt * (1.0 - share))
                before[:] = variance
