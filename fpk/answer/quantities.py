"""Moments, probabilities and quantiles of a density with their errors, and its mesh for files."""

from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from importlib import import_module
from math import inf, isfinite, isnan, prod
from numbers import Integral, Real
from typing import Any, Literal

import numpy as np
from scipy.optimize import brentq

from fpk.answer.certificate import Certificate
from fpk.answer.names import Observable, observable_name
from fpk.numeric.arrays import Array, Complexes, Flags
from fpk.numeric.errors import InvalidInput, Unavailable, require

Function = Callable[..., Array]
ErrorKind = Literal["numerical", "sampling"]
"""Whether an error is an estimate of the numerical error or one standard error of sampling."""
SUBDIVISION = 1e-5
"""Largest interpolation error of a mesh for files (``field_of``), over the largest density."""
FIELD_CUT = 1e-6
"""The mesh for files covers all points at which the first density exceeds this share of its
maximum."""
MOST_CELLS = 60_000
"""Number of cells at which the refinement of a mesh for files ends, its error being stated."""


@dataclass(frozen=True)
class Number:
    """A number and its absolute error: a numerical estimate, or one standard error of sampling.

    An example::

        rms = fpk.solve(system, ["q2"], methods=["integrable"])["q2"].rms()
        print(f"{rms.value:.6f} ± {rms.error:.0e}")
    """

    value: float
    error: float


