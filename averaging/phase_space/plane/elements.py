"""Finite elements of the backward equation −L u = f of one mass, u = 0 beyond the limit."""

from dataclasses import dataclass, replace
from functools import cached_property, lru_cache
from math import pi
from typing import Any

import numpy as np
from numpy.polynomial.legendre import Legendre, legder, legval, legvander
from scipy.linalg import expm
from scipy.sparse import coo_array, csc_array, csr_array, eye_array, kron
from scipy.sparse.linalg import ArpackNoConvergence, LinearOperator, eigs, splu

from averaging.phase_space.plane.mesh import Mesh
from averaging.phase_space.plane.oscillator import weighted
from fpk.numeric.arrays import Array, Integers
from fpk.numeric.errors import NotCertified
from fpk.numeric.krylov import EVERY, VECTORS, krylov
from fpk.numeric.quadrature import gauss_legendre, panel_rule

POINTS = 3
"""Gauss points per panel over the degree, since the weight falls by e⁴⁰ over the mesh: with only 4
more than the degree, K + Kᵀ was indefinite. Beside Hertzian stops the error of quadrature falls as
points⁻⁵: with two degrees fewer it is four times as large, so that a comparison shows it."""
PIVOTS = (1e-3, 1e-2, 1.0)
"""Smallest diagonal pivots relative to their columns, tried in turn: small pivots keep the
elimination order, but let entries grow."""
LARGEST_RESIDUAL = 1e-10
"""Residual of a solution, relative to the terms that cancel in it, above which the elimination is
repeated with the next of ``PIVOTS``: small pivots have let the entries of the factors grow."""
MOST_ITERATIONS = 60
"""Largest number of restarts of Arnoldi's method for the slowest density."""
RELIABILITY_SHARE = 0.05
"""Largest change of an answer in time by the last Krylov vectors over its tolerance; 0.01 takes a
third longer."""


def factorise_sparse(matrix: csc_array) -> Any:
    """Return SuperLU factors of ``matrix``; raise ``NotCertified`` if elimination breaks down.

    They are by the first of ``PIVOTS`` that meets ``LARGEST_RESIDUAL``, else by the last.
    """
    right = matrix @ np.ones(matrix.shape[0])
    symmetric: dict[str, Any] = {"permc_spec": "MMD_AT_PLUS_A", "options": {"SymmetricMode": True}}
    for pivot in PIVOTS:
        try:
            factors = splu(matrix, diag_pivot_thresh=pivot, **symmetric)
        except RuntimeError as error:
            raise NotCertified(f"the elimination breaks down: {error}") from None
        x = factors.solve(right)
        if np.max(np.abs(right - matrix @ x)) <= LARGEST_RESIDUAL * np.max(abs(matrix) @ np.abs(x)):
            break
    return factors


