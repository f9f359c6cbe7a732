"""Sphinx: `make docs` writes the site into docs/site."""

import re
import shutil
from pathlib import Path

project = "ccdiff-env"
author = copyright = "the ccdiff-env authors"
version = release = re.search(
    r'^version = "(.+)"$', Path(__file__).parents[1].joinpath("Cargo.toml").read_text(), re.M
)[1]
extensions = ["myst_nb", "sphinx.ext.autodoc", "sphinx.ext.napoleon", "sphinx.ext.viewcode"]
exclude_patterns = ["site", "jupyter_execute"]
# the notebooks of the examples, run while the site is built
shutil.copytree(
    Path(__file__).parents[1] / "examples" / "notebooks",
    Path(__file__).parent / "notebooks",
    dirs_exist_ok=True,
)
nb_execution_timeout = 600
nb_execution_raise_on_error = True
html_theme = "furo"
html_title = f"ccdiff-env {version}"
html_copy_source = False
# headings can be linked by their text, as on GitHub
myst_heading_anchors = 4
myst_enable_extensions = ["dollarmath"]
# fields of data classes are described where they are declared
autodoc_default_options = {"members": True, "show-inheritance": True, "member-order": "bysource"}
autodoc_class_signature = "separated"
autodoc_typehints = "signature"
autodoc_typehints_format = "short"
autodoc_preserve_defaults = True
napoleon_google_docstring = False
napoleon_use_rtype = False
napoleon_use_ivar = True
napoleon_attr_annotations = False
