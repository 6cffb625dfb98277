"""The documentation site: ``make docs`` builds it into docs/_build/html."""

import inspect
import re
import subprocess
import sys
from importlib import import_module
from importlib.metadata import version as installed
from pathlib import Path
from typing import Any

from docutils import nodes
from docutils.statemachine import StringList
from docutils.utils.math.latex2mathml import tex2mathml
from sphinx.application import Sphinx
from sphinx.util import logging
from sphinx.util.docutils import SphinxDirective
from sphinx.writers.html5 import HTML5Translator

HERE = Path(__file__).parent
SOURCE = "https://github.com/vessel-gym/vessel-gym"
EPISODE = HERE / "_static" / "episode.html"
TYPICAL_EPISODE = """
import sys
from agents import episode

estimators = "kf-umv-ui", "truth", "ekf", "dead-reckoning"
rough = {"disturbance": "rough"}
episode("SigmaCorvette-v0", estimators, seed=None, env_options=rough).save(sys.argv[1])
"""
UNBROKEN = re.compile(  # spaces at which no line ends
    r" ± |(?<=\d) (?=%|(?:s|m|km|kn|kg|t|rad|deg|hPa|Hz|m/s|rad/s)\b)"
    r"|\b(?:(?:eqs?|Figs?|secs?)\.|Table|line|row) (?=\d)"
)
SHORT = 24
"""Largest length of code in a sentence that stays on one line."""
SPACED = re.compile(
    r"(?<=[\w)\]}])\s*(?=\\(?:sin|cos|tan)\b)"
    r"|(?<=\\(?:sin|cos|tan))\s*(?=[A-Za-z]|\\[a-z]*(?:eta|pha|phi|psi|mma)\b)"
)
NUMBER = re.compile(r"(?=.*\d)(?!.*[^\W\d_]{3}).{1,32}")  # a cell with a digit and without a word
sys.path.insert(0, str(HERE.parent))

project = "vessel-gym"
author = "The vessel-gym authors"
project_copyright = author
version = release = installed("vessel-gym")
language = "en"

extensions = [
    "myst_nb",
    "sphinx.ext.autodoc",
    "sphinx.ext.autosummary",
    "sphinx.ext.napoleon",
    "sphinx_copybutton",
    "sphinx_design",
    "sphinx_gallery.gen_gallery",
]
exclude_patterns = ["_build", "notebooks", "gallery/README.rst", "gallery/*.py", "examples/*.ipynb"]
source_suffix = {
    ".rst": "restructuredtext",
    ".md": "myst-nb",
}  # the first is what the API is written in
templates_path = ["_templates"]

# Pages are Markdown, which code hosts show as it stands; those with a kernel are executed at every
# build.
myst_enable_extensions = ["colon_fence", "deflist", "dollarmath"]
myst_heading_anchors = 4
nb_execution_mode = "cache"
nb_execution_cache_path = str(HERE / "_build" / "executed")
nb_execution_in_temp = True  # docs/estimators is not the package of that name
nb_execution_timeout = 300
nb_execution_raise_on_error = True
nb_merge_streams = True
nb_render_markdown_format = "myst"

# API: docstrings in Google's style, in which `one` backtick means code.
default_role = "code"
autosummary_generate = True
autosummary_ignore_module_all = False
autosummary_imported_members = True
autodoc_typehints = "none"
autodoc_member_order = "bysource"
autodoc_default_options = {"members": True, "show-inheritance": True}
napoleon_google_docstring = True
napoleon_numpy_docstring = False
napoleon_use_rtype = False
napoleon_use_ivar = True
add_module_names = False
highlight_language = "none"  # of a literal block in a docstring: most are formulas
nitpick_ignore_regex = [
    ("py:.*", ".*")
]  # types of other packages; pages, anchors and labels are checked

sphinx_gallery_conf = {
    "examples_dirs": "gallery",
    "gallery_dirs": "examples",
    "filename_pattern": r"plot_",
    "within_subsection_order": "FileNameSortKey",
    "show_memory": False,
    "show_signature": False,
    "min_reported_time": 1e9,
    "write_computation_times": False,
    "download_all_examples": False,
}

