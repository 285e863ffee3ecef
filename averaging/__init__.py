"""System to Density by theory: stochastic averaging, exact and Gaussian solutions.

``NonIntegrable`` averages the total energy, ``Integrable`` the energies of the modes; ``Exact`` and
``Linear`` solve the full system where its damping and noise, or the lack of contacts, allow it.
Importing the package registers their routes.
"""

from averaging.exact import Exact
from averaging.gaussian import Linear
from averaging.integrable import Integrable
from averaging.nonintegrable import NonIntegrable

__all__ = ["Exact", "Integrable", "Linear", "NonIntegrable"]
