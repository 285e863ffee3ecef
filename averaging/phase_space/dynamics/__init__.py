"""The stationary motion in time: crossings, spectra, autocovariances and relaxation rates.

``answer`` has how expansions rise until a question is answered to its tolerance; ``crossings`` and
``correlations`` the questions, ``resolvent`` the equations of the latter.
"""
