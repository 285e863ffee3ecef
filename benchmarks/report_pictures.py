"""Shoots the picture of a report that README and the site show, by Chromium.

    fpk run fig6a --out out/fig6a && python benchmarks/report_pictures.py out/fig6a

writes docs/pictures/report.png, the top of the report.
"""

import shutil
import subprocess
import sys
from pathlib import Path
from tempfile import TemporaryDirectory

from PIL import Image

PICTURE = Path(__file__).parent.parent / "docs" / "pictures" / "report.png"
SIZE = (1280, 1900)
"""Width and height in pixels."""
COLOURS = 128
"""Colours of a picture: text and lines need no more, and the file is a third."""


def main(folder: Path) -> None:
    """Shoot the report of the run in ``folder``."""
    if shutil.which("chromium") is None:
        sys.exit("chromium is not installed (Debian package chromium)")
    PICTURE.parent.mkdir(exist_ok=True)
    with TemporaryDirectory() as other:
        shot = Path(other) / "shot.png"
        subprocess.run(
            ["chromium", "--headless", "--no-sandbox", "--disable-gpu", "--hide-scrollbars",
             f"--user-data-dir={other}/profile", f"--window-size={SIZE[0]},{SIZE[1]}",
             f"--screenshot={shot}", (folder / "report.html").resolve().as_uri()],
            check=True, capture_output=True, timeout=120,
        )  # fmt: skip
        Image.open(shot).convert("RGB").quantize(COLOURS).save(PICTURE, optimize=True)
    print(f"{PICTURE}: {PICTURE.stat().st_size / 1000:.0f} kB")


if __name__ == "__main__":
    main(Path(sys.argv[1]))
