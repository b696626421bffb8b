"""Scene files and saved runs are untrusted: they are read, never obeyed."""

from __future__ import annotations

import ast
import json
import logging
import re
import socket
import subprocess
import sys
import urllib.error
import urllib.request
from importlib.util import find_spec
from pathlib import Path

import numpy as np
import pytest

import pinconsist as pc
from pinconsist.formats import loopfile

LOADERS = ("_PlainLoader", "_AliasLoader", "_TagLoader", "yaml.SafeLoader")
SOURCES = sorted(Path(pc.__file__).parent.rglob("*.py"))
STL = (
    "solid s\nfacet normal 0 0 1\nouter loop\nvertex 0 0 0\nvertex 1 0 0\nvertex 0 1 0\nendloop\nendfacet\nendsolid s\n"
)
INERTIAL = '<inertial><mass value="1"/><inertia ixx="1" ixy="0" ixz="0" iyy="1" iyz="0" izz="1"/></inertial>'


def urdf(mesh="", name="arm", head=""):
    visual = f'<visual><geometry><mesh filename="{mesh}"/></geometry></visual>' if mesh else ""
    return f"""{head}<robot name="r"><link name="ground"/><link name="{name}">{INERTIAL}{visual}</link>
<joint name="hinge" type="continuous"><parent link="ground"/><child link="{name}"/><axis xyz="0 1 0"/></joint>
</robot>"""


def sdf(mesh="", name="arm", head=""):
    visual = f'<visual name="v"><geometry><mesh><uri>{mesh}</uri></mesh></geometry></visual>' if mesh else ""
    return f"""{head}<sdf version="1.7"><model name="m"><link name="{name}">{visual}</link>
<joint name="j" type="revolute"><parent>world</parent><child>{name}</child><axis><xyz>0 1 0</xyz></axis></joint>
</model></sdf>"""


def mjcf(mesh="", name="arm", head="", include=""):
    asset = f'<asset><mesh name="mesh" file="{mesh}"/></asset>' if mesh else ""
    geom = '<geom type="mesh" mesh="mesh"/>' if mesh else ""
    return f"""{head}<mujoco>{include}{asset}<worldbody><body name="{name}">
<inertial pos="0 0 0" mass="1" diaginertia="1 1 1"/><joint type="hinge" axis="0 1 0"/>{geom}</body>
</worldbody></mujoco>"""


def xacro(mesh="", name="arm", head=""):
    return urdf(mesh, name, head).replace("<robot ", '<robot xmlns:xacro="http://www.ros.org/wiki/xacro" ')


def usd(mesh="", name="arm", head=""):
    """A stage that refers to another file, which has a body."""
    reference = f"(prepend references = @{mesh}@)" if mesh else ""
    return f"""#usda 1.0
( defaultPrim = "{name}"
  metersPerUnit = 1
  upAxis = "Z" )
def Xform "{name}" (prepend apiSchemas = ["PhysicsRigidBodyAPI"]) {{ }}
def "more" {reference} {{ }}
"""


def webots(mesh="", name="arm", head=""):
    shape = f'boundingObject Mesh {{ url "{mesh}" }}' if mesh else ""
    return f"""#VRML_SIM R2023b utf8
Robot {{ children [ HingeJoint {{ jointParameters HingeJointParameters {{ axis 0 1 0 }}
endPoint Solid {{ name "{name}" {shape} physics Physics {{ density -1 mass 1 }} }} }} ] }}
"""


