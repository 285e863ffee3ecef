"""Shoots the pictures of the report that README and the site show, by Chromium.

    fpk run fig6a --out out/fig6a && python benchmarks/report_pictures.py out/fig6a

writes docs/pictures/report.png (1280 pixels wide) and report-dark.png (a telephone, dark).
"""

import shutil
import subprocess
import sys
from html import escape
from pathlib import Path
from tempfile import TemporaryDirectory

from PIL import Image

PICTURES = Path(__file__).parent.parent / "docs" / "pictures"
COLOURS = 128
"""Colours of a picture: text and lines need no more, and the file is a third."""
PHONE = 390
"""Width of a telephone; a window is never narrower than 500 pixels, a frame in it is."""


def shoot(page: Path, picture: Path, width: int, height: int, *options: str) -> None:
    """Write the top of ``page`` as a picture of few colours."""
    with TemporaryDirectory() as folder:
        shot = Path(folder) / "shot.png"
        subprocess.run(
            ["chromium", "--headless", "--no-sandbox", "--disable-gpu", "--hide-scrollbars",
             f"--user-data-dir={folder}/profile", f"--window-size={max(width, 500)},{height}",
             *options, f"--screenshot={shot}", page.resolve().as_uri()],
            check=True, capture_output=True, timeout=120,
        )  # fmt: skip
        image = Image.open(shot).convert("RGB").crop((0, 0, width, height))
        image.quantize(COLOURS).save(picture, optimize=True)
    print(f"{picture}: {picture.stat().st_size / 1000:.0f} kB")


def main(folder: Path) -> None:
    """Shoot the report of the run in ``folder``."""
    if shutil.which("chromium") is None:
        sys.exit("chromium is not installed (Debian package chromium)")
    page = folder / "report.html"
    PICTURES.mkdir(exist_ok=True)
    shoot(page, PICTURES / "report.png", 1280, 1900)
    with TemporaryDirectory() as other:
        framed = Path(other) / "framed.html"
        text = escape(page.read_text(encoding="utf-8"))
        style = "border: 0; position: absolute; left: 0; top: 0"
        frame = f'<iframe style="{style}" width="{PHONE}" height="1200" srcdoc="{text}"></iframe>'
        framed.write_text(f"<!doctype html><body>{frame}</body>", encoding="utf-8")
        dark = "--blink-settings=preferredColorScheme=0"
        shoot(framed, PICTURES / "report-dark.png", PHONE, 1200, dark)


if __name__ == "__main__":
    main(Path(sys.argv[1]))
