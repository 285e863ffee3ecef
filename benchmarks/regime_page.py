"""Write docs/regime.md from a map: what stands in it is counted here.

    fpk regime fig6a --vary contact.stiffness=0.01:1000:log25 --vary contact.clearance=0.1:2:20 \
        --out out/map --json > map.json
    python benchmarks/regime_page.py map.json out/map/regime.svg
"""

import argparse
import json
import shutil
from collections import Counter
from datetime import date
from pathlib import Path
from statistics import median

DOCS = Path(__file__).resolve().parent.parent / "docs"
ACCEPTABLE = 0.1
"""L1 distance that ``[expect] acceptable`` lets pass."""
RULE = 2.0
"""Clearance over the standard deviation of q2 from which section 6.3 neglects the contacts."""


def main() -> None:
    """Copy the picture and write the page."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("map", type=Path)
    parser.add_argument("picture", type=Path)
    arguments = parser.parse_args()
    points = json.loads(arguments.map.read_text())["points"]
    winners = Counter(p["winner"] for p in points)
    noise = max(e for p in points for e in p["error"].values())
    beyond = [p for p in points if p["rms_ratio"] > RULE]
    near = [p for p in points if p["L1"]["integrable"] <= ACCEPTABLE]
    inside = sum(p["rms_ratio"] > RULE for p in near)
    best = [min(p["L1"].values()) for p in points]
    references = Counter(p["reference"] for p in points)
    of = ", ".join(f"{count} by {name}" for name, count in references.items())
    shutil.copy(arguments.picture, DOCS / "regime.svg")
    (DOCS / "regime.md").write_text(
        f"""# Which theory, where

Written by `benchmarks/regime_page.py` on {date.today()}. Both averaged theories against the full
system over stiffness and clearance of the stops of Fig. 6(a): the L1 distance of p(q2).
References: {of}; their noise moves a distance by at most {noise:.4f}.

```sh
fpk regime fig6a --vary contact.stiffness=0.01:1000:log25 \\
    --vary contact.clearance=0.1:2:20 --out out/map
```

![L1 distance of both averagings, and which is nearer](regime.svg)

| of {len(points)} points | |
| --- | --- |
| averaging of one energy, Eq. (11), nearer | {winners["nonintegrable"]} |
| averaging of the modal energies, Eq. (34), nearer | {winners["integrable"]} |
| within the noise | {winners["undecided"]} |
| clearance beyond {RULE:g} standard deviations of q2 (section 6.3) | {len(beyond)} |
| ... and Eq. (34) within {ACCEPTABLE:g} there | {inside} |
| Eq. (34) within {ACCEPTABLE:g} with less clearance | {len(near) - inside} |
| neither theory within {ACCEPTABLE:g} | {sum(b > ACCEPTABLE for b in best)} |
| largest distance of the better one | {max(best):.3f} |
| median distance of the better one | {median(best):.3f} |
"""
    )


if __name__ == "__main__":
    main()
