"""The report of fig6a in Chromium, on a computer and a telephone: docs/pictures/report*.png.

    python benchmarks/report_pictures.py [--folder DIR]

runs ``fpk run fig6a``, or takes the folder of such a run.
"""

import argparse
import io
import subprocess
import sys
from pathlib import Path
from tempfile import TemporaryDirectory

from browser import Browser
from PIL import Image

PICTURES = Path(__file__).resolve().parent.parent / "docs" / "pictures"
SHOTS = {"report": (1280, 1900), "report-phone": (390, 1400)}
"""Width of the window and height of the picture in pixels."""
COLOURS = 256
"""Colours of a picture: text and lines need no more, and the file is half."""


def main() -> None:
    """Run the scene and take the pictures of its report."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--folder", type=Path, help="output of fpk run fig6a")
    folder = parser.parse_args().folder
    with TemporaryDirectory() as temporary, Browser() as browser:
        if folder is None:
            folder = Path(temporary)
            start = "from cases.command.cli import main; main()"
            command = ["run", "fig6a", "--out", str(folder), "--quiet"]
            subprocess.run([sys.executable, "-c", start, *command], check=True)
        for name, (width, height) in SHOTS.items():
            browser.open((folder / "report.html").resolve().as_uri(), width=width)
            shot = Image.open(io.BytesIO(browser.shot(height=height))).convert("RGB")
            shot.quantize(COLOURS).save(PICTURES / f"{name}.png", optimize=True)


if __name__ == "__main__":
    main()
