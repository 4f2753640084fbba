"""Sphinx' settings for the reference of the library."""

from __future__ import annotations

import turbseg_ros

project = "turbseg_ros"
version = release = turbseg_ros.__version__
author = "turbseg_ros maintainers"
extensions = ["sphinx.ext.autodoc"]
autodoc_member_order = "bysource"
autodoc_typehints = "description"
# As the docstrings write it: a name between backticks is code.
default_role = "code"
html_theme = "alabaster"
html_theme_options = {
    "description": "What really moves, through turbulence",
    "fixed_sidebar": True,
}
