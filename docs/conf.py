"""How the documentation is built: `make docs`."""

from __future__ import annotations

import hashlib
import sys
from pathlib import Path

from docutils import nodes
from jupyter_client.manager import KernelManager
from sphinx import addnodes
from sphinx.application import Sphinx

ROOT = Path(__file__).parent.parent
sys.path.insert(0, str(ROOT))
# Notebooks run on this machine; without this each would warn that what it says to its kernel is not encrypted.
KernelManager.transport_encryption.default_value = "auto"


def _sources() -> str:
    """Give a fingerprint of what notebooks use beside their own text: they run again when any of it has changed."""
    found = hashlib.sha256()
    for folder in ("planner", "assist", "domains", "docs/examples"):
        for file in sorted(file for file in (ROOT / folder).rglob("*") if file.suffix in (".py", ".pddl", ".toml")):
            found.update(str(file.relative_to(ROOT)).encode() + file.read_bytes())
    return found.hexdigest()[:16]


project = "kitassist"
html_title = "kitassist"
html_theme = "furo"
html_static_path = ["_static"]
html_css_files = ["site.css"]
html_show_copyright = False
extensions = ["myst_nb", "sphinx.ext.autodoc", "numpydoc", "sphinx.ext.viewcode"]
exclude_patterns = ["examples"]
myst_enable_extensions = ["dollarmath"]
myst_heading_anchors = 4
nb_execution_mode = "cache"
nb_execution_cache_path = str(ROOT / "site" / ".notebooks" / _sources())
nb_execution_raise_on_error = True
nb_execution_timeout = 300  # seconds for a cell
nb_merge_streams = True
autodoc_member_order = "bysource"
autodoc_typehints = "none"  # the docstrings say it
numpydoc_show_class_members = False
numpydoc_class_members_toctree = False


def _anchors(_: object, document: nodes.document) -> None:
    """Give what `assist` has the anchor of its shortest name as well, to which pages of sources link."""
    given = set()
    for signature in document.findall(addnodes.desc_signature):
        name = f"assist.{signature.get('fullname')}"
        if str(signature.get("module")).startswith("assist") and name not in given:
            signature["ids"].append(name)
            given.add(name)


def setup(app: Sphinx) -> None:
    """Add to Sphinx what is done here."""
    app.connect("doctree-read", _anchors)