class Quantities(ABC):
    """Quantities of a coordinate X, or of a pair (X, Y), that follow from its density.

    ``panels`` are the ascending nodes of every axis; the first and last bound the support.
    ``covariance`` and ``correlation`` raise ``InvalidInput`` for one coordinate; all others but
    ``expectation``, ``moment``, ``plot`` and the meshes raise it for a pair.
    """

    observable: Observable
    panels: tuple[Array, ...]
    certificate: Certificate

    @property
    def name(self) -> str:
        """Name of the observable, such as ``q2,p2``."""
        return observable_name(self.observable)

    def described(self, error: str) -> str:
        """Return class, observable, support, certification and the text ``error`` in one line."""
        support = " x ".join(f"[{x[0]:.3g}, {x[-1]:.3g}]" for x in self.panels)
        certified = "certified" if self.certificate.certified else "not certified"
        return f"{type(self).__name__}({self.name} on {support}; {certified}, {error})"

    @abstractmethod
    def expectation(self, function: Function, *, kinks: Sequence[float] = ()) -> Number:
        """Return E f(X), for a pair E f(X, Y), and its error. f, the ``function``, takes one array
        per coordinate and is smooth except at ``kinks`` of the only coordinate."""

    def probability(self, low: float, high: float) -> Number:
        """Return P(``low`` < X <= ``high``), ±∞ allowed; raise ``InvalidInput`` for NaN or text."""
        return self._probability(_real_number("low", low), _real_number("high", high))

    @abstractmethod
    def _probability(self, low: float, high: float) -> Number:
        """Return P(``low`` < X <= ``high``) and its error."""

    def share(self, low: float, high: float) -> float:
        """Return P(``low`` < X <= ``high``) without its error."""
        return self._probability(low, high).value

    def moment(self, *powers: int, about: float = 0.0) -> Number:
        """Return E (X − ``about``)^k for ``powers`` (k,), for a pair E (X − about)^k (Y − about)^m.
        Raises ``InvalidInput`` unless each coordinate has a power, an integer >= 0."""
        given: tuple[Any, ...] = powers
        whole = all(isinstance(power, Integral) and int(power) >= 0 for power in given)
        if len(given) != len(self.panels) or not whole:
            raise InvalidInput("power", powers, "takes one integer >= 0 for each coordinate")
        return self.expectation(_monomial(powers, [about] * len(powers)))

    def mean(self) -> Number:
        """Return E X."""
        self._axis()
        return self.moment(1)

    def rms(self) -> Number:
        """Return √E X²."""
        return self._of_moments(lambda m: np.sqrt(m[1]), central=False)

    def std(self) -> Number:
        """Return the standard deviation, √E (X − E X)²."""
        return self._of_moments(lambda m: np.sqrt(m[1]))

    def variance(self) -> Number:
        """Return E (X − E X)²."""
        return self._of_moments(lambda m: m[1])

    def skewness(self) -> Number:
        """Return E (X − E X)³ over the cube of the standard deviation: 0 if p is symmetric."""
        return self._of_moments(lambda m: (m[2] - 3.0 * m[0] * m[1]) / m[1] ** 1.5)

    def kurtosis(self) -> Number:
        """Return E (X − E X)⁴ over the square of the variance; a Gaussian density has 3."""
        return self._of_moments(lambda m: (m[3] - 4.0 * m[0] * m[2]) / m[1] ** 2)

    def covariance(self) -> Number:
        """Return E (X − E X)(Y − E Y) of a joint density."""
        return self._of_moments(lambda m: m[3], pair=True)

    def correlation(self) -> Number:
        """Return the covariance over both standard deviations: −1 to 1, but for its error."""
        return self._of_moments(lambda m: m[3] / np.sqrt(m[2] * m[4]), pair=True)

    def cdf(self, x: float) -> Number:
        """Return P(X <= ``x``); raise ``InvalidInput`` unless ``x`` is a number."""
        return self._probability(-inf, _real_number("x", x))

    def exceedance(self, x: float) -> Number:
        """Return P(X > ``x``), not 1 − P(X <= x): small values keep digits; raise as ``cdf``."""
        return self._probability(_real_number("x", x), inf)

    def quantile(self, p: float) -> Number:
        """Return x with P(X <= x) = ``p``; its error follows from ``p`` ± the error of P(X <= x).
        Beyond the support it is ±∞, its error ∞. Raises ``InvalidInput`` unless 0 < ``p`` < 1."""
        require(0.0 < _real_number("p", p) < 1.0, "p", p, "must be a probability between 0 and 1")
        low, high = (float(x) for x in self._axis()[[0, -1]])
        # The smaller of P(X <= x) and P(X > x) is inverted, as it has relative accuracy.
        upper, rounding = p > 0.5, 1e-14 * (high - low)

        def inverse(wanted: float) -> float:
            def excess(x: float) -> float:
                return (self.share(x, inf) if upper else self.share(-inf, x)) - wanted

            at_low = excess(low)
            if at_low * excess(high) >= 0.0:
                return -inf if upper == (at_low < 0.0) else inf
            return float(brentq(excess, low, high, xtol=rounding))

        wanted = 1.0 - p if upper else p
        x = inverse(wanted)
        if not isfinite(x):
            return Number(x, inf)
        error = (self.exceedance(x) if upper else self.cdf(x)).error
        return Number(x, max(abs(inverse(wanted + s * error) - x) for s in (-1.0, 1.0)) + rounding)

    def plot(self, *, log: bool = False) -> Any:
        """Return a figure of pyplot, as ``fpk.plot`` does; ``log``: logarithmic axis of p."""
        return import_module("fpk").plot(self, log=log)

    def to_meshio(self) -> Any:
        """Return the density as a ``meshio.Mesh`` of adaptively refined quadratic cells.
        ``point_data`` has ``density``, ``log10 density`` and ``error of p``, the stated error."""
        return field_of({"p": self})[0]

    def to_pyvista(self) -> Any:
        """Return ``to_meshio()`` as ``UnstructuredGrid``; raise ``Unavailable`` without pyvista."""
        try:
            pyvista = import_module("pyvista")
        except ImportError:
            raise Unavailable("pyvista is not installed; pip install pyvista brings it") from None
        return pyvista.from_meshio(self.to_meshio())

    def _axis(self, points: Sequence[float] = ()) -> Array:
        """Return the nodes of the only coordinate with those ``points`` added that are inside the
        support. Raises ``InvalidInput`` for a pair."""
        if len(self.panels) != 1:
            raise InvalidInput("density", "joint", "of two coordinates: ask for that of one")
        return with_points(self.panels[0], np.asarray(points))

    def _of_moments(
        self, function: Callable[[Complexes], Any], *, pair: bool = False, central: bool = True
    ) -> Number:
        """Return ``function`` of a complex array of moments, with its error.

        The moments are E X to E X⁴, or for a ``pair`` E X, E Y, E X², E XY, E Y², about the mean if
        ``central``, else about 0. Raises ``InvalidInput`` for the wrong number of coordinates.
        """
        if not pair:
            self._axis()
        elif len(self.panels) != 2:
            raise InvalidInput("density", "single", "of one coordinate: ask for that of a pair")
        powers = [(1, 0), (0, 1), (2, 0), (1, 1), (0, 2)] if pair else [(1,), (2,), (3,), (4,)]
        mass = self.moment(*[0] * len(self.panels)).value  # moments 1 about the mean are 0
        about = [self.moment(*k).value / mass if central else 0.0 for k in powers[: 1 + pair]]
        terms = [_monomial(k, about) for k in powers]
        moments = np.array([self.expectation(term).value for term in terms])
        squares = moments[[2, 4]] if pair else moments[[1]]
        # An imaginary step, whose square is below round-off, differentiates without cancellation.
        steps = 1e-20 * np.prod(np.sqrt(squares) ** np.array(powers), axis=1)
        gradient = np.imag([function(m) for m in moments + 1j * np.diag(steps)]) / steps
        # The error is the error of E[gradient · powers], in which errors of moments may cancel.
        own = self.expectation(
            lambda *x: sum(g * term(*x) for g, term in zip(gradient, terms, strict=True))
        )
        return Number(float(np.real(function(moments.astype(complex)))), own.error)


