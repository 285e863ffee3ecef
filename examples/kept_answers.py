"""
Keeping answers
===============

Answers can be pickled: a density goes to disk without its functions and computes them again, to the
same last bit.
"""

import pickle

import fpk

system = fpk.System([1.0, 2.0], [1.0, 3.0], [0.1, 0.2], [0.05, 0.1])
answers = fpk.solve(system, ["q1", "H"], methods=["linear", "nonintegrable/closed-form"])
again = pickle.loads(pickle.dumps(answers))

assert repr(again) == repr(answers)
for observable, method in answers:
    p, restored = answers[observable, method], again[observable, method]
    assert restored.certificate == p.certificate
    assert restored(0.2) == p(0.2)  # solved again with the same settings: the same to the last bit
    print(f"{observable} by {method}: {p(0.2)} and {restored(0.2)}")