FORMATS = {"urdf": urdf, "sdf": sdf, "xml": mjcf, "xacro": xacro, "usda": usd, "wbt": webots}
XML = ("urdf", "sdf", "xml", "xacro")
NEEDS = {"usda": "pxr.Usd", "xacro": "xacro"}
LAUGHS = "".join(f'<!ENTITY l{i + 1} "{f"&l{i};" * 10}">' for i in range(12))
DOCTYPES = {
    "billion laughs": (f'<!DOCTYPE r [<!ENTITY l0 "ha">{LAUGHS}]>', "&l12;"),
    "one long entity, many times": (f'<!DOCTYPE r [<!ENTITY a "{"a" * 100_000}">]>', "&a;" * 50),
    "a file": ('<!DOCTYPE r [<!ENTITY x SYSTEM "file:///etc/passwd">]>', "&x;"),
    "a page": ('<!DOCTYPE r [<!ENTITY x SYSTEM "http://127.0.0.1:9/x">]>', "&x;"),
    "a parameter": ('<!DOCTYPE r [<!ENTITY % x SYSTEM "http://127.0.0.1:9/x.dtd"> %x;]>', "arm"),
    "a definition elsewhere": ('<!DOCTYPE r SYSTEM "http://127.0.0.1:9/x.dtd">', "arm"),
}


def have(kind) -> bool:
    """Whether the package that reads files of this kind is installed."""
    return kind not in NEEDS or find_spec(NEEDS[kind].partition(".")[0]) is not None


@pytest.fixture
def kind(request):
    if not have(request.param):
        pytest.skip(f"{NEEDS[request.param]} is not installed")
    return request.param


@pytest.mark.parametrize("entity", DOCTYPES)
@pytest.mark.parametrize("kind", XML, indirect=True)
def test_no_entity_is_expanded_or_fetched(tmp_path, kind, entity):
    head, name = DOCTYPES[entity]
    file = tmp_path / f"scene.{kind}"
    file.write_text(FORMATS[kind](name=name, head=head))
    with pytest.raises(pc.FormatError, match="document types and entities are refused") as caught:
        pc.load(file)
    assert caught.value.path == str(file)


def test_an_xinclude_is_an_unknown_element(tmp_path):
    inside = '<xi:include xmlns:xi="http://www.w3.org/2001/XInclude" href="/etc/passwd" parse="text"/>'
    for kind in filter(have, XML):
        file = tmp_path / f"scene.{kind}"
        file.write_text(FORMATS[kind]().replace("</", f"{inside}</", 1))
        try:
            mech = pc.load(file)
        except pc.FormatError:
            continue
        assert "root:" not in mech.geometry.urdf


YAML = {
    "code": ("loops: !!python/object/apply:os.system ['touch pwned']", "could not determine a constructor"),
    "a module": ("loops: !!python/module:os", "could not determine a constructor"),
    "aliases": ("a: &a [x, x]\nb: &b [*a, *a]\nc: [*b, *b]", "aliases .* are not supported"),
    "merged": ("a: &a {x: 1}\nb: {<<: *a}", "aliases .* are not supported"),
    "deep lists": (f"loops: {'[' * 200_000}", "not usable YAML"),
    "deep maps": (f"loops: {'{a: ' * 100_000}", "not usable YAML"),
    "deep blocks": ("".join(f"{' ' * i}a:\n" for i in range(1300)), "not usable YAML"),
    "base 60": (f"guess: {{a: {'1:' * 300_000}1}}", "a value has 600001 characters"),
    "less of it": (f"guess: {{a: {'59:' * 3_000}1}}", "a finite number is needed, not a very long number"),
    "digits": (f"guess: {{a: {'9' * 9_000}}}", "Exceeds the limit|a finite number is needed"),
    "too much": ("#" * 1_000_001, "more than 1 MB"),
    "a name for the terminal": (r'actuated: ["\e[2J"]', r"the name '\\x1b\[2J' has unprintable characters"),
}


@pytest.mark.parametrize("case", YAML)
def test_a_loop_file_is_plain_and_short(tmp_path, monkeypatch, case):
    monkeypatch.chdir(tmp_path)
    text, message = YAML[case]
    Path("robot.urdf").write_text(urdf())
    Path("robot.yaml").write_text(text)
    with pytest.raises(pc.FormatError, match=message):
        pc.load("robot.urdf")
    assert sorted(each.name for each in Path().iterdir()) == ["robot.urdf", "robot.yaml"]


