"""The report of fig6a in Chromium: shot as readers see it, its sizes and frames measured.

    python benchmarks/report_page.py [--folder DIR]

runs ``fpk run fig6a``, or takes the folder of such a run, and writes docs/page.md with the pictures
of docs/pictures. Chromium's window draws 60 frames a second at most.
"""

import argparse
import io
import subprocess
import sys
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

from browser import Browser
from PIL import Image
from report import machine, markdown_table

DOCS = Path(__file__).resolve().parent.parent / "docs"
WIDE, NARROW = 1280, 390
"""Widths in pixels of a computer's window and of a telephone."""
PAPER = 718
"""Pixels between the margins of A4."""
COLOURS = 256
"""Colours of a picture: text and lines need no more, and the file is half."""
STATES: dict[str, tuple[str, int, int, dict[str, Any]]] = {
    "report": ("on a light screen", 0, 1900, {"width": WIDE}),
    "report-dark": ("on a dark screen", 0, 1900, {"width": WIDE, "dark": True}),
    "report-no-script": ("without script", 1150, 1000, {"width": WIDE, "script": False}),
    "report-paper": ("on paper", 0, 1015, {"width": PAPER, "paper": True}),
    "report-phone": ("on a telephone", 0, 1400, {"width": NARROW, "height": 844}),
    "report-phone-dark": (
        "on a telephone at night, densities", -1, 1400,
        {"width": NARROW, "height": 844, "dark": True},
    ),
}  # fmt: skip
"""Pictures by file: words, upper edge (-1: that of the densities), height, state of the browser."""

SIZES = """(() => {
  const bytes = text => new TextEncoder().encode(text).length;
  const sum = of => [...document.querySelectorAll(of)].reduce((n, e) => n + bytes(e.outerHTML), 0);
  return {data: sum("#data"), drawn: sum("figure:not(.live) > svg"),
    script: sum("script:not(#data)"), style: sum("style")};
})()"""

RECOMPUTED = """(() => {
  const times = [], x = Array.from({length: 400}, (_, i) => 0.004 * (i + 1));
  for (let k = 0; k < 101; k++) {
    const begin = performance.now(), forms = report.closedForms({B: 1 + 0.01 * k});
    for (const of of ["q2", "H"]) for (const form of Object.values(forms(of))) form && x.map(form);
    times.push(performance.now() - begin);
  }
  return times.sort((a, b) => a - b)[50];
})()"""
"""Median of the milliseconds that the closed forms of p(q2) and p(H) take at 400 points."""

FRAMES = """new Promise(done => {
  const slider = document.querySelector("#sliders input[data-key=B]"), work = [], gaps = [];
  let last;
  const step = now => {
    if (last !== undefined) gaps.push(now - last);
    last = now;
    const begin = performance.now();
    slider.value = Math.sin(gaps.length / 20);
    slider.dispatchEvent(new Event("input"));
    work.push(performance.now() - begin);
    if (gaps.length < 300) return requestAnimationFrame(step);
    for (const list of [work, gaps]) list.sort((a, b) => a - b);
    done({work: work[150], frames: 1000 / gaps[150], late: gaps.filter(g => g > 25).length / 300});
  };
  requestAnimationFrame(step);
})"""
"""The slider of B moves in every frame and all pictures are drawn anew: medians of 300 frames."""

PAGE = """# The report on screen and paper

Written by `benchmarks/report_page.py`, which runs `fpk run fig6a` and looks at its report in
Chromium. {machine}.

{table}
The data are those of the pictures that can be touched; the drawn pictures stand in their place
without script and on paper. Folded parts are not seen before they are opened. A frame is late if
it comes 25 ms after the one before; other programs that run meanwhile make frames late, and times
longer, but not the processor time, of which there are 16.7 ms a frame at 60 frames a second.

{pictures}"""


def shoot(browser: Browser, url: str) -> list[str]:
    """Write all pictures and return the figures that show them."""
    figures = []
    for name, (words, top, height, state) in STATES.items():
        browser.open(url, **state)
        if top < 0:
            at = 'document.getElementById("densities").getBoundingClientRect().top'
            top = max(int(browser.value(at)) - 10, 0)
        shot = Image.open(io.BytesIO(browser.shot(top=top, height=height))).convert("RGB")
        path = DOCS / "pictures" / f"{name}.png"
        shot.quantize(COLOURS).save(path, optimize=True)
        print(f"{path}: {path.stat().st_size / 1000:.0f} kB", file=sys.stderr)
        width = min(shot.width, 640)
        figures.append(
            f"```{{figure}} pictures/{name}.png\n:alt: The report of fig6a {words}\n"
            f":width: {width}px\n\nThe report {words}.\n```\n"
        )
    return figures


def busy(browser: Browser) -> float:
    """Return the processor time of the page's main thread in seconds, others left out."""
    browser.call("Performance.enable", timeDomain="threadTicks")
    metrics = browser.call("Performance.getMetrics")["metrics"]
    return next(float(m["value"]) for m in metrics if m["name"] == "TaskDuration")


def measured(browser: Browser, path: Path) -> list[tuple[str, str]]:
    """Return what is measured and the measurements in words."""
    browser.open(path.as_uri(), width=WIDE)
    rows = []
    sizes = browser.value(SIZES)
    sizes["everything else"] = path.stat().st_size - sum(sizes.values())
    names = {"data": "data of the curves", "drawn": "drawn pictures", "style": "styles"}
    rows += [(names.get(key, key), f"{size / 1000:.0f} kB") for key, size in sizes.items()]
    height = "document.documentElement.scrollHeight"
    rows.append((f"height at {WIDE} px, folded", f"{browser.value(height)} px"))
    ours, before = browser.value(RECOMPUTED), busy(browser)
    slider = browser.value(FRAMES)
    processor = 1000.0 * (busy(browser) - before) / 300
    rows.append(("closed forms of p(q₂) and p(H) at 400 points", f"{ours:.1f} ms"))
    rows.append(("recomputing and drawing in a frame, slider moving", f"{slider['work']:.1f} ms"))
    rows.append(("processor time of the page in a frame, with layout", f"{processor:.1f} ms"))
    rows.append(("frames a second while a slider moves, median", f"{slider['frames']:.0f}"))
    rows.append(("frames that are late", f"{100 * slider['late']:.0f} %"))
    browser.open(path.as_uri(), width=NARROW, height=844)
    rows.append((f"height at {NARROW} px, folded", f"{browser.value(height)} px"))
    return rows


def main() -> None:
    """Run the scene, look at its report, write the page."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--folder", type=Path, help="output of fpk run fig6a")
    folder = parser.parse_args().folder
    with TemporaryDirectory() as temporary, Browser() as browser:
        if folder is None:
            folder = Path(temporary)
            start = "from cases.command.cli import main; main()"
            command = ["run", "fig6a", "--out", str(folder), "--quiet"]
            subprocess.run([sys.executable, "-c", start, *command], check=True)
        path = (folder / "report.html").resolve()
        table = markdown_table(("of the report of fig6a", "measured"), measured(browser, path))
        pictures = "\n".join(shoot(browser, path.as_uri()))
    text = PAGE.format(machine=machine(), table=table, pictures=pictures)
    (DOCS / "page.md").write_text(text, encoding="utf-8")


if __name__ == "__main__":
    main()
