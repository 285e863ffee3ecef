"""The stationary motion in time: crossings, spectra, autocovariances and relaxation rates.

``questions`` has how expansions rise until each is answered, ``resolvent`` the equations.
"""