DEEP = {
    "urdf": '<robot name="r">' + "<x>" * 100_000 + "</x>" * 100_000 + "</robot>",
    "sdf": '<sdf version="1.7">' + '<model name="m">' * 100_000 + "</model>" * 100_000 + "</sdf>",
    "xml": "<mujoco><worldbody>" + "<body>" * 5_000 + "</body>" * 5_000 + "</worldbody></mujoco>",
    "wbt": "#VRML_SIM R2023b utf8\n" + "Group { children [ " * 100_000 + "] }" * 100_000,
}
DEEP["xacro"] = DEEP["urdf"]


@pytest.mark.parametrize("kind", DEEP, indirect=True)
def test_deep_files_are_refused_with_a_message(tmp_path, kind):
    file = tmp_path / f"deep.{kind}"
    file.write_text(DEEP[kind])
    with pytest.raises(pc.FormatError):
        pc.load(file)


def test_immense_files_are_not_read(tmp_path):
    for kind in filter(have, FORMATS):
        file = tmp_path / f"large.{kind}"
        with file.open("wb") as stream:
            stream.truncate(10**12)  # takes no room
        with pytest.raises(pc.FormatError, match="more than 50 MB"):
            pc.load(file)


OUTSIDE = (
    "{outside}/secret.stl",
    "file://{outside}/secret.stl",
    "../outside/secret.stl",
    "sub/../../outside/secret.stl",
    "package://../outside/secret.stl",
    "package://scene/../outside/secret.stl",
    "model://../outside/secret.stl",
    "link.stl",
    "cwd.stl",
    "http://127.0.0.1:9/secret.stl",
    "https://127.0.0.1:9/secret.stl",
)


@pytest.fixture
def folders(tmp_path, monkeypatch):
    """A scene's folder, and beside it what no scene may show; the working directory is a third."""
    for name in ("scene", "scene/sub", "outside", "here"):
        (tmp_path / name).mkdir()
    for file in ("outside/secret.stl", "here/cwd.stl", "scene/own.stl"):
        (tmp_path / file).write_text(STL)
    (tmp_path / "scene" / "link.stl").symlink_to(tmp_path / "outside" / "secret.stl")
    monkeypatch.chdir(tmp_path / "here")
    return tmp_path / "scene", tmp_path / "outside"


def meshes(file, **options):
    """How many meshes of a scene are shown."""
    from pinconsist.view.visuals import visuals

    shapes = visuals(pc.load(file, **options))
    return sum(shape.geometry["type"] == "BufferGeometry" for shape in shapes)


@pytest.mark.parametrize("mesh", OUTSIDE)
@pytest.mark.parametrize("kind", XML, indirect=True)
def test_no_mesh_from_outside_of_the_scenes_folder(folders, caplog, kind, mesh):
    scene, outside = folders
    file = scene / f"robot.{kind}"
    file.write_text(FORMATS[kind]("own.stl"))
    assert meshes(file) == 1  # what it has beside it is shown
    file.write_text(FORMATS[kind](mesh.format(outside=outside)))
    caplog.set_level(logging.WARNING, "pinconsist")
    try:
        assert meshes(file) == 0
    except pc.FormatError as error:
        assert "is outside the folder of the scene" in str(error)
    else:
        assert caplog.records  # it is told


def test_meshes_from_folders_that_were_named(folders):
    scene, outside = folders
    for mesh in ("../outside/secret.stl", f"{outside}/secret.stl", "package://outside/secret.stl", "secret.stl"):
        (scene / "robot.urdf").write_text(urdf(mesh))
        assert meshes(scene / "robot.urdf", package_dirs=[outside]) == 1


