"""What Sphinx does not bring: contents from links, pages and runs of the repository, links to the API, a check.

The pages are plain Markdown whose links work on a forge, too. Here a command becomes what it makes.
"""

import os
import re
from html import unescape
from pathlib import Path
from urllib.parse import unquote

from docutils import nodes
from gallery import live, run
from sphinx.addnodes import pending_xref
from sphinx.util import logging
from sphinx.util.nodes import make_refnode

DOCS = Path(__file__).parent
OWNERS = {"sol": "Solution.", "mech": "Mechanism.", "act": "Actuation.", "sim": "Simulation."}
STUB = re.compile(r"# .*\s+.*\]\((\.\./[\w/]+\.md)\).*\s*")  # a page that only points to one outside of docs/
FOUND = {path.stem: STUB.fullmatch(path.read_text(encoding="utf-8")) for path in DOCS.glob("*.md")}
STANDS_FOR = {name: (DOCS / found[1]).resolve() for name, found in FOUND.items() if found}
log = logging.getLogger(__name__)


def read(app, docname, source):
    """A page as Sphinx needs it, from what stands in the repository."""
    if docname not in FOUND:  # of the API
        return
    path = STANDS_FOR.get(docname, DOCS / f"{docname}.md")
    text = path.read_text(encoding="utf-8")
    if change := {"index": contents, "gallery": live, "commands": helps, "examples": scripts}.get(docname):
        text = change(text, Path(app.outdir))
    text = re.sub(r"```mermaid\n(.*?)```", table, text, flags=re.DOTALL)
    source[0] = re.sub(r"\]\(([^)#:]+)(#[^)]*)?\)", lambda found: link(found, path.parent), text)


def link(found, folder: Path) -> str:
    """A link of a page in a folder, as seen from docs/."""
    target, place = (folder / found[1]).resolve(), found[2] or ""
    if not target.exists():
        return found[0]
    for name, page in STANDS_FOR.items():
        if target == page:
            return f"]({name}.md{place})"
        if target.parent == page.parent != DOCS.parent and target.suffix == ".py":
            return f"]({name}.md#{target.stem})"
    return f"]({os.path.relpath(target, DOCS)}{place})"


def contents(text: str, outdir) -> str:
    """The contents of the site: for each heading of the start page, the pages that its text links to."""
    for part in re.split(r"^## ", text, flags=re.MULTILINE)[1:]:
        pages = "\n".join(dict.fromkeys(re.findall(r"\]\(([\w/]+)\.(?:md|rst)\)", part)))
        text += f"\n```{{toctree}}\n:hidden:\n:caption: {part.splitlines()[0]}\n\n{pages}\n```\n"
    return text


def table(found) -> str:
    """A graph of mermaid as a table: drawing it takes a script from the network."""
    says = dict(re.findall(r'(\w+)\["\w+: (.*?)"\]', found[1]))
    arrows = re.findall(r"^ *(\w+).*? --> (.*)", found[1], flags=re.MULTILINE)
    rows = [f"| `{part}` | {says.get(part, '')} | {to.replace(' & ', ', ')} |" for part, to in arrows]
    return "\n".join(["| part | what | imports |", "|---|---|---|", *rows])


def helps(text: str, outdir) -> str:
    """The page on commands: below each heading, its name, what ``--help`` prints."""
    before, *parts = re.split(r"^(?=## `pinconsist )", text, flags=re.MULTILINE)
    names = [re.match(r"## `pinconsist (\w+)", part)[1] for part in parts]
    shown = [f"{part}\n```text\n{run([name, '--help'])}```\n\n" for name, part in zip(names, parts, strict=True)]
    return before + "".join(shown)


def scripts(text: str, outdir) -> str:
    """The examples: each with its script."""

    def shown(found):
        script = (STANDS_FOR["examples"].parent / f"{found[1]}.py").read_text(encoding="utf-8")
        return f"{found[0]}\n\n<details><summary>{found[1]}.py</summary>\n\n```python\n{script}```\n\n</details>"

    return re.sub(r"^!\[(\w+)\]\(.*$", shown, text, flags=re.MULTILINE)


