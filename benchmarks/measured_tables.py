"""Cut the short tables of docs/measured.md from the pages of docs/benchmarks.

    python benchmarks/measured_tables.py [--check]

The page holds pairs of lines ``<!-- table: NAME -->`` and ``<!-- end -->``; what stands between
them is replaced by what stands between the same lines of the page that has them. ``--check`` writes
nothing and exits 1 where the structure of a table, its header and first column, is not the page's.
"""

import argparse
import re
import sys
from pathlib import Path

ROOT = Path(__file__).resolve().parent.parent
BLOCK = re.compile(r"(<!-- table: (\w+) -->\n)(.*?)(<!-- end -->)", re.DOTALL)


def blocks(text: str) -> dict[str, str]:
    """Return what stands between the marks, by name."""
    return {name: body for _, name, body, _ in BLOCK.findall(text)}


def page_blocks() -> dict[str, str]:
    """Return the tables of all pages. Raises ``ValueError`` where two have one name."""
    found: dict[str, str] = {}
    for page in sorted((ROOT / "docs" / "benchmarks").glob("*.md")):
        for name, body in blocks(page.read_text()).items():
            if name in found:
                raise ValueError(f"the table {name} stands in two pages; {page.name} is the second")
            found[name] = body
    return found


def structure(table: str) -> tuple[list[str], list[str]]:
    """Return the header and the first column of a Markdown table, which no timing changes."""
    rows = [line for line in table.splitlines() if line.startswith("|")]
    cells = [[cell.strip() for cell in row.strip("|").split("|")] for row in rows]
    return (cells[0] if cells else []), [row[0] for row in cells[2:]]


def with_tables(text: str, tables: dict[str, str]) -> str:
    """Return ``text`` with its tables replaced. Raises ``KeyError`` for a name no page has."""
    return BLOCK.sub(lambda m: m[1] + tables[m[2]] + m[4], text)


def main() -> None:
    """Replace the tables, or check them."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--page", type=Path, default=ROOT / "docs" / "measured.md")
    parser.add_argument("--check", action="store_true", help="write nothing; exit 1 if not current")
    arguments = parser.parse_args()
    text, tables = arguments.page.read_text(), page_blocks()
    if arguments.check:
        old = [
            name
            for name, body in blocks(text).items()
            if structure(body) != structure(tables[name])
        ]
        sys.exit(f"not current: {', '.join(old)}; run benchmarks/measured_tables.py" if old else 0)
    arguments.page.write_text(with_tables(text, tables))


if __name__ == "__main__":
    main()