html_math_renderer = "mathml"
html_theme = "pydata_sphinx_theme"
html_title = f"vessel-gym {version}"
html_static_path = ["_static"]
html_css_files = ["site.css"]
html_show_sourcelink = False
html_theme_options = {
    "logo": {"text": "vessel-gym"},
    "header_links_before_dropdown": 7,
    "navbar_align": "left",
    "navbar_persistent": ["search-button"],
    "navbar_end": ["version-switcher", "theme-switcher", "navbar-icon-links"],
    "github_url": SOURCE,
    "switcher": {"json_url": "_static/switcher.json", "version_match": version},
    "show_nav_level": 1,
    "show_toc_level": 2,
    "show_prev_next": True,
    "footer_start": ["copyright"],
    "footer_end": ["theme-version"],
    "secondary_sidebar_items": [],  # the right margin belongs to wide tables
    "pygments_light_style": "a11y-high-contrast-light",
    "pygments_dark_style": "a11y-high-contrast-dark",
}
html_sidebars = {
    "**": ["sidebar-nav-bs", "page-toc"],
    "index": ["sections"],
    "genindex": ["sections"],
    "py-modindex": ["sections"],
    "search": ["sections"],
}
linkcheck_anchors = False


class Manual(SphinxDirective):
    """``{manual} module.Environment``: an environment's docstring, which is Markdown, as a part of the page."""

    required_arguments = 1

    def run(self) -> list[nodes.Node]:
        """Name the docstring, and parse it one level below the page's own headings."""
        manual = re.sub("^## ", "### ", _docstring(self.arguments[0]), flags=re.M)
        return _parsed(self, f"The docstring of `{self.arguments[0]}`:\n\n{manual}")


class Computed(SphinxDirective):
    """``{computed} module.function``: the Markdown that a function returns, as a part of the page."""

    required_arguments = 1

    def run(self) -> list[nodes.Node]:
        """Call it and parse what it returns."""
        module, _, name = self.arguments[0].rpartition(".")
        return _parsed(self, getattr(import_module(module), name)())


class Episode(SphinxDirective):
    """``{episode}``: an episode to touch, where one was written to _static/episode.html; else the picture of one."""

    def run(self) -> list[nodes.Node]:
        """A frame, or the picture."""
        if EPISODE.exists():
            title = "An episode: the truth, what two filters believe, measurements as they come"
            return [
                nodes.raw(
                    "",
                    f'<iframe class="episode" src="_static/episode.html" title="{title}"></iframe>',
                    format="html",
                )
            ]
        text = "A corvette in its turning circle: true and estimated ship, track, heading, rudder, unknown input"
        return [nodes.image("", uri="images/turning-circle.png", alt=text)]


def _parsed(directive: SphinxDirective, markdown: str) -> list[nodes.Node]:
    section = nodes.section()
    lines = StringList(markdown.splitlines(), source=directive.arguments[0])
    directive.state.nested_parse(lines, directive.content_offset, section, True)
    return section.children


def _docstring(path: str) -> str:
    """All but its first line; ``::`` before an indented block is a fenced one."""
    module, _, name = path.rpartition(".")
    text = inspect.getdoc(getattr(import_module(module), name)) or ""
    text = text.partition("\n")[2].replace("::\n", ":\n")
    return re.sub(r"`?\bdocs/([\w/-]+\.md)`?", r"[](/\1)", text)


def setup(app: Sphinx) -> None:
    """Add what is ours."""
    app.add_directive("manual", Manual)
    app.add_directive("computed", Computed)
    app.add_directive("episode", Episode)
    app.add_html_math_renderer("mathml", (_write_mathml, None), (_write_mathml, None))
    app.connect("config-inited", _fly_the_episode)  # before the gallery: compiles what that shows
    app.connect("doctree-read", _keep_numbers_on_one_line)
    app.connect("doctree-read", _link_errata)
    app.connect("source-read", lambda app, page, text: _linked(text, (HERE / page).parent))
    app.connect("include-read", lambda app, path, page, text: _linked(text, (HERE / path).parent))
    app.connect(
        "autodoc-process-docstring", _docstrings_as_they_are_written, 400
    )  # before napoleon's


def _fly_the_episode(app: Sphinx, config: object) -> None:
    """Write the front page's episode, at the typical one of 40 seeds; without one the page shows a picture."""
    if not EPISODE.exists():
        done = subprocess.run(
            [sys.executable, "-c", TYPICAL_EPISODE, str(EPISODE)],
            cwd=HERE.parent,
            capture_output=True,
            text=True,
        )
        if done.returncode:
            logging.getLogger(__name__).info("no episode: %s", done.stderr.strip())


