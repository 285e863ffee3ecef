"""Densities of all observables from densities of modal energies, Eqs. (11), (19), (34)-(36).

The modal energies fall into groups that the damping couples; the density of a group is solved for
once.
"""

from collections.abc import Iterable, Sequence
from functools import cache, partial, reduce
from math import prod

import numpy as np
from scipy.special import j0

from averaging.energy_process import exponential_density
from averaging.gaussian import Gaussian, state_rows
from averaging.modal.analysis import ModalAnalysis
from averaging.zero_flux import density_of_energies, flux_residual, solve_energies
from fpk.answer.certificate import Measured, largest_measured
from fpk.answer.density import Density, certify_density
from fpk.answer.names import Coordinate, Observable
from fpk.numeric.arrays import BLOCK_SIZE, EPS, Array
from fpk.numeric.piecewise import fit
from fpk.numeric.quadrature import panel_rule

Group = tuple[int, ...]
BY_ELEMENTS = ("fem", "scikit-fem")
"""Solvers that give the joint density of two coupled energies."""
CONVOLUTION_POINTS = 24
"""Gauss points per panel of integrals over an energy: they integrate e^(−x) over a panel of up to
30 in x to 4e-24."""
BAND_GROWTH = 2.0**0.5
"""Factor by which the highest wave number s of a density's Fourier series is raised. The norm of
the characteristic function φ beyond s is estimated by 1/(√2 − 1) times its norm between s/√2 and
s, which holds if |φ| falls as s^-2."""
MAX_WAVES = 40_000
"""Largest number of waves of a Fourier series; the estimated contribution of further waves is part
of the error."""
PANEL_PHASE = {1: 30.0, 2: 16.0}
"""Largest phase of a wave over a panel, in radians, by the number of coordinates: 20 and 12 Gauss
points integrate it to 1e-9."""
HALF_PANELS = (4.0, 400.0)
"""Smallest and largest number of panels of an axis on either side of 0."""


def coupling_refusal(modes: ModalAnalysis, solver: str) -> str | None:
    """Return in words why ``solver`` cannot solve for the coupled energies, None if it can."""
    largest = max(modes.averaged.groups, key=len)
    names = " and ".join(f"H{m + 1}" for m in largest)
    if len(largest) > 2:
        return f"the damping couples {names}: more than two energies are not solved for together"
    if len(largest) == 2 and solver not in BY_ELEMENTS:
        return f"the damping couples {names}, so their density is no product; use fem"
    return None


def modal_densities(
    modes: ModalAnalysis, observables: Sequence[Observable], solver: str, *, tol: float
) -> tuple[Density, ...]:
    """Return the densities of ``observables`` in order: modal energies or their sum, or q and p.

    Each group of modes is solved to a share of the L1 tolerance ``tol`` such that an observable
    that depends on all groups meets it. With constant damping and ``solver`` "closed-form"
    displacements, momenta and the sum H follow from the Gaussian state.
    """
    closed, groups = modes.constant and solver == "closed-form", modes.averaged.groups
    energies, behind = list[bool](), list[list[Group]]()
    for observable in observables:
        energies.append(all(c.kind == "H" and c.index is not None for c in observable))
        index = tuple(c.row for c in observable) if energies[-1] else range(modes.n)
        if energies[-1] and modes.constant and solver in BY_ELEMENTS:
            behind.append([tuple(index)])  # (19) in two energies, though the density factors
        else:
            behind.append(list(dict.fromkeys(g for m in index for g in groups if m in g)))
    # An observable of all groups has the errors of all, and as much from its own computation.
    parts = max((len(b) * (2 - own) for own, b in zip(energies, behind, strict=True)), default=1)

    solved = cache(partial(group_density, modes, solver=solver, share=tol / parts, tol=tol))

    def density(observable: Observable, of_energies: bool, behind: list[Group]) -> Density:
        if closed and not of_energies:
            return gaussian_modes(modes).density(observable, tol=tol)
        of_groups = [solved(group) for group in behind]
        if of_energies:
            return _product_density(observable, of_groups, tol)
        if observable[0].kind == "H":
            # p(H) = ∫p(H1, H − H1) dH1 within a group, and convolutions between groups.
            of_sum = partial(_sum_density, observable, share=tol / (2 * len(of_groups)), tol=tol)
            return reduce(of_sum, (p if len(p.panels) == 1 else of_sum(p) for p in of_groups))
        return state_density(modes, of_groups, observable, tol=tol)

    return tuple(map(density, observables, energies, behind))