@dataclass(frozen=True, eq=False)
class Elements:
    """The backward equations L T = −1, L T₂ = −2 T and ∂u/∂t = L u on ``mesh``.

    ``K`` and ``M`` are the matrices of −L and of 1 in L²(exp(−Ψ(H))). Functions are continuous in
    s, may jump between panels of x (upwind fluxes), and are divided by their norms. Vectors are
    (unknowns,): ``one`` the coefficients of the function 1, ``load`` the scalar products of 1,
    ``exit`` the scalar products of −L 1, the flux through the limit, which computed as K ``one``
    would be round-off if failure is rare, and ``cut`` the part of it through edges of the mesh that
    are no limit. ``free`` are the indices of the unknowns among all functions.
    """

    mesh: Mesh
    K: csc_array
    M: csc_array
    load: Array
    exit: Array
    cut: Array
    one: Array
    free: Integers

    def at(self, q: Array, v: Array, weights: Array) -> Array:
        """Return the vector x, Σ ``weights`` u(``q``, ``v``) = x·u, of states within the limit."""
        m, (x, s) = self.mesh, self.mesh.coordinates(q, v)
        row, a = panel_functions(m.x, m.degree, x, shared=0)
        column, b = panel_functions(m.s, m.degree, s)
        functional = np.zeros((m.x.size - 1) * (m.degree + 1) * m.functions_of_s)
        place = row[:, :, None] * m.functions_of_s + column[:, None, :]
        np.add.at(functional, place, weights[:, None, None] * a[:, :, None] * b[:, None])
        return np.asarray(functional[self.free] / self.one)

    @cached_property
    def factors(self) -> Any:
        """The sparse factors of K."""
        return factorise_sparse(self.K)

    def solve(self, right: Array, trans: str = "N") -> Array:
        """Return x with K x = ``right``, or Kᵀ x = ``right`` if ``trans`` is "T", refined once."""
        K = self.K if trans == "N" else self.K.T
        x = self.factors.solve(right, trans)
        return np.asarray(x + self.factors.solve(right - K @ x, trans))

    @cached_property
    def mean(self) -> Array:
        """Coefficients (unknowns,) of the mean time; inexact in scale if failure is rare."""
        return self.solve(self.load)

    def moments(self, start: Array) -> tuple[float, float, float]:
        """Return E T and E T² from ``start``, see ``at``, and the relative mass lost to round-off.

        y = K⁻ᵀ ``start`` is the density of the time spent, up to a factor that round-off changes if
        failure is rare. The identity y'(−L 1) = start'1 determines the factor; its difference from
        1 is the mass lost.
        """
        y = self.solve(start, "T")
        factor = float(y @ self.exit) / float(start @ self.one)
        y /= factor
        mean = float(y @ self.load)
        second = 2.0 * float(y @ (self.M @ self.mean)) * mean / float(start @ self.mean)
        return mean, second, abs(factor - 1.0)

    def escape(self, start: Array) -> float:
        """Return the share of what fails, from ``start`` or late, that leaves by ``cut``."""
        y, (_, late) = self.solve(start, "T"), self.slowest
        return max(abs(float((z @ self.cut) / (z @ self.exit))) for z in (y, late))

    @cached_property
    def slowest(self) -> tuple[float, Array]:
        """The least eigenvalue of −L and the coefficients (unknowns,) of its density.

        The eigenvalue is the failure rate, outflow over mass; the mass of the density is 1. It is
        found by Arnoldi's method from the weight. Raises ``NotCertified`` where other rates are so
        close that it is not found.
        """
        inverse = LinearOperator(self.K.shape, matvec=lambda x: self.factors.solve(x, "T"))
        options: dict[str, Any] = {"v0": self.one, "maxiter": MOST_ITERATIONS, "sigma": 0.0}
        vectors = min(12, self.load.size - 1)
        try:
            _, y = eigs(self.K.T, k=1, M=self.M, OPinv=inverse, ncv=vectors, **options)
        except ArpackNoConvergence:
            words = "rates lie too close together, as those of a weak spring do; use montecarlo"
            raise NotCertified(f"the failure rate is not found: {words}") from None
        density = np.real(y[:, 0] / y[np.argmax(np.abs(y[:, 0])), 0])
        density /= density @ self.load
        # Refined: solutions of nearly singular equations have a residual.
        for _ in range(2):
            residual = self.K.T @ density - (density @ self.exit) * (self.M.T @ density)
            density -= self.factors.solve(residual, "T")
            density /= density @ self.load
        return float(density @ self.exit), density

    @property
    def displacement(self) -> Array:
        """Displacements (unknowns,) at which the functions of the unknowns are 1."""
        m, t = self.mesh, _lobatto_nodes(self.mesh.degree)
        q, _ = m.q(m.x[:-1, None] + 0.5 * np.diff(m.x)[:, None] * (1.0 + t))
        return np.repeat(q, m.functions_of_s)[self.free]

    @cached_property
    def shifted(self) -> tuple[float, Any]:
        """σ, four times the frequency or less under strong damping, and the factors of K + σM."""
        o = self.mesh.oscillator
        frequency = pi / o.travel(self.mesh.radius)
        sigma = 4.0 * frequency / (1.0 + max(o.damping, 0.0) / (o.mass * frequency))
        return sigma, factorise_sparse(csc_array(self.K + sigma * self.M))

    def mass_defect(self, start: Array) -> float:
        """Return the absolute defect of the mass at a random time, exponential with mean 1/σ.

        The density then is σ (K + σM)⁻ᵀ ``start``; the mass within the limit and the mass that has
        left should add up to the mass of ``start``.
        """
        sigma, factors = self.shifted
        mass = factors.solve(start, "T") @ (sigma * (self.M @ self.one) + self.exit)
        return abs(float(mass - start @ self.one))

    def in_time(
        self,
        initial: Array,
        source: Array,
        first: Array,
        times: Array,
        *,
        tol: float,
        trans: str = "N",
        seen: Array | None = None,
    ) -> tuple[Array, Array]:
        """Return u of M u' = −K u + ``source``, M u(0) = ``initial``, at ascending ``times`` > 0.

        The result is u (times, unknowns), or its functional ``seen`` (times,), and the change by
        the last Krylov vectors (times,): for u the bound ‖u − u'‖_M (∫ exp(−Ψ))^½ of ∫|p − p'| by
        Cauchy and Schwarz. Galerkin's method is used on the space of (K + σM)⁻¹M and ``first``,
        orthonormal in M, with Kᵀ and Mᵀ if ``trans`` is "T". It grows until the last change is
        below ``RELIABILITY_SHARE`` times ``tol`` and the one before below ``tol``, times the
        largest value, at most 1, or until there are ``VECTORS`` vectors.
        """
        K, M = (self.K, self.M) if trans == "N" else (csc_array(self.K.T), csc_array(self.M.T))
        solve, scale = self.shifted[1].solve, float(np.sqrt(self.one @ self.load))
        change = before = np.full(times.size, np.inf)
        images, last = np.zeros((0, first.size)), np.zeros((times.size, 1))
        spaces = krylov(lambda x: solve(M @ x, trans), first[:, None], VECTORS, metric=M.__matmul__)
        for V, _, closed in spaces:
            if len(V) % EVERY and not closed:
                continue
            images = np.vstack([images, (K @ V[len(images) :].T).T])
            system = np.pad(-V @ images.T, (0, 1))
            system[:-1, -1] = V @ source
            read = scale * np.eye(len(V), VECTORS) if seen is None else (V @ seen)[:, None]
            # Damping terms can let small spaces grow where the density does not.
            with np.errstate(over="ignore", invalid="ignore"):
                y = _flow(system, np.append(V @ initial, 1.0), times)[:, :-1]
                now = y @ read
                moved, size = (np.linalg.norm(x, axis=1) for x in (now - last, now))
            before, change, last = change, np.where(np.isfinite(moved), moved, np.inf), now
            enough = tol * min(1.0, float(size.max()))
            if np.max(change) <= RELIABILITY_SHARE * enough and np.max(before) <= enough:
                break
        u = y @ V if seen is None else now[:, 0]
        return u, np.maximum(change, RELIABILITY_SHARE * before)