def _write_mathml(writer: HTML5Translator, node: nodes.math | nodes.math_block) -> None:
    """Write a formula as MathML, which browsers render without scripts, fonts or a network."""
    block = isinstance(node, nodes.math_block)
    text = SPACED.sub(r"\\,", node.astext())  # TeX sets functions apart
    text = re.sub(r"\\(min|max)(?=\s*\()", r"\\operatorname{\1}", text)
    text = re.sub(r"(?:\\vert |\|)(\\?\w+)(?: \\vert|\|)", r"\\left|\1\\right|", text)
    formula = tex2mathml(text, as_block=block)
    if block:
        formula = f'<div class="math">{formula}</div>'
    elif mark := node.get("mark"):
        formula = f'<span class="formula">{formula}{mark}</span>'
    writer.body.append(formula)
    raise nodes.SkipNode


def _keep_numbers_on_one_line(app: Sphinx, doctree: nodes.document) -> None:
    """Mark wide tables, cells of numbers and of long text; bind numbers to ± and units, and a formula to its stop."""
    for group in doctree.findall(nodes.tgroup):
        if group["cols"] > 5:
            group.parent["classes"].append("wide")
    for cell in doctree.findall(nodes.entry):
        if NUMBER.fullmatch(cell.astext().strip()):
            cell["classes"].append("number")
        elif len(cell.astext()) > 14:
            cell["classes"].append("text")
    for code in doctree.findall(nodes.literal):
        if len(code.astext()) <= SHORT:
            code["classes"].append("short")
    for formula in list(doctree.findall(nodes.math)):
        after = formula.next_node(descend=False, siblings=True)
        if isinstance(after, nodes.Text) and (mark := re.match(r"[.,;:)]+", after)):
            formula["mark"] = mark[0]
            after.parent.replace(after, nodes.Text(after[mark.end() :]))
    for text in list(doctree.findall(nodes.Text)):
        parent = text.parent
        exact = nodes.literal | nodes.literal_block | nodes.math | nodes.math_block
        code = isinstance(parent, exact) and "output" not in parent["classes"]
        bound = UNBROKEN.sub(lambda found: found[0].replace(" ", "\u00a0"), text)
        if bound != text and not code:
            parent.replace(text, nodes.Text(bound))
            parent.rawsource = (
                parent.astext()
            )  # of a literal block that differs nothing is highlighted


def _link_errata(app: Sphinx, doctree: nodes.document) -> None:
    """Give each misprint its number as an address, and its tests short links."""
    for table in (found for found in doctree.findall(nodes.table) if "errata" in found["classes"]):
        for row in table.findall(nodes.row):
            row["ids"].append(row[0].astext().lower())
        for code in list(table.findall(nodes.literal)):
            if found := re.fullmatch(r"(tests/[\w/]+\.py)::(test_\w+)", code.astext()):
                link = nodes.reference("", "test", refuri=f"{SOURCE}/blob/main/{found[1]}")
                link["reftitle"] = found[2]
                code.parent.replace(code, link)


def _linked(text: list[str], folder: Path) -> None:
    """Links that lead out of these pages, to files of the repository, lead to the code host."""

    def link(match: re.Match[str]) -> str:
        path = (folder / match[1]).resolve()
        if path.is_relative_to(HERE) or not path.is_relative_to(HERE.parent) or not path.exists():
            return match[0]
        return f"]({SOURCE}/blob/main/{path.relative_to(HERE.parent).as_posix()}"

    text[0] = re.sub(r"\]\(([^):#\s]+)(?=[)#])", link, text[0])


def _docstrings_as_they_are_written(
    app: Sphinx, what: str, name: str, obj: Any, options: object, lines: list[str]
) -> None:
    """Of an environment, which has a page, what stands above its headings; a colon in an attribute's is no type."""
    if what in ("attribute", "data", "property"):
        lines[:0] = ["..", ""]  # an empty comment, after which a colon marks no type
    first = next((i for i, line in enumerate(lines) if line.startswith("## ")), len(lines))
    if first < len(lines):
        page = re.sub("(?<=[a-z])(?=[A-Z])", "-", obj.system.name.partition("-")[0]).lower()
        lines[first:] = [f"Manual: docs/environments/{page}.md.", ""]
    lines[:] = [re.sub(r"`*\bdocs/([\w/-]+)\.md`*", r":doc:`/\1`", line) for line in lines]