def _real_number(key: str, value: Any) -> float:
    """Return ``value``, a real number or ±∞; raise ``InvalidInput(key, ...)`` for any other."""
    if isinstance(value, bool) or not isinstance(value, Real) or isnan(value):
        raise InvalidInput(key, value, "must be one number; of several, ask for each")
    return float(value)


def _monomial(powers: Sequence[int], about: Sequence[float]) -> Function:
    """Return the function Π (x_i − ``about``_i)^``powers``_i of one array per coordinate."""
    return lambda *x: prod((y - a) ** k for y, a, k in zip(x, about, powers, strict=True))


def with_points(nodes: Array, points: Array) -> Array:
    """Return the sorted union of ``nodes`` and all ``points`` between the first and last node."""
    return np.union1d(nodes, points[(points > nodes[0]) & (points < nodes[-1])])


def largest_in_tails(
    function: Function, panels: Sequence[Array], kinks: Sequence[float] = ()
) -> float:
    """Return the largest |f|, f the ``function``, on the corners of a box that contains the tails.

    It reaches to twice the ends of the support and to ±2 max|``kinks``|. In the tails densities
    fall at least exponentially. ``panels`` are the ascending nodes of each axis.
    """
    reach = 2.0 * float(np.max(np.abs(kinks), initial=0.0))
    ends = (2.0 * x[[0, -1]] for x in panels)
    corners = np.meshgrid(*([min(a, -reach), max(b, reach)] for a, b in ends))
    return float(np.max(np.abs(function(*corners))))


