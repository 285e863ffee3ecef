"""
Files for other programs: VTK, netCDF, CSV
==========================================

``fpk export`` writes the densities of a scene; the ending says the format. In Python the same is
done by functions. Here a field is written for ParaView, read back with PyVista, and held against
the density itself.
"""

from dataclasses import replace
from pathlib import Path
from tempfile import TemporaryDirectory

import h5netcdf
import matplotlib.pyplot as plt
import numpy as np
import pyvista

import fpk
from averaging import Exact
from cases.compare.stationary import run_scene
from cases.scene.scene import shipped_scenes
from cases.show.fields import write_netcdf
from cases.show.vtk import write_vtu
from fpk.answer.names import parse_observable

assert "fig3a" in shipped_scenes()
scene = fpk.load("fig3a")
outcome = run_scene(replace(scene, observables=(parse_observable("q2,p2", 2),)), [Exact()])
with TemporaryDirectory() as folder:
    write_vtu(outcome, Path(folder) / "field.vtu")
    write_netcdf(outcome, Path(folder) / "field.nc")
    mesh = pyvista.read(Path(folder) / "field.vtu")
    with h5netcdf.File(Path(folder) / "field.nc") as file:
        print("netCDF holds", ", ".join(file.variables))
print("VTK holds", ", ".join(mesh.point_data))

# %%
# The field as it was read, and its error at the nodes.

joint = fpk.solve(fpk.load("fig3a").system, ["q2,p2"], methods=["exact"])["q2,p2"]
q, p = mesh.points[:, 0], mesh.points[:, 1]
values = np.ravel(mesh.point_data["exact"])
figure, axes = plt.subplots()
picture = axes.tricontourf(q, p, values, 12, cmap="cividis")
axes.set(xlabel="$q_2$", ylabel="$p_2$")
figure.colorbar(picture, label="$p(q_2, p_2)$")

difference = np.max(np.abs(values - joint(q, p)))
print(f"{values.size} nodes: off by {difference:.1e} at most")
assert difference <= 1e-12 * values.max()
