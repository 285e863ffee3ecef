"""The site: sphinx-build -W --keep-going -b html docs OUT. Nothing in its pages needs a network."""

import os
import re
import sys
from importlib.metadata import version as version_of
from importlib.util import find_spec
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parent))
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
nitpick_ignore_regex = [("py:.*", r".*")]  # annotations name types that are no part of the face
suppress_warnings = ["config.cache"]  # the order of the gallery is a function

myst_enable_extensions = ["dollarmath", "amsmath", "colon_fence"]
myst_heading_anchors = 3

# MathJax as one file, fonts included, from the package sphinx-mathjax-offline.
MATHJAX = Path(find_spec("sphinx-mathjax-offline").origin).parent / "static/mathjax/tex-svg.js"
mathjax_path = MATHJAX.name

html_theme = "pydata_sphinx_theme"
html_title = "vibro-fpk"
html_static_path = ["_static", str(MATHJAX)]
html_css_files = ["site.css"]
html_copy_source = html_show_sourcelink = False
html_theme_options = {
    "navbar_end": ["theme-switcher"],
    "secondary_sidebar_items": ["page-toc"],
    "show_prev_next": False,
    "footer_start": ["copyright"],
    "footer_end": [],
    "navigation_depth": 2,
    "header_links_before_dropdown": 8,
}
html_sidebars = {page: [] for page in ("index", "start", "tutorial", "choose", "faq")}

ORDER = [
    "density", "three_routes", "routes", "refusals", "contact_forces", "tails", "exact_scene",
    "linear_chain", "simulation", "phase_space", "rigid_stop", "many_masses", "modal_energies",
    "contact_law", "damping_terms", "convergence", "transient", "first_passage", "rare_failure",
    "crossings_spectrum", "export", "kept_answers",
]  # fmt: skip


def example_order(path: str) -> int:
    """Return the place of an example in the gallery: from simple to special."""
    stem = Path(path).stem
    return ORDER.index(stem) if stem in ORDER else len(ORDER)


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
    "copyfile_regex": r".*\.toml",
}

autodoc_typehints = "none"
autodoc_member_order = "bysource"
add_module_names = False
LITERAL = re.compile(r"(``.*?``)")


def escape(app, what, name, obj, options, lines):
    """Docstrings are plain text with ``code``: |x| and * have no other meaning in them."""
    for k, line in enumerate(lines):
        if not line.startswith("    "):
            parts = LITERAL.split(line)
            parts[::2] = [re.sub(r"([|*_](?!\w))|([|*](?=\w))", r"\\\g<0>", p) for p in parts[::2]]
            lines[k] = "".join(parts)


def setup(app):
    """Connect what reads docstrings."""
    app.connect("autodoc-process-docstring", escape)