@pytest.mark.parametrize(
    "name", ["{outside}/part.xml", "../outside/part.xml", "sub/../../outside/part.xml", "link.xml"]
)
def test_no_include_from_outside_of_the_scenes_folder(folders, name):
    scene, outside = folders
    (outside / "part.xml").write_text("<mujoco/>")
    (scene / "link.xml").symlink_to(outside / "part.xml")
    file = scene / "robot.xml"
    file.write_text(mjcf(include=f'<include file="{name.format(outside=outside)}"/>'))
    with pytest.raises(pc.FormatError, match="is outside the folder of the scene"):
        pc.load(file)


def test_no_layer_from_outside_of_the_scenes_folder(folders):
    """Neither from a stage, nor from a layer of its folder, nor from within a package."""
    pytest.importorskip("pxr.Usd")
    from pxr import Sdf

    scene, outside = folders
    (outside / "secret.usda").write_text(usd(name="secret"))
    (scene / "link.usda").symlink_to(outside / "secret.usda")
    (scene / "own.usda").write_text(usd(name="own"))
    file, package = scene / "robot.usda", scene / "robot.usdz"
    file.write_text(usd("own.usda"))
    assert len(pc.load(file).joints) == 2  # what it has beside it is read
    places = [mesh.format(outside=outside).replace(".stl", ".usda") for mesh in OUTSIDE]
    places += ['`"../outside/secret.usda"`', "../outside/secret.usda:SDF_FORMAT_ARGS:a=b", "own.usda[x.usda]"]
    for place in places:
        file.write_text(usd(place))
        (scene / "middle.usda").write_text(usd("robot.usda", name="middle"))
        with Sdf.ZipFileWriter.CreateNew(str(package)) as archive:
            archive.AddFile(str(file), "robot.usda")
        for path in (file, scene / "middle.usda", package):
            with pytest.raises(pc.FormatError, match=r"outside the folder|nothing is downloaded|no such file"):
                pc.load(path)


def test_a_package_of_layers_is_read(folders):
    pytest.importorskip("pxr.Usd")
    from pxr import Sdf

    scene, _ = folders
    with Sdf.ZipFileWriter.CreateNew(str(scene / "robot.usdz")) as archive:
        for name, text in (("robot.usda", usd("own.usda")), ("own.usda", usd(name="own"))):
            (scene / name).write_text(text)
            archive.AddFile(str(scene / name), name)
            (scene / name).unlink()
    assert len(pc.load(scene / "robot.usdz").joints) == 2


def test_no_proto_is_fetched_or_read(folders):
    scene, outside = folders
    (outside / "Evil.proto").write_text("PROTO Evil [ ] { Solid { } }")
    for place in (f"{outside}/Evil.proto", "../outside/Evil.proto", "https://127.0.0.1:9/Evil.proto"):
        text = webots().replace("\n", f'\nEXTERNPROTO "{place}"\n', 1).replace("children [", "children [ Evil { }", 1)
        (scene / "robot.wbt").write_text(text)
        mech = pc.load(scene / "robot.wbt")
        assert len(mech.joints) == 1 and any("Evil" in each for each in mech.ignored)


def test_sdf_includes_are_not_followed(folders):
    scene, outside = folders
    for uri in (f"file://{outside}/x.sdf", "model://x", "https://127.0.0.1:9/x.sdf", "../outside/x.sdf"):
        (scene / "robot.sdf").write_text(sdf().replace("<link", f"<include><uri>{uri}</uri></include><link", 1))
        with pytest.raises(pc.FormatError, match="include"):
            pc.load(scene / "robot.sdf")


WATCH = """
import pathlib, sys
folder, allowed = sys.argv[1], sys.argv[2].split(":")
import pinconsist as pc, pinconsist.view.page
import coal, defusedxml.ElementTree, yaml
from pinconsist.view.visuals import visuals
seen = []

def hook(event, arguments):
    if event.startswith(("socket.", "subprocess.", "os.system", "os.exec", "ftplib.", "urllib.")):
        seen.append(f"{event} {arguments}")
    elif event == "open" and isinstance(arguments[0], str) and not arguments[0].startswith(tuple(allowed)):
        seen.append(f"open {arguments[0]}")

for name in ("four_bar", "problem51"):  # whatever is imported late is imported now
    if name in pc.models():
        pc.load(name)
for file in pathlib.Path(folder).glob("warm.*"):
    pc.load(file)
sys.addaudithook(hook)
for name in sys.argv[3:]:
    try:
        visuals(pc.load(f"{folder}/{name}"))
    except pc.FormatError as error:
        pass
print(*seen, sep="\\n")
"""