def group_density(
    modes: ModalAnalysis, group: Group, *, solver: str, share: float, tol: float
) -> Density:
    """Return the density of the energies of a coupled ``group`` of one or two modes (0-based).

    It is solved for by ``solver`` to the L1 error ``share``; the certificate compares with ``tol``.
    The relative error ε of γ θ/d of a mode changes p by up to ε (1 + H/θ).
    """
    process, theta = modes.process(group), modes.temperature[list(group)]
    if solver != "closed-form":
        p = solve_energies(process, solver, tol=share)
    else:
        factors, (m,) = modes.averaged.factors, group  # γ/d in ascending powers of H_m
        alone = np.isin(factors, [0, m + 1]).all(axis=1)
        degree = np.count_nonzero(factors[alone], axis=1)
        rate = np.bincount(degree, modes.averaged.values[alone, m, m])
        p = exponential_density(process, rate / modes.noise[m])
    observable = tuple(Coordinate("H", m) for m in group)
    panels = p.panels if isinstance(p.panels, tuple) else (p.panels,)
    return density_of_energies(
        observable,
        p,
        panels,
        lambda *H: modes.relative_error * sum(1.0 + x / s for x, s in zip(H, theta, strict=True)),
        tol=tol,
        added=True,
    )


def _product_density(observable: Observable, parts: Sequence[Density], tol: float) -> Density:
    """Return the density of modal energies as a product of the densities ``parts`` of groups.

    The certificate compares the L1 error with ``tol``.
    """
    if parts[0].observable == observable:
        return parts[0]
    panels = {c: x for part in parts for c, x in zip(part.observable, part.panels, strict=True)}

    def both(*energies: Array) -> tuple[Array, Array]:
        """Return density and error at ``energies`` of ``observable``, others integrated out."""
        given, factors = dict(zip(observable, energies, strict=True)), []
        for part in parts:
            hidden = [c for c in part.observable if c not in given]
            if not hidden:
                factors.append(part.at(*(given[c] for c in part.observable)))
            else:
                x, w = (a.ravel() for a in panel_rule(panels[hidden[0]], 2 * CONVOLUTION_POINTS))
                at = (given[c][..., None] if c in given else x for c in part.observable)
                p, error = part.at(*at)
                factors.append((p @ w, error @ w))
        return product_of(factors)

    return certify_density(
        observable,
        tuple(panels[c] for c in observable),
        lambda *energies: both(*energies)[0],
        lambda *energies: both(*energies)[1],
        measured=combine_measured(parts),
        tol=tol,
    )


