"""Configuration of the documentation: `sphinx-build -W --keep-going -j 8 docs docs/_build/html`."""

import hashlib
import os
import re
import shutil
import sys
import tempfile
from collections.abc import Callable
from importlib.util import find_spec
from pathlib import Path
from typing import Any
from uuid import uuid4

import matplotlib.font_manager  # noqa: F401 - makes its cache, so that no notebook tells about it
from docutils.nodes import Text
from jupyter_cache import get_cache
from jupyter_client.manager import KernelManager
from nbclient import NotebookClient

import slipfree
from slipfree import load_problem, run_problem
from slipfree.problem.load import verb_of
from slipfree.show import viewer
from slipfree.show.scene import drive_scene
from slipfree.system.forks import single_thread

DOCS = Path(__file__).parent
sys.path.insert(0, str(DOCS))

from made import fill  # noqa: E402

single_thread()  # notebooks are executed side by side

NOTEBOOKS, INTERACTIVE = DOCS / "notebooks", DOCS / "interactive"
SHIPPED = find_spec("sphinx-mathjax-offline")  # a package of MathJax's files
if SHIPPED is None or SHIPPED.origin is None:
    raise ImportError("pages need MathJax without network: python -m pip install '.[docs]'")


def _sources_digest() -> str:
    """Return a name for the state of the package, on which the outputs of cells depend."""
    digest = hashlib.sha256()
    for path in sorted(Path(slipfree.__file__).parent.rglob("*.py")):
        digest.update(path.read_bytes())
    return digest.hexdigest()[:16]


project = "slipfree"
author = copyright = "The slipfree developers"
version = release = slipfree.__version__

extensions = ["myst_nb", "numpydoc", "sphinx.ext.autodoc", "sphinx.ext.mathjax"]
exclude_patterns = ["_build", "*.py"]  # notebooks lie in a folder

html_theme = "furo"
html_title = f"slipfree {release}"
html_static_path = [str(Path(SHIPPED.origin).parent / "static/mathjax/tex-svg.js"), "wrap.css"]
html_extra_path = ["interactive"]
html_css_files = ["wrap.css"]  # long lines of code blocks, such as printed tables
html_copy_source = html_show_sourcelink = False
mathjax_path = "tex-svg.js"
mathjax3_config = {"options": {"enableMenu": False}}  # the menu would load more files

myst_enable_extensions = ["amsmath", "deflist", "dollarmath"]
myst_heading_anchors = 3

nb_custom_formats = {".py": ["jupytext.reads", {"fmt": "py:percent"}]}
nb_execution_mode = "cache"  # where code cells and the package are as before
nb_execution_cache_path = str(DOCS / "_build" / ".jupyter_cache" / _sources_digest())
get_cache(
    nb_execution_cache_path
).get_cache_limit()  # makes its database before readers in parallel
nb_execution_in_temp = True
nb_execution_raise_on_error = True
nb_execution_timeout = 300
nb_merge_streams = True
nb_output_stderr = "warn"
os.environ["PATH"] = os.pathsep.join([str(Path(sys.executable).parent), os.environ["PATH"]])

add_module_names = False
autodoc_member_order = "bysource"
autodoc_typehints = "none"
numpydoc_show_class_members = False


def _through_files(make: Callable[..., KernelManager]) -> Callable[..., KernelManager]:
    """Have kernels talk through files: a free port may be taken before a kernel opens it."""

    def made(client: NotebookClient) -> KernelManager:
        manager = make(client)
        manager.transport, manager.ip = "ipc", str(Path(tempfile.gettempdir()) / uuid4().hex)
        return manager

    return made


NotebookClient.create_kernel_manager = _through_files(NotebookClient.create_kernel_manager)


def _copy_notebooks(*_: Any) -> None:
    """Copy the notebooks to where pages are looked for; those that are up to date stay."""
    for source in (DOCS.parent / "notebooks").glob("*.py"):
        target = NOTEBOOKS / source.name
        if not target.exists() or target.read_bytes() != source.read_bytes():
            shutil.copyfile(source, target)


def _save_motion(*_: Any) -> None:
    """Save the page of a motion for the first page, unless it is up to date."""
    page = INTERACTIVE / "motion.html"
    state = f"<!-- {_sources_digest()} -->"
    if page.exists() and page.read_text(encoding="utf-8").endswith(state):
        return
    result = run_problem(load_problem(DOCS.parent / "problems" / "moon_craters.toml"))
    scene = drive_scene([verb_of(result.problem).shown(result, "rocky7")])
    html = viewer.page(scene, "Rocky 7 over small craters on the moon", "height")
    INTERACTIVE.mkdir(exist_ok=True)
    page.write_text(html + state, encoding="utf-8")


def _fill(app: Any, _page: str, source: list[str]) -> None:
    """Generate the parts of a page that come from the package and from lists of other pages."""
    text = fill(source[0])
    if text != source[0]:
        for page in (DOCS / "made.py", *(DOCS / "reference").glob("*.md")):
            app.env.note_dependency(page)
    source[0] = text


def _leave_out(_app: Any, _what: str, _name: str, obj: Any, _skip: bool, _options: Any) -> Any:
    """Return True for fields of tuples, which their record describes, and what is imported."""
    foreign = isinstance(obj, type) and not str(obj.__module__).startswith("slipfree")
    return True if foreign or type(obj).__name__ == "_tuplegetter" else None


def _tame(_app: Any, what: str, _name: str, _obj: Any, _opt: Any, lines: list[str]) -> None:
    """Turn headings in the text of a module into rubrics, which may stand anywhere."""
    for k, line in enumerate(lines):
        if what == "module" and k and re.fullmatch("-{3,}", line):
            lines[k - 1 : k + 1] = [f".. rubric:: {lines[k - 1]}", ""]


def _renumber(_app: Any, page: Any, _name: str) -> None:
    """Call references by the number that their docstring gives them, not by numpydoc's key."""
    for text in list(page.findall(Text)):
        if number := re.fullmatch(r"\[R[0-9a-f]{12}-(\w+)\]", text):
            text.parent.replace(text, Text(f"[{number[1]}]"))


def setup(app: Any) -> None:
    """Register what is done before pages are read."""
    app.connect("config-inited", _copy_notebooks)
    app.connect("config-inited", _save_motion)
    app.connect("source-read", _fill)
    app.connect("autodoc-skip-member", _leave_out)
    app.connect("autodoc-process-docstring", _tame, priority=0)
    app.connect("doctree-resolved", _renumber)
