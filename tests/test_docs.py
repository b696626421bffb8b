"""The theory page's code does what the page says; and everything public says its shapes, units, errors."""

import doctest
import inspect
import re
from pathlib import Path

import pytest

import pinconsist as pc
from pinconsist.formats import loopfile

ROOT = Path(__file__).resolve().parents[1]
ROOTS = (ROOT, ROOT / "pinconsist")
PAGES = [page for page in sorted((ROOT / "docs").glob("*.md")) if ">>>" in page.read_text(encoding="utf-8")]


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.name)
def test_code_on_the_pages(page):
    text = re.sub(r"^```\w*$", "", page.read_text(encoding="utf-8"), flags=re.MULTILINE)  # else expected as output
    test = doctest.DocTestParser().get_doctest(text, {}, page.name, str(page), 0)
    assert len(test.examples) > 5
    report = []
    doctest.DocTestRunner().run(test, out=report.append)
    assert not report, "".join(report)


ALL_PAGES = [ROOT / name for name in ("README.md", "CONTRIBUTING.md", "examples/README.md")]
ALL_PAGES += sorted((ROOT / "docs").glob("*.md"))


@pytest.mark.parametrize("page", ALL_PAGES, ids=lambda page: f"{page.parent.name}-{page.name}")
def test_links_and_files_named_on_the_pages_exist(page):
    text = page.read_text(encoding="utf-8")
    for target in re.findall(r"\]\(([^)#]+)\)", text):
        assert target.startswith("http") or (page.parent / target).exists(), target
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
    robot, own, anchors = (
        loopfile.read(write(tmp_path / f"{k}.yaml", text)) for k, text in enumerate([*blocks, f"loops: [{record}]"])
    )
    assert robot.loops[0].kind == "frame" and robot.actuated == ("mot1", "mot2")
    assert [loop.kind for loop in own.loops] == ["hinge", "coupling"] and own.duration == 2.0 and len(own.forces) == 2
    assert anchors.loops == (
        pc.Loop("pin", "hinge", "coupler", "rocker", xyz1=(0.7, 0, 0), xyz2=(0.5, 0, 0), axis=(0, 1, 0)),
    )


def write(path, text):
    path.write_text(text, encoding="utf-8")
    return path


def test_the_table_of_the_readme_is_what_compare_prints():
    rows = re.findall(r"^\| (\S*) *\| ([12]) \| (\S+) \| (\S+) \| (\S+) \|$", README, flags=re.MULTILINE)
    assert len(rows) == 6
    steps = [float(h) for h, *_ in rows if h]
    runs = [run for run in pc.compare("problem51", steps, count=2).runs for _ in (1, 2)]
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
