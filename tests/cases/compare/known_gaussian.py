"""Quantities of linear systems without contact, by linear algebra of their own.

The state is Gaussian. Of its covariance S and the energy H = xᵀAx the cumulants are
2^(k−1) (k−1)! tr (AS)^k; the distribution function comes from its transform by Talbot's contour.
"""

from math import factorial

import mpmath as mp
import numpy as np
from scipy import stats


def of_cumulants(mean, second, third, fourth):
    """Mean, rms, std, skewness, kurtosis."""
    std = np.sqrt(second)
    skewness, kurtosis = third / std**3, 3.0 + fourth / second**2
    return {
        "mean": (mean, std), "rms": (np.hypot(mean, std), std), "std": (std, std),
        "skewness": (skewness, 1.0), "kurtosis": (kurtosis, 1.0 + kurtosis),
    }  # fmt: skip


def normal_truth(normal):
    """The quantities of a centred normal coordinate."""
    std = normal.std()
    known = {
        "mean": (0.0, std), "rms": (std, std), "std": (std, std), "skewness": (0.0, 1.0),
        "kurtosis": (3.0, 3.0),
    }  # fmt: skip
    return known, lambda x: (normal.cdf(x), normal.sf(x), normal.pdf(x))


class Linear:
    """Gaussian with the covariance of the Lyapunov equation, in 60 digits."""

    def __init__(self, system):
        self.system, n = system, system.n
        with mp.workdps(60):
            M = mp.matrix([[0] * (2 * n) for _ in range(2 * n)])
            K, c, m = system.stiffness_matrix, system.damping, system.mass
            for i in range(n):
                M[i, n + i] = 1 / mp.mpf(float(m[i]))
                for j in range(n):
                    M[n + i, j] = -mp.mpf(float(K[i, j]))
                    M[n + i, n + j] = -mp.mpf(float(c[i, j])) / mp.mpf(float(m[j]))
            size = 2 * n
            L, b = mp.zeros(size * size), mp.zeros(size * size, 1)
            for i in range(size):
                for j in range(size):
                    for k in range(size):
                        L[i * size + j, k * size + j] += M[i, k]
                        L[i * size + j, i * size + k] += M[j, k]
                    if i >= n and j >= n:
                        b[i * size + j] = -2 * mp.mpf(float(system.noise_matrix[i - n, j - n]))
            s = mp.lu_solve(L, b)
            self.exact = [[s[i * size + j] for j in range(size)] for i in range(size)]
        self.covariance = np.array([[float(x) for x in row] for row in self.exact])

    def truth(self, name):
        """By quantity, the exact number and its size; ``cdf`` of a coordinate or the energy."""
        n = self.system.n
        first, parts = {"q": -1, "p": n - 1}, [part for part in name.split(",") if part != "H"]
        rows = [first[part[0]] + int(part[1:]) for part in parts]
        if len(rows) == 2:
            a, b = rows
            both = self.covariance[a, b]
            size = np.sqrt(self.covariance[a, a] * self.covariance[b, b])
            return {"covariance": (both, size), "correlation": (both / size, 1.0)}, None
        if rows:
            return normal_truth(stats.norm(scale=np.sqrt(self.covariance[rows[0], rows[0]])))
        A = np.zeros((2 * n, 2 * n))
        A[:n, :n] = 0.5 * self.system.stiffness_matrix
        A[n:, n:] = np.diag(0.5 / self.system.mass)
        powers = [np.linalg.matrix_power(A @ self.covariance, k) for k in (1, 2, 3, 4)]
        kappa = [2.0**k * factorial(k) * np.trace(P) for k, P in enumerate(powers)]
        scales = 2.0 * np.linalg.eigvals(A @ self.covariance).real
        scales = scales[scales > 1e-14 * scales.max()]

        def cdf(x):
            with mp.workdps(30):
                lam = [mp.mpf(float(a)) for a in scales]

                def transform(s):
                    return mp.fprod((1 + s * a) ** mp.mpf("-0.5") for a in lam)

                high = mp.invertlaplace(lambda s: (1 - transform(s)) / s, x, method="talbot")
                density = mp.invertlaplace(transform, x, method="talbot")
            return float(1 - high), float(high), float(density)

        return of_cumulants(*kappa), cdf
