"""How Sphinx makes the site of these pages; ``docs/build.py`` calls it."""

project = "Ball and plate"
project_copyright = "the ball-and-plate twin's developers, Apache-2.0"
html_title = "Ball and plate"
extensions = [
    "myst_parser",
    "sphinx.ext.autodoc",
    "sphinx.ext.napoleon",
    "sphinx_click",
    "sphinx_copybutton",
]
copybutton_selector = ".highlight-sh pre, .highlight-toml pre, .highlight-python pre"
exclude_patterns = ["**/*.template.md", "changes"]
html_theme = "furo"
html_static_path = ["static"]
html_css_files = ["site.css"]
html_js_files = ["tables.js"]
html_copy_source = False
html_show_sourcelink = False
myst_heading_anchors = 4
myst_enable_extensions = ["dollarmath"]
autodoc_typehints = "description"
autodoc_member_order = "bysource"
highlight_language = "none"
