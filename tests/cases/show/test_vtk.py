"""What ParaView reads back is the density, within the error that the file states."""

from pathlib import Path

import numpy as np
import pytest

from averaging.theory import Exact
from cases.compare.routes import method_for
from cases.scene.scene import load_scene
from cases.show.vtk import write_vtu
from fpk.answer.certificate import Certificate
from fpk.answer.density import Density
from fpk.answer.names import parse_observable
from fpk.answer.quantities import FIELD_CUT, SUBDIVISION, field_of

pyvista = pytest.importorskip("pyvista", reason="pyvista is not installed")


def words(grid, *names):
    return {name: str(grid.field_data[name][0]) for name in names}


@pytest.mark.parametrize("correlation", [0.0, -0.9])
def test_cells_shrink_until_the_error_is_met_in_the_smallest_box_that_holds_the_density(
    correlation,
):
    """A Gaussian is at the cut on an ellipse of the half-widths σ √(2 ln 1e6), however tilted."""
    deviations = 1.0, 0.5

    def pdf(x, y):
        u, v = x / deviations[0], y / deviations[1]
        return np.exp(-(u * u + v * v - 2 * correlation * u * v) / (2 * (1 - correlation**2)))

    pair, panels = parse_observable("q1,p1", 1), (np.linspace(-12, 8, 9), np.linspace(-4, 6, 5))
    known = Certificate(0.0, 0.0, 0.0, 0.0, 0.0)
    exact = Density(pair, panels, pdf, lambda x, y: 0.0 * (x + y), 0.0, known)
    mesh, error = field_of({"a": exact})
    p = mesh.point_data["density"]
    assert error <= SUBDIVISION * p.max()
    nodes = [np.unique(x).size for x in mesh.points.T[:2]]
    assert len(mesh.points) == np.prod(nodes) and all(n % 2 == 1 for n in nodes)
    for x, deviation in zip(mesh.points.T, deviations, strict=False):
        half_width = deviation * np.sqrt(-2.0 * np.log(FIELD_CUT))
        for end in (x.min(), x.max()):
            # Beyond it by no more than one of 100 intervals along the axis.
            assert 1.0 <= abs(end) / half_width < 1.03
    assert p.min() < 1e-3 * FIELD_CUT * p.max()  # in the corners of the box


@pytest.mark.parametrize("of", ["q2", "q2,p2", "H"])
def test_what_is_read_back_is_the_density(of, fpk, tmp_path):
    """Between the nodes, the cells' own quadratic interpolation in VTK against the closed form."""
    path = tmp_path / "field.vtu"
    assert fpk("export", "fig3a", "--of", of, "--out", path)[0] == 0
    grid = pyvista.read(path)
    scene = load_scene("fig3a")
    observable = parse_observable(of, 2)
    assert words(grid, "scene", "observable", "units") == {
        "scene": "fig3a", "observable": of, "units": "the scene's own consistent units"
    }  # fmt: skip
    assert "[[contact]]" in str(grid.field_data["scene file"][0])
    stated, largest = (
        float(grid.field_data[n][0]) for n in ("subdivision error", "largest density")
    )
    assert stated <= SUBDIVISION * largest
    (truth,) = Exact().solve(scene.system, [observable]).densities
    low, high = np.array(grid.bounds).reshape(3, 2).T
    points = np.random.default_rng(8).uniform(low, high, size=(400, 3))
    if of == "q2,p2":
        read = pyvista.PolyData(points).sample(grid)
        assert read["vtkValidPointMask"].all()
        values = read["density"]
    else:  # VTK finds no points in lines: evaluate their quadratics here
        cells = grid.cells.reshape(-1, 4)[:, 1:]
        x, p = grid.points[:, 0], grid["density"]
        a, b, m = cells[np.searchsorted(x[cells[:, 1]], points[:, 0])].T
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
    assert grid.active_scalars_name == "density"
    p, decades = grid["density"], grid["log10 density"]
    np.testing.assert_allclose(10.0 ** decades[p > 0], p[p > 0], rtol=1e-12)
    if of != "H":
        # The same mesh in memory, for meshio and pyvista.
        mesh, other = truth.to_meshio(), truth.to_pyvista()
        value, error = truth.at(*mesh.points.T[: len(observable)])
        tiny = 1e-14 * value.max()
        np.testing.assert_allclose(mesh.point_data["density"], value, atol=tiny)
        np.testing.assert_allclose(mesh.point_data["error of p"], error, atol=tiny)
        assert isinstance(other, pyvista.UnstructuredGrid) and other.n_points == len(mesh.points)
        np.testing.assert_array_equal(other["density"], mesh.point_data["density"])


def test_a_collection_has_the_varied_number_for_its_time(fpk, tmp_path):
    assert fpk("export", "fig6a", "--of", "q2", "--out", tmp_path / "all.pvd")[0] == 0
    reader = pyvista.get_reader(tmp_path / "all.pvd")
    assert reader.time_values == sorted(c.value for c in load_scene("fig6a").curves)
    for time, label in zip(reader.time_values, ("B = 0.1", "B = 1", "B = 10"), strict=True):
        reader.set_active_time_value(time)
        field, stops = reader.read()
        assert str(field.field_data["curve"][0]) == label
        assert sorted(set(stops.points[:, 0])) == [-0.5, 0.5]


def test_every_observable_has_a_collection_and_stops_stand_where_the_mass_meets_them(
    answer, tmp_path, written, scene_text
):
    text = scene_text.replace('["q2", "H"]', '["q1", "q2,p2"]').replace('"both"', '"left"')
    record = answer("export", written(text), "--out", tmp_path / "all.pvd")
    files = [Path(file) for file in record["files"]]
    collections = {path.name for path in tmp_path.glob("*.pvd")}
    assert {p.name for p in files if p.suffix == ".pvd"} == collections
    assert collections == {"all_q1.pvd", "all_q2_p2.pvd"}
    assert all(path.stat().st_size > 100 for path in files)
    # No stop beside q1.
    (beside,) = (path for path in files if path.stem.endswith("_stops"))
    reader = pyvista.get_reader(tmp_path / "all_q2_p2.pvd")
    assert reader.time_values == [0.0]
    field, stops = reader.read()
    assert pyvista.read(beside).n_cells == stops.n_cells == 1 and {*stops.points[:, 0]} == {-0.5}
    assert stops.cell_data["mass"].tolist() == [2.0]
    np.testing.assert_allclose(stops.bounds[2:4], field.bounds[2:4])
    assert stops.bounds[5] == pytest.approx(float(field["density"].max()), rel=1e-12)
    assert stops.area == pytest.approx(np.ptp(field.points[:, 1]) * field["density"].max())


def test_the_simulation_is_an_array_of_the_field(solved, tmp_path, scene_text, units_text):
    sampled = method_for("montecarlo", paths=4096, relaxations=2.0, seed=3)
    outcome = solved(scene_text + units_text, "nonintegrable/closed-form", sampled)
    (written, _) = write_vtu(outcome, tmp_path / "x.vtu")
    grid = pyvista.read(written)
    density = outcome.curves[0].densities(outcome.scene.observables[0])
    (samples,) = [p for route, p in density.items() if route.sampled]
    value, error = samples.at(grid.points[:, 0])
    np.testing.assert_allclose(grid["montecarlo"], value, rtol=1e-12)
    np.testing.assert_allclose(grid["error of montecarlo"], error, rtol=1e-12)
    assert grid.active_scalars_name == "density"
    assert words(grid, "axes", "units", "unit of density") == {
        "axes": "q2 [mm]",
        "units": "mm, kg, s",
        "unit of density": "mm⁻¹",
    }