def _flow(A: Array, x: Array, times: Array) -> Array:
    """Return e^(At) ``x`` (times, m) at ascending ``times``; equal steps share an exponential."""
    now, step, propagator, out = 0.0, 0.0, A, list[Array]()
    for t in times.tolist():
        if not out or abs(t - now - step) > 1e-13 * t:
            step = t - now
            propagator = expm(step * A)
        x, now = propagator @ x, t
        out.append(x)
    return np.array(out)


def panel_functions(
    nodes: Array, degree: int, t: Array, *, shared: int = 1
) -> tuple[Integers, Array]:
    """Return the numbers and values (..., degree + 1) of the functions that are not 0 at ``t``.

    Neighbouring panels between ``nodes`` share ``shared`` functions.
    """
    k = np.clip(np.searchsorted(nodes, t, side="right") - 1, 0, nodes.size - 2)
    local = 2.0 * (t - nodes[k]) / (nodes[k + 1] - nodes[k]) - 1.0
    number = k[..., None] * (degree + 1 - shared) + np.arange(degree + 1)
    return number, legvander(local, degree) @ to_lobatto(degree)


@lru_cache
def to_lobatto(degree: int) -> Array:
    """Return the Legendre coefficients of the Lobatto polynomials, one column each.

    They are the Lagrange polynomials of the Lobatto nodes; hierarchical polynomials would lose all
    digits on a panel over which the weight falls by e²⁰.
    """
    return np.asarray(np.linalg.inv(legvander(_lobatto_nodes(degree), degree)), dtype=float)


def _lobatto_nodes(degree: int) -> Array:
    """Return the Lobatto nodes (degree + 1,) in [−1, 1], of polynomials of this degree."""
    inner = np.sort(np.real(Legendre.basis(degree).deriv().roots()))
    return np.concatenate([[-1.0], inner, [1.0]])


