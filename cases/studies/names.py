"""What the routes of a study are called in tables, legends and files: said once, here."""

QUADRATURE = "quadrature (11)"
QUADRATURE_WORDS = "quadrature of (11), by tolerance"
BY_TOL = {1: "FE hp", 2: "weighted, tol"}
"""The solver that is steered by a tolerance, by the number of energies."""
BY_TOL_WORDS = {1: "hp elements, by tolerance", 2: "weighted expansion of (17), by tolerance"}
EXPLAINED = {
    1: "FE hp: elements whose number and degree follow from the tolerance, cut until it is met.",
    2: (
        "weighted, tol: no elements with a mesh to refine but p = w u, with w = exp(−Φ) a positive"
        " weight near p and u one polynomial; where probability circulates much u is one on each of"
        " a few elements, and where no weight does (levels marked w = 1) plain elements take over."
        " With constant damping the first weight is (34) itself, and nothing is left to expand."
    ),
}
"""A line below the tables in which the route stands."""


def elements(degree: int) -> str:
    """Return the name of plain elements of one degree on given meshes."""
    return f"FE p = {degree}"