def field_of(densities: Mapping[str, Any]) -> tuple[Any, float]:
    """Return ``densities``, by names of routes, as a ``meshio.Mesh``, and its interpolation error.

    The mesh covers the smallest box with all points at which the first density is at least
    ``FIELD_CUT`` of its maximum, and is refined where this density bends. ``point_data`` has
    "density", the first, and "log10 density", NaN if it is not positive; for every route,
    its name with spaces for "/", "<route>", its density, "error of <route>", the stated error, and,
    except for the first, "<first> - <route>", the difference. The interpolation error of the first
    density, in its unit, is measured at the middles between the nodes.
    """
    import meshio  # noqa: PLC0415  (0.1 s)

    named = {route.replace("/", " "): density for route, density in densities.items()}
    (first, density), *_ = named.items()
    box = [panels[[0, -1]] for panels in density.panels]
    for _ in range(2):  # on the support, and again on the smaller box
        grid = [np.linspace(a, b, 401 if len(box) == 1 else 101) for a, b in box]
        values = density(*np.ix_(*grid))
        inside = np.nonzero(values >= FIELD_CUT * values.max())
        box = [
            x[np.clip([i.min() - 1, i.max() + 1], 0, x.size - 1)]
            for x, i in zip(grid, inside, strict=True)
        ]
    ends = [
        np.union1d(np.clip(panels, grid[0], grid[-1]), grid)
        for grid, panels in zip(box, density.panels, strict=True)
    ]
    cells, subdivision, allowed = 0, np.inf, 0.0
    while subdivision > allowed and cells <= MOST_CELLS:
        nodes = tuple(_with_middles(e) for e in ends)
        values = density(*np.ix_(*nodes))
        allowed, misses = SUBDIVISION * float(values.max()), []
        for axis, x in enumerate(nodes):  # the largest error of each cell along the axis
            between = [0.5 * (x[1:] + x[:-1]) if n is x else n for n in nodes]
            truth = np.moveaxis(density(*np.ix_(*between)), axis, 0)
            along = np.moveaxis(values, axis, 0)
            low, middle, high = along[:-1:2], along[1::2], along[2::2]
            # The parabola through three nodes at a quarter and at three quarters of the cell.
            quarters = [0.125 * (3 * a + 6 * middle - b) for a, b in ((low, high), (high, low))]
            off = np.abs(np.stack(quarters, axis=1).reshape(truth.shape) - truth)
            misses.append(off.reshape(low.shape[0], -1).max(axis=1))
        subdivision = max(float(m.max()) for m in misses)
        ends = [_with_middles(e, only=miss > allowed) for e, miss in zip(ends, misses, strict=True)]
        cells = int(np.prod([e.size - 1 for e in ends]))
    mesh = np.meshgrid(*nodes, indexing="ij")
    data: dict[str, Array] = {}
    for name, other in named.items():
        data[name], data[f"error of {name}"] = other.at(*mesh)
    p = data[first]
    decades = np.log10(p, out=np.full_like(p, np.nan), where=p > 0.0)
    data = {"density": p, "log10 density": decades, **data}
    data |= {f"{first} - {k}": p - data[k] for k in named if k != first}
    points = np.zeros((p.size, 3))
    points[:, : len(mesh)] = np.column_stack([x.ravel() for x in mesh])
    a, b, m = slice(None, -1, 2), slice(2, None, 2), slice(1, None, 2)
    # Corners counter-clockwise, then the middles of the sides, then the centre.
    square = (a, a), (b, a), (b, b), (a, b), (m, a), (b, m), (m, b), (a, m), (m, m)
    kind, order = ("line3", ((a,), (b,), (m,))) if len(mesh) == 1 else ("quad9", square)
    index = np.arange(p.size).reshape(p.shape)
    blocks = [(kind, np.column_stack([index[place].ravel() for place in order]))]
    return meshio.Mesh(points, blocks, {k: v.ravel() for k, v in data.items()}), subdivision


def _with_middles(ends: Array, only: Flags | None = None) -> Array:
    """Return the sorted ``ends`` (cells + 1,) of cells with the middles of all cells added, or of
    the cells marked by ``only`` (cells,)."""
    middles = 0.5 * (ends[1:] + ends[:-1])
    return np.sort(np.concatenate([ends, middles if only is None else middles[only]]))
