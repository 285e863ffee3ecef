"""Answers of several routes for several curves as labelled arrays, as a netCDF file has them."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

Variables = dict[str, tuple[tuple[str, ...], NDArray[Any], Mapping[str, str]]]
"""Dimensions, values and attributes by name, as ``xarray.Dataset`` takes them."""

Read = Callable[[Any], Any]
"""Takes two things from an answer: a number or an array, and its error."""


@dataclass(frozen=True)
class ByRoute:
    """The ``answers`` to one question by (number of the curve from 0, label of the route).

    ``name`` ends the names of its variables; ``count`` is the number of curves, ``words`` the
    attributes that all variables of a curve have.
    """

    name: str
    count: int
    answers: Mapping[tuple[int, str], Any]
    words: Mapping[str, str]

    @property
    def routes(self) -> list[str]:
        """The labels of the routes, each once."""
        return list(dict.fromkeys(route for _, route in self.answers))

    @property
    def dimensions(self) -> tuple[str, str]:
        """The names of the dimensions of curve and route."""
        return "curve", f"route_{self.name}"

    def labels(self, words: Mapping[str, str]) -> Variables:
        """Return the coordinate of the routes, and ``error_kind`` of each answer, empty for none.

        ``words`` are attributes of the latter.
        """
        kinds = np.full((self.count, len(self.routes)), "", dtype=object)
        for (curve, route), answer in self.answers.items():
            kinds[curve, self.routes.index(route)] = answer.error_kind
        return {
            self.dimensions[1]: (self.dimensions[1:], np.array(self.routes), {}),
            f"error_kind_{self.name}": (self.dimensions, kinds, words),
        }

    def pair(
        self,
        keys: tuple[str, str],
        of: str,
        unit: str,
        read: Read,
        axes: Mapping[str, int] | None = None,
    ) -> Variables:
        """Return the variable of what ``read`` takes from the answers, and that of its error.

        ``keys`` begin their names, ``of`` says in words what it is, ``axes`` are the names and
        sizes of further dimensions. Where there is no answer both are not numbers.
        """
        axes = axes or {}
        both = np.full((2, self.count, len(self.routes), *axes.values()), np.nan)
        for (curve, route), answer in self.answers.items():
            place = curve, self.routes.index(route)
            both[(0, *place)], both[(1, *place)] = read(answer)
        return {
            f"{key}_{self.name}": (
                (*self.dimensions, *axes),
                values,
                {**self.words, "units": unit, "long_name": long_name},
            )
            for key, values, long_name in zip(keys, both, (of, f"error of {of}"), strict=True)
        }