def assemble_backward(mesh: Mesh, *, odd: bool = False) -> Elements:
    """Return the matrices and vectors on ``mesh``.

    ``odd``: of functions that change sign under reflection, if the mesh is folded; ``exit`` and
    ``load`` then mean nothing.

    They are of the backward operator in the coordinates (q, s), v = s w, times −w:
    −L u = −s w u_q − w' (1 − s²) u_s + (c − D Ψ')/m s u_s − exp(Ψ) (D/m²)/w² ∂_s exp(−Ψ) u_s,
    w' = −V'/(m w); for w = 1 the second term is V'/m u_v. The weight exp(−Ψ(H)) is that of
    ``weighted`` on the energies of the mesh.
    """
    reach = mesh.oscillator.energy(
        mesh.q(mesh.x)[0][:, None], mesh.s * mesh.w(mesh.q(mesh.x)[0])[:, None]
    )
    mesh = replace(mesh, oscillator=weighted(mesh.oscillator, float(np.max(reach))))
    o, n, panels, across = mesh.oscillator, mesh.degree + 1, mesh.x.size - 1, mesh.s.size - 1
    t, weight = gauss_legendre(POINTS * mesh.degree)
    to = to_lobatto(mesh.degree)
    B, D = legvander(t, mesh.degree) @ to, legval(t, legder(np.eye(mesh.degree + 1))).T @ to
    BB, BD, DD = (
        np.einsum("gi,gk->gik", a, b).reshape(t.size, -1) for a, b in ((B, B), (B, D), (D, D))
    )
    # Coefficients have the axes (panels of x, panels of s, points in x, points in s).
    hx, hs = 0.5 * np.diff(mesh.x)[:, None, None, None], 0.5 * np.diff(mesh.s)[:, None, None]
    x, s = (panel_rule(nodes, t.size)[0] for nodes in (mesh.x, mesh.s))
    q, slope = mesh.q(x)
    q, slope, w, force = (a[:, None, :, None] for a in (q, slope, mesh.w(q), o.force(q)))
    v = s[:, None, :] * w
    bend = 1.0 if mesh.energy is None else 1.0 - s[:, None, :] ** 2
    psi = o.psi
    H = o.energy(q, v)
    area = np.exp(-psi(H)) * weight[:, None] * weight
    turn = (
        area * hx * slope * (force * bend + (o.drag(q, v) - o.noise * psi.deriv()(H)) * v) / o.mass
    )
    spread = area * hx / hs * slope * o.diffusion / w
    flow = area * hs * v * w  # dq/dx cancels
    local = BB.T @ turn @ BD + BB.T @ spread @ DD - BD.T @ flow @ BB
    mass = BB.T @ (area * hx * hs * slope * w) @ BB
    # Functions of x on each panel times functions of s, where neighbouring panels share one.
    size = across * mesh.degree + 1
    total = panels * n * size
    of_s = mesh.numbers_of_s
    of_x = size * np.arange(panels * n, dtype=np.int32).reshape(panels, 1, n, 1)
    place, shape = of_x + of_s[:, None, :], (panels, across, n, n, n, n)
    row = np.broadcast_to(place[:, :, :, None, :, None], shape).ravel()
    column = np.broadcast_to(place[:, :, None, :, None, :], shape).ravel()
    # Both matrices at once, M as the imaginary part: sorting the indices is half of the work.
    pair = coo_array(((local + 1j * mass).ravel(), (row, column)), shape=(total, total)).tocsc()
    # Traces at the left and right ends of panels, and ∫ |v| … ds of functions of s at all ends.
    left, right = (
        kron(eye_array(panels), kron(np.eye(1, n, k), eye_array(size)), format="csr")
        for k in (0, n - 1)
    )
    ends = mesh.q(mesh.x)[0][:, None, None]
    w = mesh.w(ends)
    density = np.exp(-psi(o.energy(ends, s * w)))
    block = ((np.abs(s) * w * w * density * weight * hs[:, 0]) @ BB).reshape(-1, across, n, n)
    first = size * np.arange(panels + 1, dtype=np.int32)[:, None, None, None]
    index = [np.broadcast_to(first + at, block.shape) for at in (of_s[:, :, None], of_s[:, None])]
    forwards, fluxes = mesh.s[:-1] + mesh.s[1:] > 0.0, []
    for way in (forwards, ~forwards):
        entries, places = block[:, way].ravel(), [at[:, way].ravel() for at in index]
        fluxes.append(csr_array((entries, places), shape=2 * ((panels + 1) * size,)))
    # Jumps u − u⁺, u⁺ on the panel that the motion enters, or 0 at the limit.
    beyond = eye_array(panels * size, k=size, format="csr")
    before = beyond.T @ right
    if mesh.folded:
        mirror = csr_array((-1.0 if odd else 1.0) * np.eye(size)[::-1])
        before = before + kron(np.eye(panels, 1), mirror, format="csr") @ left[:size]
    faces = (
        (right.T @ fluxes[0][size:, size:], right - beyond @ left),
        (left.T @ fluxes[1][:-size, :-size], left - before),
    )
    K, M = pair.real + sum(flux @ jump for flux, jump in faces), pair.imag.copy()
    # −L 1: the terms on panels vanish and those between panels cancel, which leaves the edges.
    edge = np.zeros((2, panels * n, size))
    edge[0, :, 0] = edge[1, :, -1] = 1.0
    through = [flux @ (jump @ np.ones(total)) for flux, jump in faces[::-1]]
    through += [-np.asarray(K @ one.ravel()) for one in edge]
    lost = sum(through)
    cut = sum((flux for flux, out in zip(through, mesh.cut, strict=True) if out), 0.0 * lost)
    free = np.flatnonzero(edge.sum(axis=0).ravel() == 0.0)
    load = np.asarray(M @ np.ones(total))[free]
    K, M = K[free][:, free], M[free][:, free]
    scale = 1.0 / np.sqrt(M.diagonal())
    for A in (K, M):
        A.data *= scale[A.indices] * np.repeat(scale, np.diff(A.indptr))
    lost, cut = lost[free] * scale, cut[free] * scale
    return Elements(mesh, K, M, load * scale, lost, cut, 1.0 / scale, free)
