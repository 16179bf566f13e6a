"""How Sphinx makes the site from the sources that ``docs/site`` lays out; see ``docs/site/__main__.py``."""

import shutil
import sys
from importlib.metadata import files
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
sys.path.insert(0, str(ROOT))

import warp_bounding as wb  # noqa: E402

COLON = "\ue000"  # stands for a colon while Napoleon reads

project = "warp-bounding"
version = release = wb.__version__
root_doc = "index"
language = "en"
extensions = [
    "myst_nb",
    "sphinx.ext.autodoc",
    "sphinx.ext.napoleon",
    "sphinx.ext.mathjax",
    "sphinx_copybutton",
    "sphinx_design",
]
exclude_patterns = ["**/*.ipynb_checkpoints"]

# Pages: Markdown as GitHub reads it, too.
myst_enable_extensions = ["colon_fence", "dollarmath"]
myst_fence_as_directive = ["math"]
myst_heading_anchors = 4
myst_links_external_new_tab = False
suppress_warnings = ["myst.header", "misc.highlighting_failure"]

# Notebooks are shown as they were committed.
nb_execution_mode = "off"
nb_merge_streams = True

# Docstrings.
add_module_names = False
autodoc_member_order = "bysource"
autodoc_typehints = "signature"
python_use_unqualified_type_names = True
napoleon_google_docstring = True
napoleon_numpy_docstring = False
napoleon_use_ivar = True
maximum_signature_line_length = 100

# Every reference must lead somewhere; those to the libraries that signatures name, and to what is not public, have no
# page here.
nitpicky = True
nitpick_ignore_regex = [
    ("py:.*", r"(numpy|np|warp|wp|newton|trimesh|torch|collections|os|pathlib|typing|types)\..*"),
    ("py:.*", r"warp_bounding\.\w+\..*"),
    ("py:.*", r"(array|ndim=\d|dtype=\w+|dict\[str)"),  # of wp.array(ndim=1, dtype=...)
]

# Formulae: MathJax, one file, from a package; it asks the web for nothing.
mathjax_path = "mathjax/tex-svg.js"
mathjax3_config = {"options": {"enableMenu": False}}

html_theme = "furo"
html_title = "warp-bounding"
html_static_path = [str(Path(__file__).with_name("_static"))]
html_css_files = ["site.css"]
html_favicon = str(Path(__file__).with_name("_static") / "favicon.svg")
html_copy_source = False
html_show_sourcelink = False
html_show_copyright = False
html_last_updated_fmt = None
html_theme_options = {"top_of_page_buttons": []}
copybutton_exclude = ".linenos, .gp, .go"
copybutton_prompt_text = r">>> |\.\.\. "
copybutton_prompt_is_regexp = True


def take_mathjax(app) -> None:
    """Put MathJax beside the other static files of the built site."""
    for file in files("sphinx-mathjax-offline") or ():
        if file.parts[-1] == "tex-svg.js":
            to = Path(app.outdir) / "_static" / mathjax_path
            to.parent.mkdir(parents=True, exist_ok=True)
            shutil.copyfile(file.locate(), to)
            return
    raise FileNotFoundError("expected tex-svg.js in the package sphinx-mathjax-offline: pip install '.[docs]'")


def take_plotly(app) -> None:
    """Write plotly.js into the folder of ``bunny.html``, a page of ``show`` that loads it."""
    from plotly.offline import get_plotlyjs

    to = Path(app.outdir) / "_static" / "plotly.min.js"
    to.parent.mkdir(parents=True, exist_ok=True)
    to.write_text(get_plotlyjs(), encoding="utf-8")


def public_reference(app, env, node, contnode):
    """What a signature names by the module that it is defined in leads to its public name's entry."""
    domain, target = env.get_domain("py"), node.get("reftarget", "")
    name = target.rpartition(".")[2]
    if not target.startswith("warp_bounding."):
        return None
    for public in (f"warp_bounding.{name}", f"warp_bounding.arms.{name}", f"warp_bounding.shapes.{name}"):
        if public in domain.objects and public != target:
            kind = node["reftype"]
            return domain.resolve_xref(env, node["refdoc"], app.builder, kind, public, node, contnode)
    return None


def keep_colons(app, what, name, obj, options, lines) -> None:
    """Napoleon takes what stands before a colon in a property's first line for its type; ours are sentences."""
    if what in ("attribute", "data", "property") and lines:
        lines[0] = lines[0].replace(":", COLON)


def give_colons_back(app, what, name, obj, options, lines) -> None:
    """Undo ``keep_colons`` once Napoleon has read the docstring."""
    lines[:] = [line.replace(COLON, ":") for line in lines]


def setup(app) -> None:
    """Connect what is not an option."""
    app.connect("builder-inited", take_mathjax)
    app.connect("builder-inited", take_plotly)
    app.connect("missing-reference", public_reference)
    app.connect("autodoc-process-docstring", keep_colons, priority=400)  # Napoleon's own is 500
    app.connect("autodoc-process-docstring", give_colons_back, priority=600)