def test_hostile_scenes_touch_nothing_but_their_folder(folders):
    """In a process whose every open() and socket is watched by Python's own audit events."""
    scene, outside = folders
    names = []
    for kind, make in FORMATS.items():
        if not have(kind) or kind == "xacro":  # which starts a process, with a gate of its own
            continue
        (scene / f"warm.{kind}").write_text(make())
        texts = [make(mesh.format(outside=outside)) for mesh in OUTSIDE]
        texts += [make(name=name, head=head) for head, name in DOCTYPES.values()]
        for number, text in enumerate(texts):
            (scene / f"{number}.{kind}").write_text(text)
            names.append(f"{number}.{kind}")
    library = ":".join([str(scene), sys.prefix, sys.base_prefix, str(Path(pc.__file__).parents[1])])
    run = subprocess.run(
        [sys.executable, "-c", WATCH, scene, library, *names], capture_output=True, text=True, timeout=120
    )
    assert run.returncode == 0, run.stderr
    assert run.stdout.strip() == ""


def test_no_code_is_made_of_data():
    """No eval, exec, pickle or unsafe YAML anywhere in the package; numpy never unpickles; no shell."""
    bad = []
    for path in SOURCES:
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
            if not isinstance(node, ast.Call):
                continue
            called, words = ast.unparse(node.func), {word.arg: ast.unparse(word.value) for word in node.keywords}
            loader = words.get("Loader", "")
            if (
                called
                in ("eval", "exec", "compile", "__import__", "os.system", "os.popen", "marshal.loads", "shelve.open")
                or re.fullmatch(r"(c?pickle|dill|cloudpickle|joblib)\.(load|loads|Unpickler)", called)
                or (called == "yaml.load" and loader not in LOADERS)
                or (called in ("np.load", "numpy.load") and words.get("allow_pickle") != "False")
                or words.get("shell") == "True"
                or called.startswith(("urllib.request", "requests.", "httpx."))
            ):
                bad.append(f"{path.name}:{node.lineno}: {called}")
    assert not bad
    assert issubclass(loopfile._PlainLoader, __import__("yaml").SafeLoader)
    assert issubclass(loopfile._AliasLoader, loopfile._PlainLoader)
    assert issubclass(loopfile._TagLoader, loopfile._AliasLoader)


def test_aliases_of_a_body_do_not_expand_to_gigabytes(tmp_path):
    """A body of Choreonoid may repeat values; a few lines of them, or of merged keys, are refused at once."""
    lists, maps = ["a0: &a0 [1]"], ["b0: &b0 {k: 1, l: 2}"]
    for i in range(1, 12):
        lists.append(f"a{i}: &a{i} [{', '.join([f'*a{i - 1}'] * 10)}]")
        maps.append(f"b{i}: &b{i} {{<<: [{', '.join([f'*b{i - 1}'] * 10)}]}}")
    newline = "\n"
    for text, reason in ((lists, "more than .* values"), (maps, "keys are merged|nothing can move")):
        (tmp_path / "r.body").write_text(f"{newline.join(text)}\nlinks: [{{name: base, jointType: fixed}}]\n")
        with pytest.raises(pc.FormatError, match=reason):
            pc.load(tmp_path / "r.body")


