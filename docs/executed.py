"""Directives that run what a page shows: ``scene``, ``command`` and ``python``.

A ``scene`` writes its content to the file that it names and shows it; a ``command`` runs lines such
as ``fpk show oscillator.toml`` and shows what they print, ``:lines:`` the first so many of it; a
``python`` block runs in one namespace a page. All work in one folder that is removed at the end.
What fails, or ends with another ``:status:`` than was said, fails the build.
"""

import io
import os
import shlex
import sys
from contextlib import chdir, redirect_stderr, redirect_stdout
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import ClassVar

from docutils import nodes
from docutils.parsers.rst import Directive, directives

FOLDER = TemporaryDirectory(prefix="fpk-docs-")
NAMESPACES: dict[str, dict] = {}


def listing(text: str, language: str) -> nodes.literal_block:
    """Return a block of code."""
    return nodes.literal_block(text, text, language=language)


class SceneFile(Directive):
    """Write a file and show it."""

    has_content, required_arguments = True, 1

    def run(self):
        """Return the content, after the name of the file."""
        text = "\n".join(self.content)
        Path(FOLDER.name, self.arguments[0]).write_text(text + "\n", encoding="utf-8")
        return [nodes.caption("", "", nodes.literal("", self.arguments[0])), listing(text, "toml")]


class Command(Directive):
    """Run commands and show what they print."""

    has_content = True
    option_spec: ClassVar = {"lines": directives.positive_int, "status": directives.nonnegative_int}

    def run(self):
        """Return the commands and their output."""
        shown = []
        for line in self.content:
            printed, status = run_command(shlex.split(line))
            if status != self.options.get("status", 0):
                raise self.error(f"{line}: status {status}: {printed}")
            lines = printed.rstrip().split("\n")
            most = self.options.get("lines", len(lines))
            more = ["…"] if len(lines) > most else []
            shown += [f"$ {line}", *lines[:most], *more]
        return [listing("\n".join(shown), "console")]


def run_command(words: list[str]) -> tuple[str, int]:
    """Return what a command prints and its exit status."""
    from cases.command.cli import main  # noqa: PLC0415  (not needed by pages without commands)

    if words[0] != "fpk":
        return f"{words[0]}: only fpk is run here", 2
    printed, argv, columns = io.StringIO(), sys.argv, os.environ.get("COLUMNS")
    sys.argv, os.environ["COLUMNS"] = words, "100"
    try:
        with redirect_stdout(printed), redirect_stderr(printed), chdir(FOLDER.name):
            main()
    except SystemExit as end:
        return printed.getvalue(), int(end.code or 0)
    finally:
        sys.argv = argv
        os.environ.pop("COLUMNS")
        if columns is not None:
            os.environ["COLUMNS"] = columns
    return printed.getvalue(), 0


class Python(Directive):
    """Run Python and show it with what it prints."""

    has_content = True

    def run(self):
        """Return the source and its output."""
        source, printed = "\n".join(self.content), io.StringIO()
        page = self.state.document.settings.env.docname
        space = NAMESPACES.setdefault(page, {"__name__": "__main__"})
        try:
            with redirect_stdout(printed), chdir(FOLDER.name):
                exec(compile(source, f"<{page}>", "exec"), space)
        except Exception as error:
            raise self.error(f"{type(error).__name__}: {error}") from error
        output = printed.getvalue().rstrip()
        return [listing(source, "python"), *([listing(output, "none")] if output else [])]


def setup(app):
    """Register the directives."""
    for name, directive in (("scene", SceneFile), ("command", Command), ("python", Python)):
        app.add_directive(name, directive)
    return {"parallel_read_safe": False}
