"""The site: sphinx-build -W --keep-going -b html docs OUT. Nothing in its pages needs a network."""

import os
import re
import sys
from importlib.metadata import version as version_of
from importlib.util import find_spec
from pathlib import Path

from sphinx.util import logging

from cases.command.examples import EXAMPLES

sys.path.insert(0, str(Path(__file__).parent))
from links import links_of, with_equations

logger = logging.getLogger(__name__)
os.environ.setdefault("MPLBACKEND", "Agg")
for library in ("OPENBLAS", "MKL", "OMP"):
    os.environ.setdefault(f"{library}_NUM_THREADS", "1")

project, author = "vibro-fpk", "The vibro-fpk authors"
project_copyright = "The vibro-fpk authors, MIT licence"
release = version = version_of("vibro-fpk")

extensions = [
    "executed",
    "myst_parser",
    "sphinx.ext.autodoc",
    "sphinx.ext.mathjax",
    "sphinx_click",
    "sphinx_gallery.gen_gallery",
]
nitpicky = True
suppress_warnings = ["config.cache"]  # the order of the gallery is a function

myst_enable_extensions = ["dollarmath", "amsmath", "colon_fence"]
myst_heading_anchors = 3

# MathJax as one file, fonts included, from the package sphinx-mathjax-offline.
MATHJAX = Path(find_spec("sphinx-mathjax-offline").origin).parent / "static/mathjax/tex-svg.js"
mathjax_path = MATHJAX.name

html_theme = "pydata_sphinx_theme"
exclude_patterns = ["gallery/backreferences"]
html_title = "vibro-fpk"
html_static_path = ["_static", str(MATHJAX)]
html_css_files = ["site.css"]
html_copy_source = html_show_sourcelink = False
MEASURED = [f"benchmarks/{path.stem}" for path in Path(__file__).parent.glob("benchmarks/*.md")]
"""Pages of wide tables, which need the room of a second sidebar."""
html_theme_options = {
    "navbar_persistent": ["search-button"],
    "navbar_end": ["theme-switcher"],
    "secondary_sidebar_items": {"**": ["page-toc"]} | {page: [] for page in MEASURED},
    "show_prev_next": False,
    "footer_start": ["copyright"],
    "footer_end": [],
    "navigation_depth": 2,
    "header_links_before_dropdown": 8,
}
html_sidebars = {
    page: []
    for page in (
        "index",
        "start",
        "tutorial",
        "acceleration",
        "choose",
        "faq",
        "extend",
    )
}

ORDER = [
    "density", "three_routes", "summary", "routes", "refusals", "contact_forces", "tails",
    "exact_scene", "linear_chain", "simulation", "phase_space", "rigid_stop", "many_masses",
    "modal_energies", "contact_law", "damping_terms", "convergence", "transient", "first_passage",
    "rare_failure", "crossings_spectrum", "sweep", "export", "reference_values", "kept_answers",
]  # fmt: skip


def example_order(path: str) -> int:
    """Return the place of an example in the gallery: from simple to special."""
    return ORDER.index(Path(path).stem)


ROOMS = ("fpk", "averaging", "sim", "cases")
sphinx_gallery_conf = {
    "examples_dirs": "../examples",
    "gallery_dirs": "gallery",
    "filename_pattern": r"\.py",
    "within_subsection_order": "conf.example_order",
    "download_all_examples": False,
    "remove_config_comments": True,
    "show_memory": False,
    "min_reported_time": 1,
    "plot_gallery": "True",
    "matplotlib_animations": False,
    "show_signature": False,
    "run_stale_examples": True,  # the program may have changed, if they have not
    "capture_repr": (),
    "write_computation_times": False,
    "backreferences_dir": "gallery/backreferences",
    "doc_module": ROOMS,
    "default_thumb_file": str(Path(__file__).parent / "_static/text.svg"),
}

autodoc_typehints = "none"
autodoc_member_order = "bysource"
add_module_names = False
LITERAL = re.compile(r"(``.*?``)")


def as_written(text: str) -> str:
    """Return plain text as reStructuredText: |x| and * mean nothing, equations are links."""
    return with_equations(re.sub(r"([|*_](?!\w))|([|*](?=\w))", r"\\\g<0>", text))


def docstring(app, what, name, obj, options, lines):
    """Docstrings are plain text with ``code``; links to theory and gallery follow.

    A name of the reference that lacks them is a warning, which fails the build.
    """
    text = "\n".join(lines)
    for k, line in enumerate(lines):
        if not line.startswith("    "):
            parts = LITERAL.split(line)
            parts[::2] = [as_written(part) for part in parts[::2]]
            lines[k] = "".join(parts)
    if name.partition(".")[0] in ROOMS:
        links, missing = links_of(what, name, obj, text, Path(app.srcdir))
        lines += ["", links, ""] if links else []
        if missing:
            logger.warning("%s has %s", name, missing)


def examples(app, context, lines):
    """Show the examples of a command as code, with quotes and dashes that can be copied."""
    own = EXAMPLES.get(context.command.name, ())
    if lines and own:
        lines[:] = ["Examples::", "", *(f"    {line}" for line in own), ""]


def setup(app):
    """Connect what reads docstrings and examples."""
    app.connect("sphinx-click-process-epilog", examples)
    app.connect("autodoc-process-docstring", docstring)