def test_xml_is_parsed_by_defusedxml_alone():
    makers = {"parse", "fromstring", "fromstringlist", "iterparse", "XMLParser", "XML", "minidom", "sax"}
    for path in SOURCES:
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
            if isinstance(node, ast.ImportFrom) and (node.module or "").startswith(("xml", "lxml")):
                assert not makers & {alias.name for alias in node.names}, path
            if isinstance(node, ast.Import):
                assert not [alias.name for alias in node.names if alias.name.startswith(("xml", "lxml"))], path


def test_a_saved_run_brings_no_objects(tmp_path):
    """An npz whose array is a pickle would run code when read."""

    class Evil:
        def __reduce__(self):
            return Path(tmp_path / "pwned").touch, ()

    file = tmp_path / "run.npz"
    for names in (("about",), ("t", "q", "v", "lam", "h", "order")):
        sol = pc.simulate(pc.load("four_bar"), (0.0, 0.01))
        with np.load(sol.save(file)) as stored:
            parts = dict(stored)
        np.savez(file, **parts | {name: np.array([Evil()], dtype=object) for name in names})
        with pytest.raises(pc.FormatError, match="allow_pickle=False"):
            pc.Solution.load(file)
    assert not (tmp_path / "pwned").exists()


def test_what_a_saved_run_says_of_its_making_is_checked(tmp_path):
    file = tmp_path / "run.npz"
    pc.record("four_bar", (0.0, 0.02), file)
    whole = file.read_bytes()
    for changes in (
        {"options": {"callback": "os.system"}}, {"options": {"rtol": "1"}}, {"t_span": "now"}, {"t_span": [0, 1e400]},
        {"forces": [{"kind": "os.system"}]}, {"forces": 3}, {"scene": {"source": "four_bar"}}, {"scene": 5},
        {"files": 1},
        {"save_every": -1}, {"checkpoint": {"t": 0.01}}, {"checkpoint": 1}, {"more": 1}, {"q0": {"crank": "x"}},
    ):  # fmt: skip
        file.write_bytes(whole)
        with np.load(file) as stored:
            parts = dict(stored)
        about = json.loads(str(parts["about"]))
        about["recipe"] |= changes
        np.savez(file, **parts | {"about": np.array(json.dumps(about))})
        with pytest.raises(pc.PinconsistError):
            pc.rerun(file)


def test_names_of_a_scene_are_text_on_its_page(tmp_path):
    evil = "</script><script>alert(1)</script><img src=x onerror=alert(2)>"
    mech = pc.Mechanism(pc.load("four_bar").model, pc.load("four_bar").loops, name=evil)
    sol = pc.simulate(mech, (0.0, 0.05))
    text = pc.export_html(mech, {evil: sol, "b": sol}, tmp_path / "page.html").read_text(encoding="utf-8")
    assert "<script>alert(1)" not in text and "<img src=x" not in text
    assert "&lt;script&gt;alert(1)" in text and "\\u003cscript>alert(1)" in text


def test_the_viewer_listens_on_loopback_only(monkeypatch):
    bound = []
    bind = socket.socket.bind
    monkeypatch.setattr(socket.socket, "bind", lambda self, address: (bound.append(address), bind(self, address))[1])
    mech = pc.load("four_bar")
    address = pc.replay(mech, pc.simulate(mech, (0.0, 0.05)), open_browser=False)
    assert [host for host, _ in bound] == ["127.0.0.1"]
    port = int(address.rstrip("/").rsplit(":", 1)[1])
    assert urllib.request.urlopen(address).status == 200
    for path in ("etc/passwd", "../../etc/passwd", "%2e%2e/etc/passwd"):  # one page, no files
        with pytest.raises(urllib.error.HTTPError, match="404"):
            urllib.request.urlopen(address + path)
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
        try:
            probe.connect(("192.0.2.1", 9))  # sends nothing; tells which address this machine has outside
        except OSError:
            pytest.skip("this machine has no other address than loopback")
        outside = probe.getsockname()[0]
    if not outside.startswith("127."):
        with pytest.raises(OSError):
            socket.create_connection((outside, port), timeout=2).close()
