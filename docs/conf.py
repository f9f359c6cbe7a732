"""Sphinx: `make docs` writes the pages into docs/site, `make site` all of the site."""

import os
import re
import shutil
from pathlib import Path
from typing import Any

from sphinx.application import Sphinx

from ccdiff_env.system.fields import Documented

Documented.listed = False  # autodoc shows fields by itself

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
# notebooks run only for the site: one of them trains for minutes
nb_execution_mode = os.environ.get("NOTEBOOKS", "off")
nb_execution_timeout = 600
nb_execution_raise_on_error = True
html_theme = "furo"
html_title = f"ccdiff-env {version}"
html_copy_source = False
html_static_path = ["_static"]
html_favicon = html_logo = "_static/logo.svg"
# the pictures of the front page and of previews
html_extra_path = ["hero.gif", "saved.png"]
html_css_files = ["site.css"]
html_js_files = [("copy.js", {"defer": "defer"})]
# blocks without a language are commands
highlight_language = "bash"
# where the site will stand, for the pictures of previews
html_baseurl = os.environ.get("SITE_URL", "").removesuffix("/")
# headings can be linked by their text, as on GitHub
myst_heading_anchors = 4
myst_enable_extensions = ["dollarmath"]
# fields of data classes are described where they are declared
autodoc_default_options = {"members": True, "show-inheritance": True, "member-order": "bysource"}
autodoc_class_signature = "separated"
autodoc_typehints = "signature"
autodoc_typehints_format = "short"
autodoc_preserve_defaults = True
napoleon_numpy_docstring = False
napoleon_use_rtype = False
napoleon_use_ivar = True
napoleon_attr_annotations = False


def _preview(
    app: Sphinx, name: str, template: str, context: dict[str, Any], doctree: object
) -> None:
    """Title and picture of a page where its address is passed on."""
    site = f"{html_baseurl}/" if html_baseurl else ""
    title = {"index": "ccdiff-env"}.get(name, f"ccdiff-env: {context.get('title', '')}")
    tags = {"title": title, "image": f"{site}hero.gif"}
    meta = "".join(f'<meta property="og:{key}" content="{text}">' for key, text in tags.items())
    context["metatags"] = context.get("metatags", "") + meta


def setup(app: Sphinx) -> None:
    """Add the tags of previews."""
    app.connect("html-page-context", _preview)
