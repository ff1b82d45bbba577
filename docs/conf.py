"""The documentation as a site that needs no network: `make docs`."""

project = "Tutti"
copyright = "the Tutti authors"
extensions = ["myst_parser"]
html_theme = "furo"
html_title = "Tutti"
exclude_patterns = ["build"]
myst_heading_anchors = 3
# Links to the project's own files outside of docs/ stay as text on the site.
suppress_warnings = ["myst.xref_missing"]
nitpicky = False
pygments_style = "default"
