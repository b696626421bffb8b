"""Small SDF texts for the tests of file formats."""

BAR = """<inertial><pose>0.5 0 0 0 0 0</pose><mass>1</mass>
<inertia><ixx>0.01</ixx><iyy>0.09</iyy><izz>0.08</izz></inertia></inertial>"""


def link(name, pose="", inside=BAR):
    return f'<link name="{name}">{f"<pose>{pose}</pose>" if pose else ""}{inside}</link>'


def joint(name="j", parent="a", child="b", kind="revolute", inside="<axis><xyz>0 0 1</xyz></axis>"):
    return f'<joint name="{name}" type="{kind}"><parent>{parent}</parent><child>{child}</child>{inside}</joint>'


def axis(xyz="0 0 1", inside="", tag="axis"):
    return f"<{tag}><xyz>{xyz}</xyz>{inside}</{tag}>"


A, B, C = link("a"), link("b", "1 0 0 0 0 0"), link("c", "2 0 0 0 0 0")
CHAIN = A + B + C + joint() + joint("k", "b", "c", inside=axis("0 1 0"))


def write(folder, body, version="1.7", head='<model name="m">', tail="</model>", name="scene"):
    """An SDF file in a folder; returns its path."""
    path = folder / f"{name}.sdf"
    path.write_text(f'<sdf version="{version}">{head}{body}{tail}</sdf>')
    return path
