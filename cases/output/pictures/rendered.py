"""The body of a surface as an image by VTK, to be laid under the axes that matplotlib draws.

Both look along the same direction without perspective, so that one shift and one scale bring the
image into the plane of the axes. Without the extra ``viz`` there is no image.
"""

from importlib.util import find_spec

import numpy as np
from matplotlib.image import AxesImage
from mpl_toolkits.mplot3d import Axes3D, proj3d

from fpk.density import Array

PIXELS = 1400
"""Width and height of the image: 300 dots per inch on a panel of 4.3 inches."""

MARGIN = 1.02
"""Half-width of the image over the half-diagonal of the box that the surface stands in."""


def can_render() -> bool:
    """Return whether pyvista is there, from the extra ``viz``."""
    return find_spec("pyvista") is not None


def lay_rendered(axes: Axes3D, grid: tuple[Array, ...], values: Array, *, top: float) -> None:
    """Lay the shaded surface of ``values`` into ``axes``, whose view and limits are set."""
    low, high = np.array([axes.get_xlim(), axes.get_ylim(), axes.get_zlim()]).T
    box = np.asarray(axes._box_aspect, dtype=float)

    def in_box(x: Array, y: Array, z: Array) -> list[Array]:
        return [
            (c - a) / (b - a) * size
            for c, a, b, size in zip((x, y, z), low, high, box, strict=True)
        ]

    x, y = np.meshgrid(*grid, indexing="ij")
    half = MARGIN * 0.5 * float(np.linalg.norm(box))
    image = _image(in_box(x, y, values), values / top, _direction(axes), 0.5 * box, half)
    centre, unit = _projected(axes, low, high, box)
    reach = half * unit
    laid = AxesImage(axes, interpolation="antialiased", zorder=2.5)
    laid.set_data(image)
    x0, y0 = centre
    laid.set_extent((x0 - reach, x0 + reach, y0 - reach, y0 + reach))
    axes.add_image(laid)  # imshow would set the aspect of the box


def _direction(axes: Axes3D) -> Array:
    """Unit vector from the box to the eye."""
    e, a = np.deg2rad([axes.elev, axes.azim])
    return np.array([np.cos(e) * np.cos(a), np.cos(e) * np.sin(a), np.sin(e)])


def _projected(axes: Axes3D, low: Array, high: Array, box: Array) -> tuple[Array, float]:
    """Centre of the box in the plane of the axes, and the length there of one unit of the box."""
    matrix = axes.get_proj()
    middle = 0.5 * (low + high)
    centre = np.array(proj3d.proj_transform(*middle, matrix)[:2])
    side = np.array([-np.sin(np.deg2rad(axes.azim)), np.cos(np.deg2rad(axes.azim)), 0.0])
    beside = middle + side * (high - low) / box  # one unit across the line of sight
    across = np.array(proj3d.proj_transform(*beside, matrix)[:2]) - centre
    return centre, float(np.hypot(*across))


def _image(points: list[Array], share: Array, eye: Array, centre: Array, half: float) -> Array:
    """RGBA image (PIXELS, PIXELS, 4) of the surface through ``points``, transparent around it."""
    import pyvista as pv
    from vtkmodules.vtkCommonCore import vtkLogger

    vtkLogger.SetStderrVerbosity(vtkLogger.VERBOSITY_OFF)  # it complains of the missing display
    sheet = pv.StructuredGrid(*points)
    sheet["share"] = share.ravel(order="F")
    plotter = pv.Plotter(off_screen=True, window_size=[PIXELS, PIXELS], lighting="three lights")
    plotter.add_mesh(
        sheet, scalars="share", cmap="viridis", clim=(0.0, 1.0), smooth_shading=True,
        show_scalar_bar=False, ambient=0.25, diffuse=0.75, specular=0.15, specular_power=12,
    )  # fmt: skip
    camera = plotter.camera
    camera.parallel_projection = True
    camera.focal_point = tuple(centre)
    camera.position = tuple(centre + 10.0 * eye)
    camera.up = (0.0, 0.0, 1.0)
    camera.parallel_scale = half
    plotter.camera_set = True  # else the first rendering moves it to where all is seen
    plotter.enable_anti_aliasing("ssaa")
    image = np.asarray(plotter.screenshot(None, return_img=True, transparent_background=True))
    plotter.close()
    return image
