"""Pictures of an outcome, as matplotlib figures: densities, solver differences, what is left."""

from collections.abc import Iterator

import matplotlib as mpl
from matplotlib.figure import Figure

from cases.comparison.run import Outcome
from cases.output.pictures.joint import joint_pictures
from cases.output.pictures.lines import line_pictures
from cases.output.pictures.style import STYLE


def figures(outcome: Outcome) -> Iterator[tuple[str, str, Figure]]:
    """Yield file stem, caption and figure of everything that an outcome can show."""
    with mpl.rc_context(dict(STYLE)):
        for observable in outcome.scene.observables:
            curves = [c for c in outcome.curves if c.densities(observable)]
            if curves and len(observable) == 1:
                yield from line_pictures(curves, observable)
            elif curves:
                yield from joint_pictures(curves[0], observable)