def plain(app, what, name, obj, options, lines):
    """Docstrings have absolute values, no substitutions."""
    lines[:] = [line.replace("|", r"\|") for line in lines]


def apart(app, what, name, obj, options, lines):
    """Attributes that share a description are several; napoleon takes them for one."""
    for k, line in enumerate(lines):
        if found := re.fullmatch(r"( *\.\. attribute:: )(\w+(?:, \w+)+)", line):
            lines[k : k + 1] = (found[1] + found[2].replace(", ", f"\n{' ' * len(found[1])}")).split("\n")


def words(app, doctree):
    """Words of types, as in ``ndarray, shape (nv,)``, are not classes."""
    for node in list(doctree.findall(pending_xref)):
        if node["reftype"] == "class" and not re.fullmatch(r"(pinconsist\..*)?[A-Z]\w+", node["reftarget"]):
            node.replace_self(node.children)


def link_names(app, doctree, docname):
    """Make links of public names in the code of a text: ``pc.simulate(…)``, ``sol.check()``."""
    objects = app.env.domains["py"].objects
    for code in doctree.findall(nodes.literal):
        found = re.match(r'(pc|sol|mech|act|sim|help\("pinconsist)\.(\w+(?:\.\w+)*)', code.astext())
        name = f"pinconsist.{OWNERS.get(found[1], '')}{found[2]}" if found else ""
        if name in objects and not isinstance(code.parent, nodes.reference):
            target = app.builder.get_relative_uri(docname, objects[name].docname)
            refuri = f"{target}#{objects[name].node_id}"
            code.replace_self(nodes.reference("", "", code.deepcopy(), internal=True, refuri=refuri))
        elif found and found[1] == "pc" and name not in objects:
            log.warning("there is no %s", found[0], location=code)


def by_its_end(app, env, node, content):
    """The one object that a docstring means where it uses the name of its own module: ``MotorRange``, ``step``."""
    domain, end = env.domains["py"], f".{node['reftarget']}"
    kinds = domain.objtypes_for_role(node["reftype"]) or ()
    found = [each for name, each in domain.objects.items() if name.endswith(end) and each.objtype in kinds]
    if node.get("refdomain") == "py" and len(found) == 1:
        return make_refnode(app.builder, node["refdoc"], found[0].docname, found[0].node_id, content)
    return None


def check(app, error):
    """Every link within the site leads somewhere, and no page needs the network."""
    out = Path(app.outdir)
    pages = {path: path.read_text(encoding="utf-8") for path in out.rglob("*.html") if path.parent != out / "live"}
    for path, text in pages.items() if error is None else ():
        for tag, target in re.findall(r'<(\w+)[^>]*? (?:href|src)="([^"]+)"', text):
            file, _, place = unquote(unescape(target)).partition("#")
            goal = (path.parent / file.split("?")[0]).resolve() if file else path
            outside = re.match(r"\w+:", target)
            if (outside and tag != "a") or (not outside and not goal.exists()):
                log.warning("%s: %s", path.relative_to(out), target)
            elif not outside and place and goal in pages and f'id="{place}"' not in pages[goal]:
                log.warning("%s: no place %s", path.relative_to(out), target)


def setup(app):
    app.connect("source-read", read)
    app.connect("doctree-read", words)
    app.connect("doctree-resolved", link_names)
    app.connect("autodoc-process-docstring", plain, priority=100)
    app.connect("autodoc-process-docstring", apart, priority=900)  # after napoleon
    app.connect("missing-reference", by_its_end)
    app.connect("autodoc-skip-member", lambda *about: "Alias for field number" in (about[3].__doc__ or "") or None)
    app.connect("build-finished", check)
