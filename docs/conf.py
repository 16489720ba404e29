"""The site: ``python -m sphinx -W --keep-going -b html docs docs/_build/html``.

The gallery runs the examples; ``-D plot_gallery=0`` leaves that out. Nothing is fetched, neither
now nor by a reader.
"""

import os
import re
import sys
from pathlib import Path
from types import ModuleType
from typing import Any

from sphinx.application import Sphinx

HERE = Path(__file__).resolve().parent
sys.path[:0] = [str(HERE / "_ext"), str(HERE.parent)]
os.environ.setdefault("MPLBACKEND", "Agg")
os.environ.setdefault("PYVISTA_BUILDING_GALLERY", "true")
os.environ.setdefault("PYVISTA_OFF_SCREEN", "true")

import tissue  # noqa: E402, the checkout's

# modules by their public names, as `tissue.stability`, which only exist as attributes
for name in tissue.__all__:
    if isinstance(module := getattr(tissue, name), ModuleType):
        sys.modules.setdefault(f"tissue.{name}", module)

project, author = "tissue", "The tissue-sim authors"
copyright = author
release = version = tissue.__version__

extensions = [
    "myst_parser",
    "numpydoc",
    "sphinx.ext.autodoc",
    "sphinx.ext.autosummary",
    "sphinx.ext.viewcode",
    "sphinx_copybutton",
    "sphinx_design",
    "sphinx_gallery.gen_gallery",
    "gallery_sources",
    "package_tables",
    "scene_keys",
]
exclude_patterns = [
    "README.md",
    "_build",
    "_gallery_header.rst",
    "gallery/**/*.md5",
    "gallery/**/*.ipynb",
]
templates_path = ["_templates"]
suppress_warnings = ["config.cache"]  # the gallery's order is a class, which no cache holds

# Pages are Markdown, as the code host shows them too.
myst_enable_extensions = ["colon_fence", "deflist"]
myst_heading_anchors = 3
highlight_language = "bash"  # of code without a language: commands
# a name in single backticks links where it is documented, and is code where it is not
default_role = "py:obj"

autosummary_generate = True
autodoc_typehints_format = "short"
autodoc_member_order = "bysource"
python_use_unqualified_type_names = True
maximum_signature_line_length = 96
numpydoc_show_class_members = False
nitpicky = True
nitpick_ignore_regex = [("py:.*", r".*")]

sphinx_gallery_conf = {
    "examples_dirs": [str(HERE.parent / "build" / "gallery")],
    "gallery_dirs": ["gallery"],
    "filename_pattern": r"/\d\d_",
    "ignore_pattern": r"__init__\.py",
    "within_subsection_order": "FileNameSortKey",
    "default_thumb_file": str(HERE / "_static" / "thumb.png"),
    "image_scrapers": ("matplotlib", "pyvista"),
    "abort_on_example_error": False,
    "only_warn_on_example_error": False,
    "remove_config_comments": True,
    "show_memory": False,
    "show_signature": False,
    "download_all_examples": False,
    "write_computation_times": False,  # its page loads scripts from elsewhere
}

html_theme = "pydata_sphinx_theme"
html_title = "tissue"
html_logo = html_favicon = "_static/logo.svg"
html_static_path = ["_static"]
html_css_files = ["site.css"]
html_context = {"default_mode": "auto"}
html_copy_source = False
html_show_sourcelink = False
html_sidebars = {page: [] for page in ("index", "scene_keys", "project")}
html_theme_options = {
    "logo": {"text": "tissue"},
    "navbar_align": "left",
    "navbar_end": ["theme-switcher"],
    "show_toc_level": 2,
    "show_nav_level": 1,
    "navigation_with_keys": False,
    "footer_start": ["copyright"],
    "footer_end": ["theme-version"],
    "pygments_light_style": "a11y-high-contrast-light",
    "pygments_dark_style": "a11y-high-contrast-dark",
}
copybutton_prompt_text = r">>> |\.\.\. |\$ "
copybutton_prompt_is_regexp = True


def without_back_links(
    app: Sphinx, page: str, template: str, context: dict[str, Any], tree: object
) -> None:
    """Take the links from source to reference out: viewcode takes one module's names for all to
    be of one home.
    """
    if page.startswith("_modules/") and "body" in context:
        context["body"] = re.sub(r'<a class="viewcode-back"[^>]*>\[docs\]</a>', "", context["body"])


def setup(app: Sphinx) -> None:
    app.connect("html-page-context", without_back_links)
