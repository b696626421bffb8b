"""The theory page's code does what the page says; and everything public says its shapes, units, errors."""

import dataclasses
import doctest
import importlib
import inspect
import re
import shlex
from pathlib import Path
from xml.etree import ElementTree

import numpy as np
import pytest
from helpers.command_line import called

import pinconsist as pc
from pinconsist.formats import loopfile
from pinconsist.formats.records import FORCES

ROOT = Path(__file__).resolve().parents[1]
ROOTS = (ROOT, ROOT / "pinconsist")
DOCS = ROOT / "docs"
BLOCK = re.compile(r"(?:`([\w.]+)`:\n\n)?^```(\w+)\n(.*?)^```", flags=re.MULTILINE | re.DOTALL)  # "Save this as `x`:"
COMMAND = re.compile(r"^(?:\$ )?(pinconsist .*)", flags=re.MULTILINE)
PAGES = [page for page in sorted(DOCS.glob("*.md")) if BLOCK.search(page.read_text(encoding="utf-8"))]
PAGES.remove(DOCS / "architecture.md")  # a graph
PAGES.remove(DOCS / "gallery.md")  # whose commands are run when the site is built


def test_every_command_is_on_the_page_of_the_commands():
    from pinconsist.cli.app import app

    told = re.findall("^## `pinconsist (.*)`$", (DOCS / "commands.md").read_text(encoding="utf-8"), flags=re.MULTILINE)
    assert sorted(told) == sorted(command.name for command in app.registered_commands)


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.name)
def test_code_on_the_pages(page, tmp_path, monkeypatch, capsys):
    """In its order, as a reader would try it: files are saved, commands run, outputs compared."""
    monkeypatch.chdir(tmp_path)
    text, names, report = page.read_text(encoding="utf-8"), {}, []
    for found in BLOCK.finditer(text):
        file, kind, code = found.groups()
        if file:
            write(tmp_path / file, code)
        elif kind == "python" and ">>>" in code:
            line = text.count("\n", 0, found.start(3))
            test = doctest.DocTestParser().get_doctest(code, names, page.name, str(page), line)
            doctest.DocTestRunner().run(test, out=report.append, clear_globs=False)
            names = test.globs
        elif kind == "python":
            exec(code, names)
        for command in COMMAND.findall(code) if kind in ("bash", "console") else ():
            code, _, error = called(capsys, *shlex.split(command, comments=True)[1:])
            assert code == 0, error
    assert not report, "".join(report)


def test_every_public_name_is_on_the_page_of_the_interface():
    listed = re.findall(r"^   (\w+)$", (DOCS / "api.rst").read_text(encoding="utf-8"), flags=re.MULTILINE)
    assert sorted(listed) == sorted([*pc.__all__, *pc.paper.__all__])


def test_the_gallery_is_drawn(monkeypatch):
    """Within the picture and by one scale: the path has the proportions of the run, and the loop's core is on it."""
    monkeypatch.syspath_prepend(DOCS)
    mech = pc.load("four_bar")
    sol = pc.simulate(mech, (0.0, 1.0))
    drawing = ElementTree.fromstring(importlib.import_module("gallery").thumbnail(mech, sol, ["coupler_tip"]))
    path, *moments = drawing
    ways = [re.findall(r"[-\d.]+", each.get("d")) for each in drawing.iter("{http://www.w3.org/2000/svg}path")]
    places = [np.reshape(way, (-1, 2)).astype(float) for way in ways]
    size = np.array(drawing.get("viewBox").split()[2:], float)
    assert path.get("d") and len(moments) == 3 and all(((each > 0) & (each < size)).all() for each in places)
    trace, core = places[0], places[-1]
    x, _, z = np.ptp(sol.frame("coupler_tip").position, axis=0)
    assert np.divide(*np.ptp(trace, axis=0)) == pytest.approx(x / z, rel=0.01)
    assert np.linalg.norm(trace - (core.min(axis=0) + core.max(axis=0)) / 2, axis=1).min() < 2  # pixels


ALL_PAGES = [ROOT / name for name in ("README.md", "CONTRIBUTING.md", "examples/README.md")]
ALL_PAGES += sorted((ROOT / "docs").glob("*.md"))


@pytest.mark.parametrize("page", ALL_PAGES, ids=lambda page: f"{page.parent.name}-{page.name}")
def test_links_and_files_named_on_the_pages_exist(page):
    text = page.read_text(encoding="utf-8")
    for target, place in re.findall(r"\]\(([^)#]*)#?([^)]*)\)", text):
        goal = page.parent / target if target else page
        assert target.startswith("http") or goal.exists(), target
        headings = re.findall(r"^#+ (.*)", goal.read_text(encoding="utf-8"), flags=re.MULTILINE) if place else ()
        slugs = {re.sub(r"[^\w -]", "", heading.lower()).replace(" ", "-") for heading in headings}
        assert not place or place in slugs, f"{target}#{place}: {slugs}"
    for path in re.findall(r"`([\w.]+/[\w./]*)`", text):  # from the root or from pinconsist/
        if page.name == "architecture.md" or any((folder / path.split("/")[0]).is_dir() for folder in ROOTS):
            assert any((folder / path).exists() for folder in ROOTS), path


