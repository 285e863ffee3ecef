"""The rendered body of a surface stands where matplotlib's axes say it does."""

import numpy as np
import pytest
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from mpl_toolkits.mplot3d import proj3d

from cases.output.pictures.rendered import PIXELS, can_render, lay_rendered

pytestmark = pytest.mark.skipif(not can_render(), reason="the extra viz is not installed")

SLACK = 4.0 / PIXELS
"""Two pixels on either side: an edge is drawn in one pixel and smoothed into the next."""


def test_the_corners_of_the_floor_are_where_the_axes_have_them() -> None:
    figure = Figure(figsize=(4, 4))
    FigureCanvasAgg(figure)
    axes = figure.add_subplot(1, 1, 1, projection="3d")
    axes.view_init(elev=28, azim=-58)
    axes.set_box_aspect((1, 1, 0.72), zoom=0.92)
    axes.set_proj_type("ortho")
    axes.set_xlim(-1.0, 1.2)
    axes.set_ylim(-2.0, 2.0)
    axes.set_zlim(0.0, 1.05)
    grid = (np.linspace(-1.0, 1.2, 30), np.linspace(-2.0, 2.0, 40))
    lay_rendered(axes, grid, np.zeros((30, 40)), top=1.0)
    (laid,) = axes.get_images()
    x0, x1, y0, y1 = laid.get_extent()
    rows, columns = np.nonzero(np.asarray(laid.get_array())[..., 3])
    shares = [columns.min(), columns.max() + 1, PIXELS - rows.max() - 1, PIXELS - rows.min()]
    seen = np.array([x0 + (x1 - x0) * s / PIXELS for s in shares[:2]])
    seen = np.append(seen, [y0 + (y1 - y0) * s / PIXELS for s in shares[2:]])
    corners = np.array(
        [
            proj3d.proj_transform(x, y, 0.0, axes.get_proj())[:2]
            for x in axes.get_xlim()
            for y in axes.get_ylim()
        ]
    )
    expected = [*corners[:, 0][[0, 3]], corners[:, 1].min(), corners[:, 1].max()]
    assert np.allclose(seen, expected, atol=SLACK * (x1 - x0))
    assert axes._box_aspect[2] / axes._box_aspect[0] == pytest.approx(0.72)