def _sum_density(observable: Observable, *parts: Density, share: float, tol: float) -> Density:
    """Return the density of H1 + H2 from p(H1, H2), or from p(H1) and p(H2) if independent.

    Panels are halved until the last Legendre coefficients sum to less than the L1 error ``share``;
    the certificate compares the error with ``tol``.
    """
    panels = tuple(x for part in parts for x in part.panels)
    end = panels[0][-1] + panels[1][-1]
    nodes = np.unique(np.concatenate([*panels, np.linspace(0.0, end, 9), [end]]))
    nodes = nodes[np.append(True, np.diff(nodes) > 1e-12 * end)]
    t, w = panel_rule(np.array([0.0, 1.0]), CONVOLUTION_POINTS)

    def along(energy: Array) -> Array:
        """Return ∫p(x, H − x) dx, 0 < x < H, and its error, (points, 2), at ``energy`` H.

        Panels end where x or H − x is a panel node.
        """
        sums = []
        size = energy.size * CONVOLUTION_POINTS * (panels[0].size + panels[1].size)
        for part in np.array_split(energy, 1 + 2 * size // BLOCK_SIZE):
            H = part[:, None]
            ends = np.hstack([np.minimum(panels[0], H), np.maximum(H - panels[1], 0.0)])
            ends = np.sort(np.clip(ends, 0.0, np.minimum(H, panels[0][-1])), axis=1)
            length = np.diff(ends, axis=1)[:, :, None]
            x = ends[:, :-1, None] + length * t
            at = x, np.clip(H[:, :, None] - x, 0.0, None)
            axes = (at,) if len(parts) == 1 else zip(at)  # both energies, or one for each part
            values = product_of(p.at(*own) for p, own in zip(parts, axes, strict=True))
            sums.append(np.einsum("hkt,chkt->hc", length * w, values))
        return np.concatenate(sums)

    both = fit(
        along,
        nodes,
        0.5 * share / nodes.size,
        estimate=lambda lengths, series: lengths * np.abs(series[:, -2:, 0]).sum(axis=1),
    )
    assert both.error is not None
    local = 2.0 * both.error / np.diff(both.nodes)

    def pointwise(energy: Array) -> Array:
        k = np.searchsorted(both.nodes[1:-1], energy, side="right")
        return np.asarray(np.abs(both(energy)[..., 1]) + local[k])

    return certify_density(
        observable,
        (both.nodes,),
        lambda energy: both(energy)[..., 0],
        pointwise,
        measured=combine_measured(parts, 2.0 * float(both.error.sum())),
        tol=tol,
    )


def gaussian_modes(modes: ModalAnalysis) -> Gaussian:
    """Return (34) as a Gaussian state: independent ω Q_i and P_i of variance θ_i.

    With M* = 1: ``cov q = T diag(θ_i/ω_i²) Tᵀ``, ``cov p = M T diag(θ_i) Tᵀ M``, Eqs. (20), (35).
    The residual is the largest flux of e^(−H/θ)/θ in the energy process (19) of a mode.
    """
    theta = modes.temperature

    def flux(m: int) -> float:
        nodes = np.linspace(0.0, 40.0 * theta[m], 21)
        return flux_residual(modes.process((m,)), nodes, lambda H: -H / theta[m] - np.log(theta[m]))

    return Gaussian(
        factor=modes.state_shapes * np.sqrt(np.tile(theta, 2)),
        relative_error=modes.relative_error,
        scales=theta,
        shape=1.0,
        scale_errors=modes.relative_error * theta,
        residual=float(np.max([flux(m) for m in range(modes.n)])),
    )


def fourier_sum(phases: Array, coefficients: Array, x: Array, y: Array | float = 0.0) -> Array:
    """Return Re Σ_km coefficients_km exp(i (k a_0 + m a_1)), a = ``phases`` (x, y); 0 if |a| > π.

    ``phases`` (2, 2) is lower triangular. ``coefficients`` (functions, K + 1, 2M + 1) of k = 0 .. K
    and m = −M .. M are doubled for k > 0, in the place of −k. ``x`` and ``y`` broadcast together;
    the result is (functions, ...).
    """
    K, M = np.array(coefficients.shape[1:]) // [1, 2] - [1, 0]
    (u, i), (v, j) = (np.unique(z, return_inverse=True) for z in (x, y))
    k, m = 1j * np.arange(K + 1), 1j * np.arange(-M, M + 1)
    rows = np.exp(np.outer(phases[0, 0] * u, k)) @ coefficients
    rows = rows * np.exp(np.outer(phases[1, 0] * u, m))
    columns = np.exp(np.outer(m, phases[1, 1] * v))
    i, j = np.broadcast_arrays(i.reshape(np.shape(x)), j.reshape(np.shape(y)))
    if u.size * v.size <= 4 * i.size:  # a grid
        total = (rows @ columns).real[:, i, j]
    else:
        total = np.einsum("c...m,m...->c...", rows[:, i], columns[:, j]).real
    a = np.tensordot(phases, np.array(np.broadcast_arrays(x, y)), 1)
    return np.where(np.all(np.abs(a) <= np.pi, axis=0), total, 0.0)


def state_density(
    modes: ModalAnalysis, groups: Sequence[Density], observable: Observable, *, tol: float
) -> Density:
    """Return the density of one or two displacements and momenta from densities of modal energies.

    ``groups`` are the densities of independent groups of energies. A coordinate x of ``observable``
    is Σ_m √H_m (U_m cos φ_m + W_m sin φ_m) by X = T Q (14) and p_i = m_i Ẋ_i, with independent
    uniform phases, so that ``E e^{i s·x} = Π_groups E Π_m J0(√H_m |(s·U_m, s·W_m)|)``. The density
    is a Fourier series on its bounded support, without aliasing error; the omitted waves are
    estimated from the outermost ring of the band. ``tol`` is the L1
    tolerance of the certificate.
    """
    count = len(observable)
    rows = np.sqrt(2.0) * modes.state_shapes[state_rows(observable, modes.n)]
    U, W = rows[:, : modes.n], rows[:, modes.n :]
    mean, largest = np.zeros(modes.n), np.zeros(modes.n)
    for group in groups:
        for m, x in zip(group.observable, group.panels, strict=True):
            mean[m.row] = group.moment(*(int(other == m) for other in group.observable)).value
            largest[m.row] = np.sqrt(x[-1])
    whitened = np.linalg.inv(np.linalg.cholesky((U * mean) @ U.T / 2 + (W * mean) @ W.T / 2))
    box = np.hypot(whitened @ U, whitened @ W) @ largest
    phases = np.pi * whitened / box[:, None]
    scale = float(np.prod(np.diag(whitened) / (2.0 * box)))
    # φ of a Gaussian, exp(−½ s²) at the wave number s in units of 1/rms, meets the tolerance below
    # in the outermost ring, which begins at band/BAND_GROWTH.
    band, beyond = BAND_GROWTH * np.sqrt(-2.0 * np.log(0.1 * tol)), 1.0 / (BAND_GROWTH - 1.0)
    while True:  # until the waves beyond the band add less than a tenth of the tolerance
        K, M = np.pad(np.ceil(band * box / np.pi).astype(int), (0, 2 - count))
        k, m = np.mgrid[0 : K + 1, -M : M + 1]
        waves = np.stack([k.ravel(), m.ravel()][:count], axis=1) @ phases
        # E Π_m J0(√H_m size_m), and the transform of its error: the error of each group times the
        # transforms of the others.
        size = np.hypot(waves @ U, waves @ W)
        p, error = np.ones(len(size)), np.zeros(len(size))
        for group in groups:
            own, own_error = _bessel_transform(group, size[:, [c.row for c in group.observable]])
            p, error = p * own, error * own + p * own_error
        both_signs = np.where(k == 0, 1.0, 2.0)
        ring = np.abs(p.reshape(k.shape))
        ring *= np.maximum(k / K, np.abs(m) / max(M, 1)) > 1.0 / BAND_GROWTH
        # ∫|·| over the box is at most √Σ|φ|², by Parseval and Cauchy-Schwarz.
        l1_beyond = beyond * float(np.sqrt(np.sum(both_signs * ring**2)))
        if (
            l1_beyond <= 0.1 * tol
            or np.prod(2.0 * BAND_GROWTH * np.array([K, M]) + 1.0) > MAX_WAVES
        ):
            break
        band *= BAND_GROWTH
    coefficients = scale * both_signs * np.stack([p, error]).reshape(2, *k.shape)
    both = partial(fourier_sum, np.pad(phases, (0, 2 - count)), coefficients)
    from_modes = modes.relative_error * 2.0 * count  # from errors of T and ω
    relative = sum(group.l1_error for group in groups) + from_modes
    round_off = 8.0 * EPS * float(k.size) ** 0.5
    floor = beyond * scale * float(np.sum(both_signs * ring))
    floor += round_off * float(both(np.zeros(1))[0, 0])

    def pointwise(*x: Array) -> Array:
        p, error = both(*x)
        return np.asarray(np.abs(error) + relative * np.abs(p) + floor)

    extent = np.hypot(U, W) @ largest
    # Panels over which the phase of the highest wave turns by ``PANEL_PHASE``, within limits: φ is
    # nearly 0 at the edge of the band.
    turns = extent * (np.array([K, M])[:count] @ np.abs(phases)) / PANEL_PHASE[count]
    halves = np.ceil(np.clip(turns, *HALF_PANELS)).astype(int)
    return certify_density(
        observable,
        tuple(np.linspace(-e, e, 1 + 2 * half) for e, half in zip(extent, halves, strict=True)),
        lambda *x: both(*x)[0],
        pointwise,
        measured=combine_measured(groups, from_modes + l1_beyond + round_off),
        tol=tol,
    )


def combine_measured(parts: Sequence[Density], added: float = 0.0) -> Measured:
    """Return errors and checks of a density that depends on all of the independent ``parts``.

    ``added`` is the L1 error of computing it from them. L1 errors, mass defects and tail masses are
    added up, residual and net flux are the largest, failures are of all parts, minimum is None.
    """
    checks = [part.certificate for part in parts]
    return Measured(
        l1_error=sum(part.l1_error for part in parts) + added,
        mass_defect=sum(c.mass_defect for c in checks if c.mass_defect is not None),
        minimum=None,
        residual=largest_measured(c.residual for c in checks),
        tail_mass=sum(c.tail_mass or 0.0 for c in checks),
        net_flux=largest_measured(c.net_flux for c in checks),
        failures=tuple(dict.fromkeys(words for c in checks for words in c.besides)),
    )


def product_of(factors: Iterable[tuple[Array, Array]]) -> tuple[Array, Array]:
    """Return the product of ``factors``, each a (value, absolute error), and its absolute error."""
    value, error = np.ones(()), np.zeros(())
    for x, e in factors:
        value, error = value * x, error * (np.abs(x) + e) + np.abs(value) * e
    return value, error


def _bessel_transform(group: Density, size: Array) -> Array:
    """Return E Π_m J0(√H_m ``size``_m) over the density ``group``, for ``size`` (waves, modes).

    The result is (2, waves): row 1 is the same integral of the error of the density. The larger the
    phase, the more points have the Gauss rules on the panels.
    """
    rules = []
    for nodes, z in zip(group.panels, size.T, strict=True):
        phase = float(np.max(np.diff(np.sqrt(nodes)))) * float(z.max(initial=0.0))
        rules.append(panel_rule(nodes, CONVOLUTION_POINTS + 4 * int(np.ceil(0.15 * phase))))
    energies, weights = ([a.ravel() for a in part] for part in zip(*rules, strict=True))
    shares = reduce(np.multiply.outer, weights) * group.at(
        *np.meshgrid(*energies, indexing="ij", sparse=True)
    )
    shares = shares.reshape(2, energies[0].size, -1)
    total = []
    for part in np.array_split(size, 1 + len(size) * sum(H.size for H in energies) // BLOCK_SIZE):
        first, *second = (
            j0(np.multiply.outer(z, np.sqrt(H))) for z, H in zip(part.T, energies, strict=True)
        )
        total.append(np.sum((first @ shares) * prod(second), axis=2))
    return np.concatenate(total, axis=1)
