"""One thread of linear algebra for each process that runs tests: the processes share the cores.

With more, small matrices of many processes wait for each other's threads: on two busy cores the
tests of two energies take ten times as long. It has to stand here, before NumPy is imported.
"""

import os

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
os.environ.setdefault("OMP_NUM_THREADS", "1")
