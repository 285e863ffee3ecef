"""What ParaView reads back is the density, within the error that the file states."""

from xml.etree import ElementTree

import numpy as np
import pytest

from averaging.exact import Exact
from averaging.nonintegrable import NonIntegrable
from cases.output.vtk import SUBDIVISION, field_of
from cases.scene.scene import load_scene
from fpk.certificate import Certificate
from fpk.density import Density
from fpk.observable import parse_observable

FINE = Certificate(0.0, 0.0, 0.0, 0.0)


@pytest.fixture(scope="module")
def pyvista():
    return pytest.importorskip("pyvista", reason="pyvista is not installed")


def test_a_quadratic_is_kept_without_loss():
    q1 = parse_observable("q1", 1)

    def pdf(x):
        return np.asarray(0.75 * (1 - x**2))

    panels = (np.array([-1.0, 1.0]),)
    mesh, subdivision = field_of({"a": Density(q1, panels, pdf, np.zeros_like, 0.0, FINE)})
    assert subdivision < 1e-15 and len(mesh.points) == 3


def test_cells_shrink_until_the_stated_error_is_met():
    def pdf(x, y):
        return np.exp(-0.5 * (x * x + 4 * y * y)) / np.pi

    pair = parse_observable("q1,p1", 1)
    panels = (np.linspace(-8, 8, 9), np.linspace(-4, 4, 5))
    density = Density(pair, panels, pdf, lambda x, y: 0 * x * y, 0.0, FINE)
    mesh, subdivision = field_of({"a": density})
    assert subdivision <= SUBDIVISION * mesh.point_data["density"].max()
    nodes = [np.unique(x).size for x in mesh.points.T[:2]]
    assert len(mesh.points) == np.prod(nodes) and all(n % 2 == 1 for n in nodes)


@pytest.mark.parametrize("of", ["q2", "q2,p2", "H"])
def test_what_is_read_back_is_the_density(of, fpk, pyvista, tmp_path):
    """Between the nodes, the cells' own quadratic interpolation in VTK against the closed form."""
    path = tmp_path / "field.vtu"
    assert fpk("export", "fig3a", "--of", of, "--out", path)[0] == 0
    grid = pyvista.read(path)
    scene = load_scene("fig3a")
    observable = parse_observable(of, 2)
    words = {name: str(grid.field_data[name][0]) for name in ("scene", "observable", "units")}
    assert words == {
        "scene": "fig3a", "observable": of, "units": "the scene's own consistent units"
    }  # fmt: skip
    assert "[[contact]]" in str(grid.field_data["scene file"][0])
    stated, largest = (
        float(grid.field_data[n][0]) for n in ("subdivision error", "largest density")
    )
    assert stated <= SUBDIVISION * largest
    truth = Exact().solve(scene.system, [observable]).densities[0]
    rng = np.random.default_rng(8)
    low, high = np.array(grid.bounds).reshape(3, 2).T
    points = rng.uniform(low, high, size=(400, 3))
    if of == "q2,p2":
        read = pyvista.PolyData(points).sample(grid)
        assert read["vtkValidPointMask"].all()
        values = read["density"]
    else:  # VTK finds no points in lines: evaluate their quadratics here
        cells = grid.cells.reshape(-1, 4)[:, 1:]
        x, p = grid.points[:, 0], grid["density"]
        at = np.searchsorted(x[cells[:, 1]], points[:, 0])
        a, b, m = cells[at].T
        t = (points[:, 0] - x[a]) / (x[b] - x[a])
        values = (1 - t) * (1 - 2 * t) * p[a] + t * (2 * t - 1) * p[b] + 4 * t * (1 - t) * p[m]
    exact = truth.at(*points[:, : len(observable)].T)[0]
    assert np.max(np.abs(values - exact)) <= 1.5 * stated + 1e-12 * largest
    fem = grid["nonintegrable fem"]
    np.testing.assert_array_equal(grid["density"], fem)
    difference = grid["nonintegrable fem - nonintegrable closed-form"]
    np.testing.assert_array_equal(difference, fem - grid["nonintegrable closed-form"])
    assert np.all(np.abs(difference) < 1e-9 * largest)
    nodes = truth.at(*grid.points[:, : len(observable)].T)[0]
    assert np.max(np.abs(grid["exact"] - nodes)) <= 1e-12 * largest


def test_a_collection_names_every_density_of_every_curve(fpk, tmp_path):
    assert fpk("export", "fig6a", "--of", "q2", "--out", tmp_path / "all.pvd")[0] == 0
    entries = list(ElementTree.parse(tmp_path / "all.pvd").getroot().iter("DataSet"))
    assert [e.get("timestep") for e in entries] == ["0", "1", "2"]
    assert all((tmp_path / e.get("file")).stat().st_size > 1000 for e in entries)


def test_an_observable_that_no_theory_gives_is_refused(fpk, tmp_path):
    assert NonIntegrable().refusal(load_scene("fig6a").system, parse_observable("H,q1", 2))
    status, out, err = fpk("export", "fig6a", "--of", "H,q1", "--out", tmp_path / "x.vtu")
    assert (status, out) == (2, "") and err.count("\n") == 1 and "H,q1" in err
