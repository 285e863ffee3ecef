"""Write docs/regime.md from a map: what stands in it is counted here.

    fpk regime fig6a --vary contact.stiffness=0.01:1000:log25 --vary contact.clearance=0.1:2:20 \
        --reference phase-space --out out/map --json > map.json
    python benchmarks/regime_page.py map.json out/map/regime.svg
"""

import argparse
import json
import shutil
from collections import Counter
from datetime import date
from pathlib import Path
from statistics import median
from typing import Any

import numpy as np
from report import markdown_table
from scipy.interpolate import Akima1DInterpolator, PchipInterpolator

DOCS = Path(__file__).resolve().parent.parent / "docs"
ACCEPTABLE = 0.1
"""L1 distance that ``[expect] acceptable`` lets pass."""
FINE = 2e-4
"""Error of a distance that the full equation is solved to, where its work allows."""
RULE = 2.0
"""Clearance over the standard deviation of q2 from which section 6.3 neglects the contacts."""


def main() -> None:
    """Copy the picture and write the page."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("map", type=Path)
    parser.add_argument("picture", type=Path)
    arguments = parser.parse_args()
    record = json.loads(arguments.map.read_text())
    points = record["points"]
    winners = Counter(p["winner"] for p in points)
    errors = [max(p["error"].values()) for p in points]
    beyond = [p for p in points if p["rms_ratio"] > RULE]
    kept = [p for p in beyond if p["L1"]["integrable"] + p["error"]["integrable"] <= ACCEPTABLE]
    near = [p for p in points if p["L1"]["integrable"] <= ACCEPTABLE]
    best = [min(p["L1"].values()) for p in points]
    references = Counter(p["reference"] for p in points).items()
    of = ", ".join(f"{count} by {name}" for name, count in references)
    fine = sum(e <= FINE for e in errors)
    rest = f"; {max(errors):.2g} at the most, with stiff stops" if fine < len(points) else ""
    shutil.copy(arguments.picture, DOCS / "regime.svg")
    (DOCS / "regime.md").write_text(
        f"""# Which theory, where

Written by `benchmarks/regime_page.py` on {date.today()}. Both averaged theories against the full
system over stiffness and clearance of the stops of Fig. 6(a): the L1 distance of p(q2).
References: {of}; {record["seconds"] / 60.0:.0f} minutes on two cores. The error of a distance is
at most {FINE:g} at {fine} of {len(points)} points{rest}.

```sh
fpk regime fig6a --vary contact.stiffness=0.01:1000:log25 \\
    --vary contact.clearance=0.1:2:20 --reference phase-space --out out/map
```

![L1 distance of both averagings, and which is nearer](regime.svg)

| of {len(points)} points | |
| --- | --- |
| averaging of one energy, Eq. (11), nearer | {winners["nonintegrable"]} |
| averaging of the modal energies, Eq. (34), nearer | {winners["integrable"]} |
| within the errors | {winners["undecided"]} |
| clearance beyond {RULE:g} standard deviations of q2 (section 6.3) | {len(beyond)} |
| ... and Eq. (34) within {ACCEPTABLE:g} there, errors included | {len(kept)} |
| largest distance of Eq. (34) there | {max(p["L1"]["integrable"] for p in beyond):.4f} |
| Eq. (34) within {ACCEPTABLE:g} with less clearance | {len(near) - len(kept)} |
| neither theory within {ACCEPTABLE:g} | {sum(b > ACCEPTABLE for b in best)} |
| largest distance of the better one | {max(best):.3f} |
| median distance of the better one | {median(best):.3f} |

## The border

Stiffness at which both theories are equally far from the full system, between points of the map by
monotone cubic interpolation in ln B; ± what the errors of the distances and another interpolation
(Akima) change.

{markdown_table(["clearance", "B", "±", "distance of both"], border(points))}"""
    )


def border(points: list[dict[str, Any]]) -> list[list[str]]:
    """Return the stiffness of equal distances for each clearance, and how well it is known."""
    rows = []
    for clearance in sorted({p["values"][1] for p in points}):
        row = sorted((p for p in points if p["values"][1] == clearance), key=lambda p: p["values"])
        x = np.log([p["values"][0] for p in row])
        one, modal = (
            np.array([p["L1"][name] for p in row]) for name in ("nonintegrable", "integrable")
        )
        error = np.array([sum(p["error"].values()) for p in row])
        roots, others = (
            interpolated(x, one - modal).roots(extrapolate=False)
            for interpolated in (PchipInterpolator, Akima1DInterpolator)
        )
        for root in roots:
            slope = abs(float(PchipInterpolator(x, one - modal)(root, 1)))
            wide = float(np.interp(root, x, error)) / slope
            wide = max(wide, float(np.min(np.abs(others - root), initial=np.inf)))
            B, distance = float(np.exp(root)), float(PchipInterpolator(x, one)(root))
            rows.append([f"{clearance:g}", f"{B:.4g}", f"{B * wide:.1g}", f"{distance:.4f}"])
    return rows


if __name__ == "__main__":
    main()