def test_names_on_the_page_on_the_architecture_exist():
    sources = [path for folder in ("pinconsist", "benchmarks", "tests") for path in (ROOT / folder).rglob("*.*")]
    texts = [path.read_text(encoding="utf-8") for path in sources if path.suffix in (".py", ".hpp", ".cpp")]
    words = set(re.findall(r"\w+", "".join(texts)))
    for name in re.findall(r"`([\w.]+)`", (ROOT / "docs" / "architecture.md").read_text(encoding="utf-8")):
        is_file = name.endswith((".py", ".pyi", ".toml", ".txt"))
        assert any((folder / name).is_file() for folder in ROOTS) if is_file else set(name.split(".")) <= words, name


README = (ROOT / "README.md").read_text(encoding="utf-8")


def test_the_python_of_the_readme_runs(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    (block,) = re.findall(r"^```python\n(.*?)^```", README, flags=re.MULTILINE | re.DOTALL)
    exec(block, {})
    assert "loops closed to" in capsys.readouterr().out and (tmp_path / "four_bar.html").is_file()


def test_the_loop_files_of_the_page_on_robots_are_read(tmp_path):
    page = (ROOT / "docs" / "robots.md").read_text(encoding="utf-8")
    blocks = re.findall(r"^```yaml\n(.*?)^```", page, flags=re.MULTILINE | re.DOTALL)
    record = re.search(r"`(\{name: pin.*?\})`", page, flags=re.DOTALL)[1]
    robot, own, laws, anchors = (
        loopfile.read(write(tmp_path / f"{k}.yaml", text)) for k, text in enumerate([*blocks, f"loops: [{record}]"])
    )
    assert robot.loops[0].kind == "frame" and robot.actuated == ("mot1", "mot2")
    assert [loop.kind for loop in own.loops] == ["hinge", "coupling"] and own.duration == 2.0 and len(own.forces) == 2
    assert [type(drive.curve) for drive in laws.loops] == [pc.Motion, pc.Curve]
    assert anchors.loops == (
        pc.Loop("pin", "hinge", "coupler", "rocker", xyz1=(0.7, 0, 0), xyz2=(0.5, 0, 0), axis=(0, 1, 0)),
    )


def write(path, text):
    path.write_text(text, encoding="utf-8")
    return path


def test_the_table_of_first_multipliers_is_what_compare_prints():
    page = (DOCS / "theory.md").read_text(encoding="utf-8")
    rows = re.findall(r"^\| (\S*) *\| ([12]) \| (\S+) \| (\S+) \| (\S+) \|$", page, flags=re.MULTILINE)
    assert len(rows) == 6
    steps = [float(h) for h, *_ in rows if h]
    runs = [run for run in pc.paper.compare("problem51", steps, count=2).runs for _ in (1, 2)]
    for (_, row, *told), run in zip(rows, runs, strict=True):
        found = [getattr(run, name)[int(row)] for name in ("exact", "consistent", "every_step")]
        assert [float(number) for number in told] == pytest.approx(found, rel=5e-3)  # three digits


def sections(doc):
    """The headings of a numpy-style docstring."""
    return set(re.findall(r"^(\w+)\n-+$", inspect.cleandoc(doc), flags=re.MULTILINE))


# That parameters and results are told is asked by test_public.py; here it is errors.


@pytest.mark.parametrize("name", [name for name in pc.__all__ if not inspect.isclass(getattr(pc, name))])
def test_functions_say_what_they_raise(name):
    documented = inspect.getdoc(getattr(pc, name))
    for other in re.findall(r"[Pp]arameters (?:and errors )?as :func:`(\w+)`", documented):
        documented += "\n\n" + inspect.getdoc(getattr(pc, other))
    assert {"Returns", "Raises"} <= sections(documented)


@pytest.mark.parametrize("name", [name for name in pc.__all__ if inspect.isclass(getattr(pc, name))])
def test_methods_that_refuse_input_say_so(name):
    cls = getattr(pc, name)
    for member, function in inspect.getmembers(cls, inspect.isfunction):
        if not member.startswith("_") and "raise InputError" in inspect.getsource(function):
            documented = inspect.getdoc(function)
            assert "Raises" in sections(documented) or "Error" in documented, f"{name}.{member}"


def test_the_table_of_forces_has_all_their_fields():
    """Each public force, its kind in files, its fields in order, and the defaults that are numbers."""
    page = (DOCS / "forces.md").read_text(encoding="utf-8")
    found, kinds, force = {}, {}, ""
    for line in page.splitlines():
        cells = [cell.strip() for cell in line.strip("|").split("|")]
        if len(cells) == 5 and cells[2].startswith("`"):
            force = cells[0].strip("`") or force
            kinds.setdefault(force, cells[1].strip("`"))
            found.setdefault(force, []).extend((name.strip("` "), cells[4]) for name in cells[2].split(","))
    public = {name: getattr(pc, name) for name in pc.__all__}
    records = {name: each for name, each in public.items() if hasattr(each, "label")}
    assert set(found) == set(records)
    for name, record in records.items():
        fields = {each.name: each.default for each in dataclasses.fields(record) if not each.name.startswith("_")}
        assert sorted(field for field, _ in found[name]) == sorted(fields), name
        for field, told in found[name]:
            if isinstance(fields[field], float) and ":" not in told:
                assert float(told) == fields[field], (name, field)
    of_files = {kind: record.__name__ for kind, record in FORCES.items()}
    assert {kind: name for name, kind in kinds.items() if kind} == of_files
